"""The wheel has everything: built, installed into an empty place, it renders from there."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

pytestmark = pytest.mark.check

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.gl
def test_the_wheel_renders_from_elsewhere(tmp_path: Path) -> None:
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet"]
    subprocess.run([*pip, "wheel", "--no-deps", "-w", str(tmp_path), str(ROOT)], check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    names = zipfile.ZipFile(wheel).namelist()
    assert not [n for n in names if n.startswith(("apps/", "tests/"))]
    assert "glsplat/py.typed" in names and "glsplat/data/people/ben.glb" in names
    tables = {
        f"glsplat/extras/authoring/fit/{name}.json" for name in ("landmark_offsets", "hand_offsets", "face_places")
    }
    tables.add("glsplat/extras/authoring/models/catalogue.toml")
    assert "glsplat/data/open_body.npz" in names and tables <= set(names)
    assert len([n for n in names if n.startswith("glsplat/extras/authoring/templates/data/")]) == 16
    shaders = {p.name for p in (ROOT / "glsplat").rglob("*.glsl")}
    assert shaders == {Path(n).name for n in names if n.endswith(".glsl")}
    page = {p.relative_to(ROOT).as_posix() for p in (ROOT / "glsplat").glob("**/web/**/*") if p.is_file()}
    assert {"glsplat/net/web/index.html", "glsplat/extras/browser/web/alone/index.html"} < page <= set(names)
    packages = {p.parent.relative_to(ROOT).as_posix() for p in (ROOT / "glsplat").rglob("__init__.py")}
    assert packages <= {str(Path(n).parent) for n in names}
    site = tmp_path / "site"
    subprocess.run([*pip, "install", "--no-deps", "--target", str(site), str(wheel)], check=True, capture_output=True)
    script = (
        "import sys, glsplat; sys.path.insert(0, sys.argv[1])\n"
        "for name in [n for n in sys.modules if n.startswith('glsplat')]: del sys.modules[name]\n"
        "import glsplat; assert glsplat.__file__.startswith(sys.argv[1]), glsplat.__file__\n"
        "from glsplat_apps.cli import main; sys.exit(main(sys.argv[2:]))\n"
    )
    command = [sys.executable, "-c", script, str(site), "render", "--size", "64", "--stereo", "-o", "out.png"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out.png").stat().st_size > 500
