"""The house: imports go down only, files keep one purpose, the root exports what it says."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import glsplat

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "glsplat"

# lower floors first; a module imports only from floors below its own, or from its own floor
FLOORS = [
    ["errors"],
    ["arrays"],
    ["splats", "camera", "config", "pictures", "timing"],
    ["skinning"],
    ["avatar"],
    ["formats", "reference", "tracking"],
    ["shaders"],
    ["current", "gl_state"],
    ["owner"],
    ["context"],
    ["passes"],
    ["mesh"],
    ["renderer", "renderer_thread"],
    ["net"],
]
FLOOR = {name: level for level, names in enumerate(FLOORS) for name in names}
EXCEPTIONS = {
    ("avatar", "formats"),  # default_avatar() reads the embedded file, inside the function
    ("skinning", "avatar"),  # surface and importers make avatars
    ("skinning", "reference"),
    ("skinning", "formats"),
}
FORBIDDEN = {"net": {"moderngl", "glfw"}, "tracking": {"moderngl", "glfw", "cv2"}, "formats": {"moderngl"}}
FILES = sorted(p for p in PACKAGE.rglob("*.py"))


def imports_of(path: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            found.add(node.module)
    return found


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_imports_go_down(path: Path) -> None:
    room = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
    if room in ("__init__", "data"):
        return
    for name in imports_of(path):
        parts = name.split(".")
        assert parts[0] not in ("glsplat_apps", "apps", "tests", "glfw"), f"{path.name} imports {name}"
        assert parts[0] not in FORBIDDEN.get(room, set()), f"{path.name} imports {name}"
        if parts[0] == "glsplat" and len(parts) > 1 and (room, parts[1]) not in EXCEPTIONS:
            assert FLOOR[parts[1]] <= FLOOR[room], f"{path.relative_to(ROOT)} imports up: {name}"


LIMITS = {".py": 400, ".glsl": 90}


@pytest.mark.parametrize("suffix", LIMITS)
def test_files_stay_small(suffix: str) -> None:
    files = [p for folder in ("glsplat", "apps") for p in (ROOT / folder).rglob(f"*{suffix}")]
    assert files
    long = {str(p.relative_to(ROOT)): n for p in files if (n := len(p.read_text().splitlines())) > LIMITS[suffix]}
    assert not long


def test_public_names() -> None:
    assert len(glsplat.__all__) <= 18
    for name in glsplat.__all__:
        assert getattr(glsplat, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        glsplat.nonsense  # noqa: B018


def test_tracking_and_protocol_work_without_opengl() -> None:
    script = "import sys, glsplat.tracking, glsplat.net.messages; assert 'moderngl' not in sys.modules"
    subprocess.run([sys.executable, "-c", script], check=True)
