"""Avatars with shapes on the command line: inspected, turned, exported."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from apps.cli import main
from glsplat import reference
from glsplat.avatar import Avatar
from glsplat.formats import load, save
from glsplat.scenes.scene_file import upright
from glsplat.skinning.pose import Pose
from glsplat.splats import Level
from tests.skinning.faces import NAMES, expressive


@pytest.fixture
def face(tmp_path: Path) -> Path:
    still = replace(expressive(40), skeleton=(avatar := expressive(400)).skeleton, shapes=None)
    save(replace(avatar, levels=(Level(still, 50.0),)), tmp_path / "face.glb")
    return tmp_path / "face.glb"


def test_inspect_tells_the_shapes(face: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["inspect", str(face), "--json"]) == 0
    shapes = json.loads(capsys.readouterr().out)["avatar"]["shapes"]
    avatar = expressive(400)
    assert avatar.shapes is not None
    assert shapes["names"] == list(NAMES) and shapes["arkit"] == 4 and shapes["levels"] == 0
    assert shapes["entries"] == len(avatar.shapes.targets) and shapes["splats"] < 300
    farthest = np.linalg.norm(avatar.shapes.metres[avatar.shapes.targets == 0], axis=1).max()
    assert shapes["farthest"]["jawOpen"] == pytest.approx(farthest)
    assert main(["inspect", str(face)]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "4 (jawOpen, eyeBlinkLeft, mouthSmileRight, browInnerUp), 4 of ARKit's 52" in text
    assert "1 coarser level keeps a still face" in text


def test_a_turned_avatar_moves_its_face_as_before(face: Path, tmp_path: Path) -> None:
    assert main(["convert", str(face), str(tmp_path / "b.glb"), "--up", "z", "--quiet"]) == 0
    before, after = load(face), load(tmp_path / "b.glb")
    assert isinstance(before, Avatar) and isinstance(after, Avatar)
    assert before.shapes is not None and after.shapes is not None
    weights, turn = np.array([0.5, 1, 0, 0.3]), upright("z")[:3, :3]
    one = reference.expressed(before.splats, before.shapes, weights)
    other = reference.expressed(after.splats, after.shapes, weights)
    assert np.abs(other.means - one.means @ turn.T).max() < 1e-5
    sigma = [p.shapes @ p.shapes.transpose(0, 2, 1) for p in (one, other)]
    assert np.abs(sigma[1] - turn @ sigma[0] @ turn.T).max() < 1e-5


def test_an_exported_pose_has_its_expression(face: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pose = tmp_path / "pose.json"
    pose.write_text(json.dumps({"joints": {}, "expression": {"jawOpen": 1.0}}))
    assert main(["avatar", "export", str(face), "--pose", str(pose), "-o", str(tmp_path / "a.ply"), "--quiet"]) == 0
    avatar, found = expressive(400), load(tmp_path / "a.ply")
    weights = avatar.weights(Pose(np.zeros((4, 3)), expression={"jawOpen": 1.0}))
    assert weights is not None and not isinstance(found, Avatar)
    wanted = reference.expressed(avatar.splats, avatar.shapes, weights)  # type: ignore[arg-type]
    assert found.means == pytest.approx(wanted.means, abs=1e-6)
    made, sigma = reference.rest(found).shapes, wanted.shapes @ wanted.shapes.transpose(0, 2, 1)
    assert np.abs(made @ made.transpose(0, 2, 1) - sigma).max() < 1e-6
