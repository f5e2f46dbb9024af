"""``glsplat avatar photo --as mesh``: what it writes, says and refuses."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

import apps.cli as cli
from glsplat.authoring.photo.capture import Finding
from glsplat.authoring.reconstruct import mesh_from_photos, registry
from glsplat.errors import CaptureError, GlsplatError
from glsplat.formats import load
from glsplat.mesh import MeshRenderer
from glsplat.meshes import RiggedMesh
from glsplat.skinning.pose import Pose
from tests.authoring.captures import capture, needs_networks
from tests.authoring.reconstruct.stubs import Meshed, Plain, replace_check

STUBS = "tests.authoring.reconstruct.stubs"
NOTES = {
    "source": "1 photograph (front)",
    "made_by": "glsplat 0.1.0, builtin",
    "date": "2023-11-14",
    "consent": "my own",
    "body_model": "SMPL-X joints (55)",
    "unseen": 0.43,
}


@pytest.fixture
def seen(monkeypatch) -> dict[str, tuple[Finding, ...]]:
    monkeypatch.setitem(registry.OWN, "builtin", f"{STUBS}:Meshed")
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    return replace_check(monkeypatch)


@pytest.fixture
def front(tmp_path) -> Path:
    path = tmp_path / "in" / "front.jpg"
    path.parent.mkdir()
    cv2.imwrite(str(path), np.full((90, 60, 3), 77, np.uint8))
    return path


def photo(*words: object) -> int:
    return cli.main(["avatar", "photo", *map(str, words)])


def test_a_mesh_is_made(seen, front, tmp_path, capsys) -> None:
    out = tmp_path / "me.glb"
    words = (front, "--as", "mesh", "-o", out, "--texture", 256, "--consent", "my own")
    assert photo(*words) == 0
    said = capsys.readouterr().out
    assert said.startswith(f"{out}: 27420 triangles, 256 x 256 texels, ")
    assert said.endswith("43% of the surface is guessed\n")
    mesh = load(out)
    assert isinstance(mesh, RiggedMesh) and dict(mesh.meta) == NOTES and len(mesh.faces) == 27420
    assert [part.name for part in mesh.parts] == ["skin", "eyes", "mouth"]
    first = out.read_bytes()
    assert photo(*words, "--json") == 0 and out.read_bytes() == first
    facts = json.loads(capsys.readouterr().out)
    assert (facts["triangles"], facts["texture"], facts["bytes"]) == (27420, [256, 256], len(first))
    assert (facts["unseen"], facts["made_by"], facts["stature"], facts["overlap"]) == (0.43, "builtin", 1.7, [0.5])
    assert sorted(p.name for p in tmp_path.iterdir()) == ["in", out.name]


def test_from_python(seen, front) -> None:
    mesh = mesh_from_photos(front, texture=300, meta={"consent": "my own"})
    assert dict(mesh.meta) == NOTES and mesh.parts[0].texture.shape == (300, 300, 4)
    with pytest.raises(GlsplatError, match='"Plain" makes splats, no mesh'):
        mesh_from_photos(front, using=Plain())
    with pytest.raises(CaptureError, match="far off"):
        mesh_from_photos(front, using=Meshed(problem="far off"), texture=256)


@pytest.mark.check
@pytest.mark.gl
@pytest.mark.shared
def test_a_capture_with_its_sheet(shared_data, tmp_path, capsys) -> None:
    """The mesh shows what the photograph shows, and the eyes are not white."""
    needs_networks()
    out = tmp_path / "me.glb"
    picture = shared_data / "participants" / "capture" / "p03.jpg"
    assert photo(picture, "--as", "mesh", "-o", out, "--height", 1.64, "--texture", 1024, "--debug", tmp_path) == 0
    assert (tmp_path / "photo.png").stat().st_size > 100_000
    mesh, person = load(out), capture("p03")
    assert isinstance(mesh, RiggedMesh)
    with MeshRenderer(mesh, size=(256, 384)) as renderer:
        drawn = renderer.render([person.camera.resized(256, 384)], Pose(person.pose, person.trans))[0].astype(float)
    small = cv2.resize(person.picture, (256, 384), interpolation=cv2.INTER_AREA)
    inner = cv2.erode(cv2.resize(person.mask.astype(np.uint8), (256, 384)), np.ones((9, 9), np.uint8)) > 0
    inner &= drawn[..., 3] > 250
    away = np.abs(drawn[..., :3] - small)[inner].mean(axis=1)
    assert inner.sum() > 5000 and np.median(away) < 6 and away.mean() < 15
    eyes = next(part for part in mesh.parts if part.name == "eyes")
    assert eyes.texture.shape == (128, 256, 4) and eyes.texture[..., :3].min() < 30
