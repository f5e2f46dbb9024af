"""Test against Monado itself, as root, in the root GLSPLAT_MONADO_ROOT that tools/peers/monado/chroot.sh makes.

Its null compositor shows nothing and takes 20 frames per second; its "remote" driver receives head, hands, fingers and
the eyes' fields of view. The validation layer of Khronos' SDK checks every call except in timed scenarios.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(os.environ.get("GLSPLAT_MONADO_ROOT", "/var/tmp/glsplat-monado"))
LONGEST = 1800  # seconds of a scenario on a busy machine

pytestmark = pytest.mark.timeout(LONGEST + 60)

CONFIG = {"active": "remote", "remote": {"version": 0, "port": 4242}}


@cache
def ran(scenario: str, module: str = "session") -> dict[str, Any]:
    """Return the results of a module of tools/peers/monado, run within the chroot."""
    if not (ROOT / "usr/bin/monado-service").exists():
        pytest.fail(f"no Monado in {ROOT}: sudo sh tools/peers/monado/chroot.sh {ROOT}")
    home = ROOT / "root/.config/monado"
    home.mkdir(parents=True, exist_ok=True)
    (home / "config_v0.json").write_text(json.dumps(CONFIG))
    (ROOT / "tmp/run").mkdir(exist_ok=True, mode=0o700)
    settings = {
        **{"HOME": "/root", "PATH": "/usr/bin:/bin", "XDG_RUNTIME_DIR": "/tmp/run", "PYTHONPATH": "/src"},
        **{"LIBGL_ALWAYS_SOFTWARE": "1", "PYTHONDONTWRITEBYTECODE": "1"},
    }
    words = [f"{key}={value}" for key, value in settings.items()]
    inside = ["sh", "-c", f"cd /src && exec /venv/bin/python -m tools.peers.monado.{module} {scenario}"]
    command = ["chroot", str(ROOT), "env", "-i", *words, *inside]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, **pipes, text=True, start_new_session=True) as done:  # type: ignore[call-overload]
        try:
            said, complained = done.communicate(timeout=LONGEST)
        finally:
            with suppress(ProcessLookupError):
                os.killpg(done.pid, signal.SIGKILL)  # also the service, if the session failed
    assert done.returncode == 0, complained[-4000:]
    return dict(json.loads(said.splitlines()[-1]))


def complaints(found: dict[str, Any]) -> list[str]:
    """Return the complaints of the validation layer, after checking that it was loaded."""
    assert any("CoreValidation-Initialize" in line for line in found["validation"])
    return [line for line in found["validation"] if "VALID_DEBUG" not in line]


@pytest.mark.parametrize(
    ("scenario", "binding"), [("pictures", "XR_MNDX_egl_enable"), ("window", "XR_KHR_opengl_enable")]
)
def test_images_equal_render_to_the_bit_and_tracking_arrives(scenario: str, binding: str) -> None:
    """Run six scripts of head, eyes, asymmetric fields of view, hands and curls, by EGL and by GLX."""
    found = ran(scenario)
    assert binding in found["extensions"]
    assert ("XR_MNDX_egl_enable" in found["extensions"]) == (scenario == "pictures")
    assert found["layers"] == 2 and found["depth"] and found["covered"] > 0.02
    assert found["differing"] == [0] * 6 and found["deeper"] < 2e-3
    assert found["joints"] == 25 and found["most"] < 1e-4 and found["finger"] < 1e-4
    assert not complaints(found)


def test_3000_frames_without_a_word_of_the_validation_layer() -> None:
    found = ran("frames")
    assert found["rendered"] >= 3000 and found["focused"] and found["left"] and not found["said"]
    assert not complaints(found)


def test_a_runtime_that_is_killed_and_started_anew() -> None:
    found = ran("restart")
    assert found["losses"] == 1 and found["after"] >= 20 and found["left"]
    assert found["said"][-1].endswith("is back") and not complaints(found)


def test_the_layer_does_complain() -> None:
    """Check that the layer reports a frame of a destroyed space."""
    assert complaints(ran("wrong"))


def test_extensions_that_monado_lacks_as_pyopenxr_carries_them() -> None:
    """Fill structures of body, face and passthrough as a runtime would, and read them by the binding."""
    found = ran("", "extensions")
    assert len(found["body"]) == 84 and found["body"][70] is None and len(found["hand"]) == 26
    for joints in (found["body"], found["hand"]):
        for i, joint in enumerate(joints):
            assert joint is None or joint == pytest.approx([i, 2 * i, 3 * i, 0, 0, 0.6, 0.8])
    assert found["face"] == pytest.approx([i / 100 for i in range(70)])
    assert found["eyes"] == pytest.approx([i / 50 for i in range(14)]) and len(found["lips"]) == 37
    assert found["asked"] == [1000274000, 2, 1, 1, 2]  # full body, right hand, one source, eyes, lips
    assert found["calls"].count("destroyed") == 5 and found["running"] == [1, 1]
    layers = [1000118003, 35]  # XR_TYPE_COMPOSITION_LAYER_PASSTHROUGH_FB below ..._PROJECTION
    first, second = found["ended"][:3], found["ended"][3:6]
    assert first[0] == second[0] == [1, layers] and first[2] == second[2] == [0, 1]
    assert first[1] == pytest.approx([2, 0.25, -0.75, 0.05]) and second[1] == pytest.approx([2, 1.25, -0.75, 0.05])
    assert found["ended"][6] == [1, []]


def test_time_between_located_views_and_the_frames_end() -> None:
    assert ran("time")["overhead_ms"] <= 1.5
