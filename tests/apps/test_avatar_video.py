"""``glsplat avatar video``: what it makes, says and refuses; a maker that needs no work stands in."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import apps.avatar.video as video
import apps.cli as cli
from glsplat.data import default_avatar
from glsplat.errors import CaptureError
from glsplat.extras.authoring.body.open_body import open_body
from glsplat.extras.rigs.meshes.reader import read_gltf_person
from glsplat.formats import load
from glsplat.meshes import MeshPart, RiggedMesh
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES, PARENTS


def mesh() -> RiggedMesh:
    body = open_body()
    part = MeshPart("skin", body.faces[:500], body.uv[:500], np.full((8, 8, 4), 255, np.uint8))
    skeleton = Skeleton.from_joints(JOINT_NAMES, list(PARENTS), body.joints)
    return RiggedMesh(body.vertices, skeleton, body.skin_joints.astype(np.int64), body.skin_weights, (part,))


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What the maker was asked for."""
    seen: dict[str, Any] = {}

    def from_video(*sources: Path, **words: Any) -> Any:
        seen.update(words, sources=sources)
        words["options"].progress("looking at the frames", 0.5)
        thing = mesh() if words["form"] == "mesh" else default_avatar()
        return SimpleNamespace(
            content=thing,
            frames=[SimpleNamespace(name="frame 3", turn=12.34)],
            fit=SimpleNamespace(views=[SimpleNamespace(overlap=0.971234)], stature=1.7412),
            unseen=0.0512,
            problem="",
            left_out=("frame 9 is left out: nobody is found in the picture",),
        )

    monkeypatch.setattr(video, "from_video", from_video)
    return seen


def filmed(*words: object) -> int:
    return cli.main(["avatar", "video", *map(str, words)])


def test_a_mesh_is_made(asked: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "me.glb"
    assert filmed("turn.mp4", "-o", out, "--height", "1.74", "--texture", "512", "--consent", "my own") == 0
    said = capsys.readouterr().out.splitlines()
    assert said[0].startswith(f"{out}: 500 triangles, 8 x 8 texels") and said[0].endswith(
        "; 5% of the surface is guessed"
    )
    assert said[1:] == ["frame 9 is left out: nobody is found in the picture"]
    assert asked["form"] == "mesh" and asked["frames"] == 30 and asked["meta"] == {"consent": "my own"}
    assert asked["options"].height == 1.74 and asked["options"].texture == 512
    assert len(read_gltf_person(out).faces) == 500


def test_splats_are_made(asked: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, pictures = tmp_path / "me.glb", [tmp_path / f"{number}.jpg" for number in range(9)]
    words = ("--as", "splats", "--splats", "5000", "--steps", "2", "--seed", "3", "--anyway", "--json")
    assert filmed(*pictures, "-o", out, *words) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["splats"] == len(load(out).splats) and facts["unseen"] == 0.0512 and facts["stature"] == 1.7412
    assert facts["frames"] == [{"name": "frame 3", "turn": 12.3, "overlap": 0.9712}] and len(facts["left_out"]) == 1
    options = asked["options"]
    assert (options.splats, options.steps, options.seed) == (5000, 2, 3)
    assert asked["sources"] == tuple(pictures) and asked["anyway"] and asked["form"] == "splats"


def test_frames_that_will_not_do(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: Any) -> None:
    def refuse(*sources: Path, **words: Any) -> None:
        raise CaptureError("the person turns by 12 degrees only; let them turn on the spot once, all around")

    monkeypatch.setattr(video, "from_video", refuse)
    out = tmp_path / "me.glb"
    assert filmed("turn.mp4", "-o", out) == 1
    assert capsys.readouterr().err.strip().endswith("all around; --anyway goes on all the same, where it can")
    assert filmed("turn.mp4", "-o", out, "--anyway") == 1
    assert capsys.readouterr().err.strip().endswith("all around") and not out.exists()
