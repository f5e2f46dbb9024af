"""Without extras the core reads its own formats, and refuses a file of theirs in one line that names the extra."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from glsplat.formats import save
from glsplat.optional import plugin
from tests.formats.scenes import glb_parts, random_avatar, random_splats, write_glb

ROOT = Path(__file__).resolve().parents[2]
# says what each file of the command line is, or why it is refused
SCRIPT = """
import sys, glsplat
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.startswith("glsplat.extras."): raise ModuleNotFoundError(name, name=name)
sys.meta_path.insert(0, Absent())
from glsplat.formats import load_motion
from glsplat.formats import load_scene
skeleton = glsplat.default_avatar().skeleton
for path in sys.argv[1:]:
    try: print("motion", len(load_motion(path, skeleton))) if "motion" in path else print(glsplat.load(path))
    except glsplat.GlsplatError as error: print(error)
"""


def said(*paths: Path) -> list[str]:
    command = [sys.executable, "-c", SCRIPT, *map(str, paths)]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, check=True)
    return run.stdout.splitlines()


def test_formats_of_the_core_are_read(tmp_path: Path) -> None:
    save(random_splats(5), tmp_path / "a.ply")
    save(random_avatar(7), tmp_path / "b.glb")
    (tmp_path / "c.json").write_text(json.dumps({"version": 1, "items": [{"path": "a.ply"}, {"path": "b.glb"}]}))
    (tmp_path / "motion.json").write_text('[{"trans": [0, 0, 0]}, {"trans": [0, 0, 1]}]')
    ply, glb, scene, motion = said(*(tmp_path / name for name in ("a.ply", "b.glb", "c.json", "motion.json")))
    assert ply.startswith("Splats(5") and glb.startswith("Avatar(7") and scene.startswith("Scene(2")
    assert motion == "motion 2"


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("a.spz", b"\x1f\x8b", "the format .spz needs glsplat.extras.formats, which is not installed"),
        ("a.sog", b"PK\3\4", "the format .sog needs glsplat.extras.formats"),
        ("meta.json", b'{"version": 2}', "meta.json needs glsplat.extras.formats"),
        ("a.obj", b"v 0 0 0\n", "the format .obj needs glsplat.extras.formats"),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 1\nproperty uint packed_position\nend_header\n1\n",
         "this is a compressed PLY (packed_position), another format; it needs glsplat.extras.formats"),
        ("a.glb", b"", "triangles are read by glsplat.extras.rigs, which is not installed"),
        ("a.bvh", b"HIERARCHY\n", "the format .bvh needs glsplat.extras.motions"),
        ("motion.bvh", b"HIERARCHY\n", "a motion that is not JSON poses needs glsplat.extras.motions"),
        ("other.bin", b"\0\1\2", "but this is none of them"),
    ],
)  # fmt: skip
def test_a_file_of_an_extra_names_the_extra(tmp_path: Path, name: str, data: bytes, message: str) -> None:
    (tmp_path / name).write_bytes(data)
    if name == "a.glb":
        save(random_splats(3), tmp_path / name)
        tree, blob = glb_parts((tmp_path / name).read_bytes())
        del tree["extensionsUsed"], tree["meshes"][0]["primitives"][0]["extensions"]
        write_glb(tmp_path / name, tree, blob)
    (line,) = said(tmp_path / name)
    assert line.startswith(str(tmp_path / name)) and message in line


def test_a_mistake_within_an_extra_is_no_absence(monkeypatch: pytest.MonkeyPatch) -> None:
    assert plugin("no_such_extra.rows") is None

    def broken(name: str) -> None:
        raise ModuleNotFoundError("no package", name="cv2")

    monkeypatch.setattr("glsplat.optional.import_module", broken)
    with pytest.raises(ModuleNotFoundError, match="no package"):
        plugin("formats.rows")


def test_a_consent_that_nobody_can_check_is_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("glsplat.formats.gltf.output.plugin", lambda name: None)
    avatar = replace(random_avatar(4), meta={"consent": {"file_sha256": "0"}, "source": "a test"})
    save(avatar, tmp_path / "a.glb")
    tree, _ = glb_parts((tmp_path / "a.glb").read_bytes())
    assert "consent" not in tree["asset"]["extras"]["glsplat"]
    assert "the consent is left out: only glsplat.extras.consent, which is not installed" in caplog.text
