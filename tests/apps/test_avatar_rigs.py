"""glsplat avatar make on other people's rigs: driven at first try, mended by a map, or told why not."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from apps.cli import main
from glsplat.avatar import Avatar
from glsplat.extras.rigs.meshes.reader import read_gltf_person
from glsplat.formats import load
from glsplat.formats.motion_files import load_motion
from glsplat.skinning.pose import Pose
from glsplat.skinning.smplx import JOINT_NAMES
from tests.extras.rigs.gltf.built import FAMILIES, Family, build

pytestmark = [pytest.mark.gl, pytest.mark.usefixtures("quickly_made")]

QUICK = ["--splats", "600", "--steps", "0", "--no-cones"]
SILENT = replace(FAMILIES["Unreal"], names={joint: f"b{n:02d}" for n, joint in enumerate(FAMILIES["Unreal"].names)})
ONE_ARMED = replace(
    SILENT, names={joint: name for joint, name in SILENT.names.items() if not joint.startswith(("right_el", "right_w"))}
)


def written(tmp_path: Path, family: Family) -> Path:
    path = tmp_path / "person.glb"
    path.write_bytes(build(replace(family, twists=(), more={})).data)
    return path


def made(tmp_path: Path, person: Path, *more: str) -> Avatar:
    assert main(["avatar", "make", str(person), "-o", str(tmp_path / "me.glb"), *QUICK, *more]) == 0
    avatar = load(tmp_path / "me.glb")
    assert isinstance(avatar, Avatar)
    return avatar


def test_an_avatar_walks_as_its_mesh_does(tmp_path, capsys) -> None:
    person = written(tmp_path, FAMILIES["Mixamo, centimetres"])
    avatar, mesh = made(tmp_path, person), read_gltf_person(person)
    assert capsys.readouterr().err == ""
    assert avatar.skeleton.names == JOINT_NAMES
    assert avatar.meta["rig"] == mesh.meta["rig"] and len(avatar.meta["rig"]) > 50
    motion = load_motion("walk", avatar.skeleton)
    for frame in (0, len(motion) // 2):
        bones = motion.pose(frame).bones(avatar.skeleton)
        blended = np.einsum("nk,nkij->nij", avatar.skin.weights, bones[avatar.skin.joints])
        means = np.einsum("nij,nj->ni", blended[:, :, :3], avatar.splats.means) + blended[:, :, 3]
        vertices = mesh.posed(motion.pose(frame))
        for axis in range(3):
            assert abs(means[:, axis].min() - vertices[:, axis].min()) < 0.02
            assert abs(means[:, axis].max() - vertices[:, axis].max()) < 0.02


@pytest.mark.check
def test_a_rig_that_says_nothing_is_told_by_its_shape_or_by_a_map(tmp_path, capsys) -> None:
    person = written(tmp_path, SILENT)
    avatar = made(tmp_path, person)
    said = capsys.readouterr().err
    assert "22 joints have no name that says what they are, and are told by where they are" in said
    rig = avatar.meta["rig"]
    assert avatar.skeleton.names == JOINT_NAMES and len(rig) == 22
    assert {joint: SILENT.names[joint] for joint in rig} == rig
    names = tmp_path / "map.json"
    names.write_text(json.dumps(SILENT.names))
    driven = made(tmp_path, person, "--rig-map", str(names))
    assert capsys.readouterr().err == "" and driven.skeleton.names == JOINT_NAMES
    assert driven.meta["rig"] == dict(SILENT.names)


def test_what_no_person_is_keeps_its_joints(tmp_path, capsys) -> None:
    avatar = made(tmp_path, written(tmp_path, ONE_ARMED))
    said = capsys.readouterr().err
    assert "cannot be driven by motions or a headset: no joint has a name that says what it is" in said
    assert avatar.skeleton.names[0] == "b00" and "rig" not in avatar.meta
    assert main(["render", str(tmp_path / "me.glb"), "--motion", "walk", "-o", str(tmp_path / "x.png")]) == 1
    refused = capsys.readouterr().err
    assert refused.count("\n") == 1 and "walk cannot drive this avatar: no joint for head, left_hip" in refused


@pytest.mark.check
def test_wrong_maps_are_one_line(tmp_path, capsys) -> None:
    person, names = written(tmp_path, FAMILIES["Unreal"]), tmp_path / "map.json"
    make = ["avatar", "make", str(person), "-o", str(tmp_path / "me.glb"), *QUICK, "--rig-map", str(names)]
    for text, words in (
        ("{", "map.json: a rig map is JSON"),
        ("[]", "map.json: a rig map is an object of names"),
        ('{"left_leg": "thigh_l"}', "map.json: a rig map names joints of SMPL-X"),
        ('{"left_hip": 3}', "map.json: left_hip needs the name of a node"),
        ('{"left_hip": "nobody"}', 'left_hip the node "nobody", which the file does not have'),
        ('{"left_hip": "head", "head": "head"}', "gives the joint 'head' twice"),
    ):
        names.write_text(text)
        assert main(make) == 1 and not (tmp_path / "me.glb").exists()
        assert words in (said := capsys.readouterr().err) and said.count("\n") == 1
    names.write_text('{"head": null, "spine1": "spine_02"}')  # a person without a head is made, and cannot be driven
    assert main(make) == 0 and "no joint for head" in capsys.readouterr().err


@pytest.mark.check
def test_a_thing_of_no_size_that_things_have_and_its_axes(tmp_path, capsys) -> None:
    """Its joints are its own: nothing says how large it is, or which way is up, but the user."""
    person = written(tmp_path, ONE_ARMED)
    upright = made(tmp_path, person)
    assert "from end to end" not in capsys.readouterr().err
    large = made(tmp_path, person, "--extra-scale", "4", "--up", "z")
    said = [line for line in capsys.readouterr().err.splitlines() if "from end to end" in line]
    assert len(said) == 1 and " m from end to end; --extra-scale " in said[0] and said[0].endswith(" would make it 1 m")
    better = float(said[0].split("--extra-scale ")[1].split()[0])
    assert 1 / better == pytest.approx(float(said[0].split(" m from")[0].split()[-1]) / 4, rel=0.05)
    turn = 4 * np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])  # what pointed to z points to y
    assert large.skeleton.joints == pytest.approx(upright.skeleton.joints @ turn.T, abs=1e-5)
    assert np.abs(Pose.zero(len(large.skeleton)).bones(large.skeleton) - np.eye(4)[:3]).max() < 1e-4


@pytest.mark.shared
@pytest.mark.check
def test_a_real_file(shared_data: Path, tmp_path) -> None:
    avatar = made(tmp_path, shared_data / "real" / "models" / "cool_loops.vrm")
    assert avatar.skeleton.names == JOINT_NAMES and len(avatar.splats) >= 500
    assert np.isfinite(Pose.zero().bones(avatar.skeleton)).all()
