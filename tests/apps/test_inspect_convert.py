"""The inspect and convert commands, also on avatars with levels of detail and with shapes of the face."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from apps import cli
from apps.avatar import detail
from glsplat import reference
from glsplat.avatar import Avatar
from glsplat.extras.authoring.finish.level_measure import MeasureConfig
from glsplat.extras.rigs.meshes.reader import read_gltf_person
from glsplat.extras.rigs.meshes.write import save_gltf_mesh
from glsplat.formats import load, save
from glsplat.formats.scene_file import upright
from glsplat.skinning.pose import Pose
from glsplat.splats import Level, Splats
from tests.apps.cli import mistake, ok
from tests.extras.rigs.meshes import bends, chain, corners
from tests.formats.scenes import (
    avatar_with_levels,
    awkward_splats,
    edit_glb,
    glb_parts,
    random_avatar,
    random_splats,
    splats_with_levels,
)
from tests.scenes import cloud
from tests.skinning.faces import NAMES, expressive


def described(capsys: pytest.CaptureFixture[str], *arguments: object) -> dict[str, Any]:
    return json.loads(ok(capsys, "inspect", *arguments, "--json"))


def test_inspect_counts_ranges_and_sizes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    splats = random_splats(200, 2)
    save(splats, tmp_path / "a.ply")
    report = described(capsys, tmp_path / "a.ply")
    assert (report["format"], report["kind"], report["splats"], report["sh_degree"]) == ("ply", "splats", 200, 2)
    assert report["file_bytes"] == (tmp_path / "a.ply").stat().st_size
    assert report["memory_bytes"] == splats.nbytes == 200 * 4 * (3 + 4 + 3 + 1 + 27)
    np.testing.assert_allclose(report["bounds"]["max"], splats.means.max(axis=0))
    np.testing.assert_allclose(report["scale"]["p50"], np.median(splats.scales.max(axis=1)), rtol=1e-5)
    np.testing.assert_allclose(report["opacity"]["p100"], splats.opacities.max(), rtol=1e-5)
    assert report["unusual"] == {}
    assert report["antialias"] is False and report["cones"] is False
    save(with_extras(random_splats()), tmp_path / "a.glb")
    report = described(capsys, tmp_path / "a.glb")
    assert report["antialias"] is True and report["cones"] is True
    text = ok(capsys, "inspect", tmp_path / "a.glb")
    assert "opacity compensation wanted" in text and "every splat has one" in text


def with_extras(splats: Splats) -> Splats:
    return replace(splats, antialias=True, cones=np.full((len(splats), 4), 9, np.int8))


def test_inspect_finds_what_is_unusual(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    base = random_splats(1000)
    means, quats, scales, opacities = base.means.copy(), base.quats.copy(), base.scales.copy(), base.opacities.copy()
    means[0] = 1e6
    means[1, 0] = np.nan
    quats[2:4] = 0
    scales[4], scales[5:8, 0], scales[8, 1] = (1, 1, 1e-4), 0, -0.01
    opacities[9], opacities[10:15], opacities[15] = 1.5, 0.001, -1
    save(Splats(means, quats, scales, opacities, base.sh), tmp_path / "a.glb")
    assert described(capsys, tmp_path / "a.glb")["unusual"] == {
        "not_finite": 1,
        "zero_quaternions": 2,
        "negative_scales": 1,
        "zero_scales": 3,
        "needles": 1,
        "opacities_outside": 2,
        "invisible": 6,
        "outliers": 1,
    }


def test_inspect_an_avatar(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    avatar = random_avatar()
    notes = {"source": "1 photograph (front)", "unseen": 0.43, "consent": "my own", "licence": "CC0"}
    save(replace(avatar, meta=notes), tmp_path / "a.glb")
    report = described(capsys, tmp_path / "a.glb")
    rig = report["avatar"]
    assert (report["kind"], rig["joints"], rig["influences"]) == ("avatar", 5, 4)
    assert rig["roots"] == ["bone 0", "bone 4"] and rig["meta"]["unseen"] == 0.43 and rig["rest_offset"] < 1e-5
    assert rig["weight_lost"] == avatar.skin.lost > 0.05  # five influences cut to four
    assert sum(rig["splats_per_joint"].values()) == 40
    strongest = np.take_along_axis(avatar.skin.joints, avatar.skin.weights.argmax(1)[:, None], 1)
    assert rig["splats_per_joint"]["bone 2"] == int((strongest == 2).sum())
    text = ok(capsys, "inspect", tmp_path / "a.glb")
    assert "unseen       43% of the surface was in no photograph and is guessed" in text
    assert "consent      my own" in text and "source       1 photograph (front)" in text
    for odd in ({"unseen": "all"}, {"unseen": 7}, {}):
        save(replace(avatar, meta=odd), tmp_path / "a.glb")
        text = ok(capsys, "inspect", tmp_path / "a.glb")
        assert "is guessed" not in text and "consent      not stated" in text
    splats = awkward_splats().take([i % 10 for i in range(40)])
    save(replace(avatar, splats=splats, meta={"a\x1b[2J": "\x07\n" * 9}), tmp_path / "a.glb")  # hostile
    text = ok(capsys, "inspect", tmp_path / "a.glb")
    assert "avatar, glb, 40 splats, SH degree 1" in text and "20 not_finite: NaN or infinity" in text
    assert "5 joints, roots bone 0, bone 4; 4 influences a splat" in text
    assert "\x1b" not in text and "\x07" not in text and max(map(len, text.splitlines()[1:])) <= 110


def test_inspect_no_splats(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for empty in (random_splats(0), awkward_splats().take([1])):
        save(empty, tmp_path / "a.ply")
        report = described(capsys, tmp_path / "a.ply")
        assert report["splats"] == len(empty) and report["bounds"] is None
        ok(capsys, "inspect", tmp_path / "a.ply")


def test_strict(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    save(awkward_splats(), tmp_path / "a.ply")
    for command in (["inspect", tmp_path / "a.ply"], ["convert", tmp_path / "a.ply", tmp_path / "b.glb"]):
        assert "5 of 10 splats hold NaN or infinity" in mistake(capsys, *command, "--strict")
    assert not (tmp_path / "b.glb").exists()


# --- convert --------------------------------------------------------------------------------------------------------


def test_losses_are_said_in_numbers(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    save(random_splats(500, 1), tmp_path / "a.glb")
    words = ["convert", str(tmp_path / "a.glb"), str(tmp_path / "b.splat")]
    assert cli.main(words) == 0
    before, after = capsys.readouterr().err.splitlines()
    assert before.endswith("spherical harmonics of degree 1 are dropped, the file holds degree 0")
    assert f"glsplat convert: {words[2]}: read back, off by at most (mean): rotations 0." in after
    assert "positions" not in after and "scales" not in after  # floats in the file
    assert "opacities 0.00" in after and "view-dependent colours" in after
    written = (tmp_path / "b.splat").read_bytes()
    assert cli.main([*words, "--quiet"]) == 0
    assert capsys.readouterr().err == "" and (tmp_path / "b.splat").read_bytes() == written
    avatar = random_avatar()
    rig, cones, compensation = (
        "the rig of 5 joints is dropped",
        "visibility cones are dropped",
        "compensation is dropped",
    )
    save(replace(avatar, splats=with_extras(avatar.splats)), tmp_path / "a.glb")
    for suffix, lost in ((".ply", (rig, cones)), (".splat", (rig, cones, compensation)), (".gltf", ())):
        assert cli.main(["convert", str(tmp_path / "a.glb"), str(tmp_path / f"b{suffix}")]) == 0
        said = capsys.readouterr().err
        assert tuple(loss for loss in (rig, cones, compensation) if loss in said) == lost
    save(awkward_splats(), tmp_path / "a.glb")
    assert cli.main(["convert", str(tmp_path / "a.glb"), str(tmp_path / "b.ply")]) == 0
    assert "1 splats with negative scales" in capsys.readouterr().err


def test_a_mesh_is_converted_turned_and_described(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mesh = chain()
    save_gltf_mesh(mesh, tmp_path / "a.glb")
    assert cli.main(["convert", str(tmp_path / "a.glb"), str(tmp_path / "b.gltf"), "--up", "z"]) == 0
    turned = read_gltf_person(tmp_path / "b.gltf")
    pose = bends(mesh)
    straight, lying = (corners(m, Pose(pose.rotations)) for m in (mesh, turned))
    np.testing.assert_allclose(lying, straight @ upright("z")[:3, :3].T, atol=1e-5)
    report = described(capsys, tmp_path / "b.gltf")
    assert report["kind"] == "mesh" and report["file_bytes"] == (tmp_path / "b.gltf").stat().st_size
    (item,) = report["items"]
    assert item["textures"] == [["whole", 64, 64], ["holes", 32, 16]] and item["meta"]["consent"] == "nobody real"
    assert (item["triangles"], item["joints"]) == (80, 10)
    assert cli.main(["convert", str(tmp_path / "a.glb"), str(tmp_path / "c.ply")]) == 1
    assert "c.ply: a mesh is written as .glb or .gltf" in capsys.readouterr().err
    assert not (tmp_path / "c.ply").exists()


def test_inspect_lists_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    save(avatar_with_levels(), tmp_path / "a.glb")
    first, second, _ = json.loads(ok(capsys, "inspect", tmp_path / "a.glb", "--json"))["levels"]
    assert [first[key] for key in ("splats", "density", "metres", "psnr")] == [20, 200.0, 2.56, 41.5]
    assert second["psnr"] is None and "20 splats from 2.6 m on" in ok(capsys, "inspect", tmp_path / "a.glb")


def test_inspect_says_which_are_broken(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    save(splats_with_levels(), tmp_path / "a.glb")
    edit_glb(tmp_path / "a.glb", lambda document: document["nodes"][2].pop("extras"))
    assert cli.main(["inspect", str(tmp_path / "a.glb")]) == 0
    assert f"{tmp_path / 'a.glb'}: level of detail 2 is left out: it has no density" in caplog.text
    assert cli.main(["inspect", str(tmp_path / "a.glb"), "--strict"]) == 1


def test_convert_keeps_them_and_turns_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, scene in (("a", avatar_with_levels()), ("s", splats_with_levels())):
        save(scene, tmp_path / f"{name}.glb")
        assert ok(capsys, "convert", tmp_path / f"{name}.glb", tmp_path / f"{name}2.glb", "--up", "z") == ""
        found = load(tmp_path / f"{name}2.glb", strict=True)
        assert type(found) is type(scene) and len(found.levels) == 3
        whole = found.splats if isinstance(found, Avatar) else found
        for one, other in zip(found.levels, scene.levels, strict=True):
            assert (one.density, one.psnr) == (other.density, other.psnr)
            splats = one.content.splats if isinstance(one.content, Avatar) else one.content
            np.testing.assert_allclose(splats.means, whole.means[: len(splats)], atol=1e-6)  # turned as the finest is
            np.testing.assert_allclose(splats.scales, whole.scales[: len(splats)], rtol=1e-6)


@pytest.mark.check
@pytest.mark.gl
@pytest.mark.usefixtures("gl")
def test_levels_are_added_to_a_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    quick = partial(MeasureConfig, directions=2, inside=0, size=96)
    monkeypatch.setattr(detail, "MeasureConfig", quick)
    save(cloud(300, spread=0.2), tmp_path / "a.ply")
    command = ["avatar", "levels", tmp_path / "a.ply", "-o", tmp_path / "a.glb", "--psnr", "20"]
    facts = json.loads(ok(capsys, *command, "--counts", "150", "75", "--json"))
    found = load(tmp_path / "a.glb", strict=True)
    assert facts["splats"] == 300 and [one["splats"] for one in facts["levels"]] == [
        len(level.content) for level in found.levels if isinstance(level.content, Splats)
    ]
    assert found.levels and all(one["psnr"] >= 20 - MeasureConfig().slack for one in facts["levels"])
    first = (tmp_path / "a.glb").read_bytes()
    out = ok(capsys, *command, "--counts", "150", "75")
    assert (tmp_path / "a.glb").read_bytes() == first and "from" in out and "dB at worst" in out
    assert len(glb_parts(first)[0]["nodes"]) == 1 + len(found.levels)


@pytest.fixture
def face(tmp_path: Path) -> Path:
    still = replace(expressive(40), skeleton=(avatar := expressive(400)).skeleton, shapes=None)
    save(replace(avatar, levels=(Level(still, 50.0),)), tmp_path / "face.glb")
    return tmp_path / "face.glb"


def test_inspect_tells_the_shapes(face: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["inspect", str(face), "--json"]) == 0
    found, shapes = json.loads(capsys.readouterr().out)["avatar"]["shapes"], expressive(400).shapes
    assert shapes is not None and found["names"] == list(NAMES) and (found["arkit"], found["levels"]) == (4, 0)
    farthest = np.linalg.norm(shapes.metres[shapes.targets == 0], axis=1).max()
    assert found["farthest"]["jawOpen"] == pytest.approx(farthest) and found["entries"] == len(shapes.targets)
    assert cli.main(["inspect", str(face)]) == 0 and "4 of ARKit's 52" in capsys.readouterr().out


def test_a_turned_avatar_moves_its_face_as_before(face: Path, tmp_path: Path) -> None:
    assert cli.main(["convert", str(face), str(tmp_path / "b.glb"), "--up", "z", "--quiet"]) == 0
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
    assert cli.main(["avatar", "export", str(face), "--pose", str(pose), "-o", str(tmp_path / "a.ply"), "--quiet"]) == 0
    avatar, found = expressive(400), load(tmp_path / "a.ply")
    weights = avatar.weights(Pose(np.zeros((4, 3)), expression={"jawOpen": 1.0}))
    assert weights is not None and not isinstance(found, Avatar)
    wanted = reference.expressed(avatar.splats, avatar.shapes, weights)  # type: ignore[arg-type]
    assert found.means == pytest.approx(wanted.means, abs=1e-6)
    made, sigma = reference.rest(found).shapes, wanted.shapes @ wanted.shapes.transpose(0, 2, 1)
    assert np.abs(made @ made.transpose(0, 2, 1) - sigma).max() < 1e-6
