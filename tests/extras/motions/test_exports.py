"""A known walk as BVH in the conventions of exporters: bones point and people go where the known motion has them."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from glsplat.extras.motions.bvh import parse_bvh
from glsplat.formats.motion_files import load_motion
from glsplat.motion.motion import Motion
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES
from tests.extras.motions.exports import AT, SIDES, Z_UP, Export

BONES = [
    (f"{side}_{a}", f"{side}_{b}")
    for side in SIDES
    for a, b in (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"))
]


def named(trunk: str, limbs: str, left: str, right: str) -> dict[str, str]:
    """Of pelvis, three of the spine, neck and head ("-": none); of a side's eight joints from hip and collar on."""
    out = dict(zip(("pelvis", "spine1", "spine2", "spine3", "neck", "head"), trunk.split(), strict=True))
    parts = ("hip", "knee", "ankle", "foot", "collar", "shoulder", "elbow", "wrist")
    for side, mark in (("left", left), ("right", right)):
        out |= {f"{side}_{part}": name.replace("#", mark) for part, name in zip(parts, limbs.split(), strict=True)}
    return out


BANDAI_NAMES = named(
    "Hips Spine - Chest Neck Head",
    "UpperLeg_# LowerLeg_# Foot_# Toes_# Shoulder_# UpperArm_# LowerArm_# Hand_#",
    "L",
    "R",
)
BANDAI = Export(BANDAI_NAMES, ("spine2",), root="joint_Root", rest="x-", channels="position")
TRUNK = "Hips Spine Spine1 Spine2 Neck Head"
MIXAMO = "#UpLeg #Leg #Foot #ToeBase #Shoulder #Arm #ForeArm #Hand"
POSER = named("hip abdomen - chest neck head", "#Thigh #Shin #Foot #Toe #Collar #Shldr #ForeArm #Hand", "l", "r")
XSENS = "#Hip #Knee #Ankle #Toe #Collar #Shoulder #Elbow #Wrist"
SEGMENTS = "#UpperLeg #LowerLeg #Foot #Toe #Shoulder #UpperArm #Forearm #Hand"
MOTIVE = "#Thigh #Shin #Foot #Toe #Shoulder #UArm #FArm #Hand"
NEWTON = "#Thigh #Shin #Foot #Toe #Shoulder #Arm #ForeArm #Hand"
EXPORTS = {
    "Bandai-Namco": BANDAI,
    "Bandai-Namco, offsets all zero": dataclasses.replace(BANDAI, offsets=False),
    "LaFAN": Export(named(TRUNK, MIXAMO, "Left", "Right"), rest="x", order="ZYX"),
    "Rokoko": Export(named("Hips Spine1 Spine2 Spine4 Neck Head", NEWTON, "Left", "Right"), rest="x", order="YXZ"),
    "Mixamo": Export(named("m:Hips m:Spine m:Spine1 m:Spine2 m:Neck m:Head", MIXAMO, "m:Left", "m:Right")),
    "Mixamo by Blender": Export(
        named(TRUNK, MIXAMO, "Left", "Right"),
        unit=1.0, order="XYZ", channels="position", world=Z_UP,
    ),
    "Poser": Export(POSER, ("spine2", "left_foot", "right_foot"), unit=39.37, rest="A"),
    "Poser, from Second Life": Export(POSER, ("spine2", "left_foot", "right_foot"), unit=39.37, order="XZY"),
    "Motive": Export(named("S:Hip S:Ab - S:Chest S:Neck S:Head", MOTIVE, "S:L", "S:R"), ("spine2",), unit=1.0),
    "Motive, names of MotionBuilder": Export(
        named("Hips Spine - Spine1 Neck Head", MIXAMO, "Left", "Right"), ("spine2",), root="reference"
    ),
    "Vicon": Export(
        named("V:Hips V:Spine V:Spine1 V:Spine2 V:Neck V:Head", MIXAMO, "V:Left", "V:Right"),
        root="reference", hips="added", unit=1000.0, world=Z_UP,
    ),
    "Xsens": Export(named("Hips Chest Chest2 Chest4 Neck Head", XSENS, "Left", "Right"), order="YXZ"),
    "Xsens, segments": Export(
        named("Pelvis L5 T12 T8 Neck Head", SEGMENTS, "Left", "Right"), order="YXZ", world=Z_UP
    ),
    "Perception Neuron": Export(
        named(" ".join(f"Robot_{name}" for name in TRUNK.split()), MIXAMO, "Robot_Left", "Robot_Right"),
        order="YXZ", channels="position", rest="A",
    ),
    "Qualisys": Export(
        named("Q_Hips Q_Spine Q_Spine1 Q_Spine2 Q_Neck Q_Head", MIXAMO, "Q_Left", "Q_Right"), world=Z_UP
    ),
    "MakeHuman": Export(channels="added", unit=10.0, order="XYZ"),
    "no end sites": Export(named(TRUNK, MIXAMO, "Left", "Right"), ends=False),
}  # fmt: skip


def posed(motion: Motion, skeleton: Skeleton) -> np.ndarray:
    return np.array([skeleton.forward(r, t) for r, t in zip(motion.rotations, motion.trans, strict=True)])


def worst_angle(ours: np.ndarray, theirs: np.ndarray) -> float:
    """Degrees between the bones of limbs."""
    worst = 0.0
    for a, b in BONES:
        along = [at[:, AT[b], :3, 3] - at[:, AT[a], :3, 3] for at in (ours, theirs)]
        angle = np.arctan2(np.linalg.norm(np.cross(*along), axis=1), np.einsum("ti,ti->t", *along))
        worst = max(worst, float(np.degrees(angle).max()))
    return worst


@pytest.mark.parametrize("maker", EXPORTS)
def test_a_walk_as_exporters_write_it(tmp_path: Path, skeleton: Skeleton, walk: Motion, maker: str) -> None:
    export = EXPORTS[maker]
    path = tmp_path / "walk.bvh"
    path.write_text(export.text(walk, skeleton))
    read = load_motion(path, skeleton)
    assert read.note == ""
    ours, theirs = posed(read, skeleton), posed(walk, skeleton)
    assert worst_angle(ours, theirs) < 0.1
    # without a rest pose, trunk and hips turn as in the frame that stands in for it
    root = Rotation.from_matrix(ours[:, 0, :3, :3].swapaxes(1, 2) @ theirs[:, 0, :3, :3])
    assert np.degrees(root.magnitude()).max() < (5 if "x" in export.rest else 0.1)
    way = [at[-1, 0, :3, 3] - at[0, 0, :3, 3] for at in (ours, theirs)]
    assert way[0] == pytest.approx(way[1], abs=0.02)
    feet = [AT[f"{side}_foot"] for side in SIDES]
    low = (ours[:, feet, 1, 3] - skeleton.joints[feet, 1]).min(axis=1)
    assert abs(np.percentile(low, 20)) < 0.03


def test_legs_that_point_apart_are_no_rest_pose(tmp_path: Path, skeleton: Skeleton, walk: Motion) -> None:
    """Bandai-Namco's: what rounding leaves between both knees may point along the trunk, and nobody stands by that."""
    text = BANDAI.text(walk, skeleton)
    for more in ("0.001", "-0.001"):
        shin = text.index("OFFSET", text.index("JOINT LowerLeg_L"))
        x, rest = text[shin + 7 :].split(" ", 1)
        (tmp_path / "walk.bvh").write_text(f"{text[: shin + 7]}{float(x) + float(more)} {rest}")
        ours = posed(load_motion(tmp_path / "walk.bvh", skeleton), skeleton)
        assert worst_angle(ours, posed(walk, skeleton)) < 0.1


@pytest.mark.parametrize("offsets", [True, False])
def test_position_channels_move_bones(skeleton: Skeleton, walk: Motion, offsets: bool) -> None:
    """Channels that hold offsets: joints lie where they say, and a file without offsets has them as its rest pose."""
    export = dataclasses.replace(EXPORTS["Perception Neuron"], offsets=offsets, rest="T")
    clip = parse_bvh(export.text(walk, skeleton))
    where = [clip.names.index(export.names[name]) for name in JOINT_NAMES[:22]]
    assert clip.places[:, where] == pytest.approx(100 * posed(walk, skeleton)[:, :22, :3, 3], abs=0.01)
    rest = clip.rest[where] - clip.rest[where[0]]
    assert rest == pytest.approx(100 * (skeleton.joints[:22] - skeleton.joints[0]), abs=0.01)


def test_limbs_that_stretch_are_said(tmp_path: Path, skeleton: Skeleton, walk: Motion) -> None:
    text = EXPORTS["Perception Neuron"].text(walk, skeleton)
    head, rows = text.rsplit("\n", len(walk) + 1)[0], text.split("\n")[-len(walk) - 1 : -1]
    joint = [name for name, _ in _channels(head)].index("Robot_LeftLeg")
    column = 6 * joint  # all joints have six channels
    numbers = [row.split() for row in rows]
    numbers[5][column + 1] = str(1.5 * float(numbers[5][column + 1]))
    path = tmp_path / "walk.bvh"
    path.write_text(head + "\n" + "\n".join(map(" ".join, numbers)) + "\n")
    assert "length by 50 %" in load_motion(path, skeleton).note


def _channels(head: str) -> list[tuple[str, str]]:
    lines = head.split("\n")
    return [(line.split()[1], lines[k + 3]) for k, line in enumerate(lines) if line.startswith(("ROOT", "JOINT"))]


@pytest.mark.check
@pytest.mark.shared
@pytest.mark.parametrize("name", ["cmu_02_04.amc", "cmu_131_03.bvh"])
def test_soles_of_captured_people_are_flat(shared_data: Path, skeleton: Skeleton, name: str) -> None:
    """CMU's skeletons rest with legs and soles spread by 20 degrees, which they would keep."""
    motion = load_motion(shared_data / "mocap" / name, skeleton)
    ours = posed(motion, skeleton)
    for side in SIDES:
        foot = ours[:, AT[f"{side}_ankle"]]
        still = np.linalg.norm(np.diff(foot[:, :3, 3], axis=0), axis=1) * motion.fps < 0.2
        stands = still & (foot[1:, 1, 3] < np.percentile(foot[:, 1, 3], 5) + 0.05)
        tilt = np.degrees(np.arcsin(foot[1:][stands, 1, 0]))  # of the foot's own left
        assert stands.sum() >= 3 and abs(np.median(tilt)) < 6
