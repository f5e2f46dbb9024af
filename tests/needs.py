"""What glsplat and its tests need of the system: a probe that tries it and its Debian package, a row each.

    python3 tests/needs.py run             # the packages that `make demo` lacks, on one line
    python3 tests/needs.py check browser   # a line for each of these tiers

.ci/system installs from these rows, fixtures skip by them (:func:`require`). The standard library alone: it runs before
anything is installed.
"""

from __future__ import annotations

import ctypes
import importlib.util
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import cache

__all__ = ["NEEDS", "Need", "missing", "program", "require"]


_LOAD = """
import ctypes, sys
for name in sys.argv[1:]:
    try:
        ctypes.CDLL(name)
    except OSError:
        continue
    sys.exit(0)
sys.exit(1)
"""


def _loads(names: Iterable[str]) -> bool:
    """One of these libraries can be loaded: it may be listed and not be readable, or be of another architecture.

    Tried in a process of its own: in this one the library would stay, and glsplat would ask it what is current.
    """
    return subprocess.run([sys.executable, "-c", _LOAD, *names], capture_output=True, timeout=120).returncode == 0


def _starts(name: str) -> bool:
    """The program is there and runs, with the libraries that it was linked to."""
    path = shutil.which(name)
    words = {"openssl": ["version"], "Xvfb": ["-help"], "ffprobe": ["-version"], "nginx": ["-v"], "caddy": ["version"]}
    try:
        command = [path or name, *words.get(os.path.basename(name), ["--version"])]
        return path is not None and subprocess.run(command, capture_output=True, timeout=120).returncode == 0
    except (OSError, subprocess.TimeoutExpired):
        return False


def _draws() -> bool:
    """EGL has a device with a driver behind it. Asked in a process of its own: drivers may print and crash."""
    script = "import needs; raise SystemExit(needs.devices() == 0)"
    command, here = [sys.executable, "-c", script], os.path.dirname(os.path.abspath(__file__))
    return subprocess.run(command, cwd=here, capture_output=True, timeout=120).returncode == 0


def devices() -> int:
    """How many of EGL's devices start (EGL_EXT_platform_device), as moderngl's context asks for them."""
    pointer, integer = ctypes.c_void_p, ctypes.c_int
    try:
        egl = ctypes.CDLL("libEGL.so.1")
    except OSError:
        return 0
    egl.eglGetProcAddress.restype = pointer
    found = [egl.eglGetProcAddress(name) for name in (b"eglQueryDevicesEXT", b"eglGetPlatformDisplayEXT")]
    if not all(found):
        return 0
    query = ctypes.CFUNCTYPE(integer, integer, pointer, pointer)(found[0])
    display = ctypes.CFUNCTYPE(pointer, integer, pointer, pointer)(found[1])
    handles, count = (pointer * 16)(), integer()
    query(16, handles, ctypes.byref(count))
    return sum(
        bool(egl.eglInitialize(pointer(display(0x313F, handles[k], None)), None, None)) for k in range(count.value)
    )


@dataclass(frozen=True)
class Need:
    """One row. ``tier``: run (demo and test), check, browser (tests skip without it), extra (used where it is)."""

    what: str
    packages: tuple[str, ...]
    tier: str
    libraries: tuple[str, ...] = ()  # one of them loads
    programs: tuple[str, ...] = ()  # one of them starts
    modules: tuple[str, ...] = ()  # all of them are there
    probe: Callable[[], bool] = field(default=lambda: True)

    def met(self) -> bool:
        return (
            (not self.libraries or _loads(self.libraries))
            and (not self.programs or any(map(_starts, self.programs)))
            and all(importlib.util.find_spec(name) for name in self.modules)
            and self.probe()
        )


_BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
_CHROMIUM = (os.environ["CHROMIUM"],) if os.environ.get("CHROMIUM") else _BROWSERS  # that of the variable alone
NEEDS = {
    "venv": Need("Python's venv", ("python3-venv",), "run", modules=("ensurepip", "venv")),
    "egl": Need("EGL", ("libegl1",), "run", libraries=("libEGL.so.1",)),
    "gl": Need("OpenGL", ("libgl1",), "run", libraries=("libGL.so.1",)),
    # an NVIDIA driver serves as well as Mesa's
    "driver": Need("a driver behind EGL", ("libegl-mesa0", "libgl1-mesa-dri"), "run", probe=_draws),
    "xvfb": Need("a virtual screen", ("xvfb",), "check", programs=("Xvfb",)),
    "xdotool": Need("xdotool", ("xdotool",), "check", programs=("xdotool",)),
    "glx": Need("GLX for the virtual screen", ("libglx-mesa0",), "check", libraries=("libGLX_mesa.so.0",)),
    "osmesa": Need("OSMesa", ("libosmesa6",), "check", libraries=("libOSMesa.so.8",)),
    "opengl": Need("libOpenGL", ("libopengl0",), "check", libraries=("libOpenGL.so.0",)),
    "zink": Need("lavapipe, which zink draws on", ("mesa-vulkan-drivers",), "check", libraries=("libvulkan_lvp.so",)),
    "openssl": Need("openssl", ("openssl",), "check", programs=("openssl",)),
    "nginx": Need("nginx", ("nginx",), "check", programs=("nginx", "/usr/sbin/nginx")),
    # of the C# client's tests
    "mono": Need("Mono and its C# compiler", ("mono-mcs", "mono-runtime"), "check", programs=("mcs",)),
    "chromium": Need("Chromium", ("chromium",), "browser", programs=_CHROMIUM),
    # of the driver that the Python package playwright brings
    "atomic": Need("libatomic", ("libatomic1",), "browser", libraries=("libatomic.so.1",)),
    "npm": Need("npm", ("npm",), "browser", programs=("npm",)),
    "node": Need("node", ("nodejs",), "browser", programs=("node",)),
    "setpriv": Need("setpriv", ("util-linux",), "extra", programs=("setpriv",)),
    "caddy": Need("Caddy", ("caddy",), "extra", programs=("caddy",)),
    "docker": Need("docker", ("docker.io",), "extra", programs=("docker",)),
    "ffprobe": Need("ffprobe", ("ffmpeg",), "extra", programs=("ffprobe",)),
}


@cache
def met(name: str) -> bool:
    return NEEDS[name].met()


def missing(tier: str) -> list[str]:
    """The packages to install for what a tier lacks, in the order of the rows."""
    return [package for name, need in NEEDS.items() if need.tier == tier and not met(name) for package in need.packages]


def program(name: str) -> str | None:
    """The path of the program of that row, None where none of its names starts."""
    return next(filter(None, map(shutil.which, NEEDS[name].programs)), None) if met(name) else None


def require(*names: str) -> None:
    """Skips the test that asks unless all of these are here; the reason says what to install.

    Where GLSPLAT_NEEDS=all the machine was set up for the tests, by .ci/fresh: then it fails.
    """
    import pytest

    __tracebackhide__ = True
    lacking = [NEEDS[name] for name in names if not met(name)]
    if lacking:
        what, packages = (", ".join(n.what for n in lacking), " ".join(p for n in lacking for p in n.packages))
        reason = f"no {what} here: apt-get install {packages}"
        if os.environ.get("GLSPLAT_NEEDS") == "all":
            pytest.fail(f"{reason} (GLSPLAT_NEEDS=all: nothing may be missing)")
        pytest.skip(reason)


if __name__ == "__main__":
    for _tier in sys.argv[1:]:
        print(*missing(_tier))
