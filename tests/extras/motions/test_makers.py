"""Motions of many makers: limbs point where a second reader says that the file has them; soles on the floor; ahead."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from glsplat.formats.motion_files import load_motion
from glsplat.motion.motion import Motion
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES
from tests.extras.motions.independent import accessor, acclaim_positions, bvh_positions, gltf_positions
from tests.formats.scenes import glb_parts

AT = {name: i for i, name in enumerate(JOINT_NAMES)}
PARTS = ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")
BONES = [
    (f"{side}_{a}", f"{side}_{b}")
    for side in ("left", "right")
    for a, b in (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"))
]
MOST = 0.5  # degrees; measured: 0.01 at most in all files
HEADINGS = [np.eye(3), np.diag([-1.0, 1, -1])]
HEADINGS += [np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]), np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]])]
Z_UP = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])

MIXAMO = "#UpLeg #Leg #Foot #Arm #ForeArm #Hand"
CMU = "#Hip #Knee #Ankle #Shoulder #Elbow #Wrist"
ACCLAIM = "#femur #tibia #foot #humerus #radius #wrist"
MAKEHUMAN = "upperleg01.# lowerleg01.# foot.# upperarm01.# lowerarm01.# wrist.#"

# names of hip, knee, ankle, shoulder, elbow and wrist with # for the side; marks of the sides; what is up as they move
FILES = {
    "real/motions/cmu_131_01.bvh": (CMU, "Left Right", "y"),
    "real/motions/makehuman_fight01.bvh": (MAKEHUMAN, "L R", "z"),
    "real/motions/mixamo_freebvh.bvh": (MIXAMO.replace("#", "mixamorig:#"), "Left Right", "y"),
    "real/motions/pybvh_test3.bvh": (MIXAMO, "Left Right", "z"),  # rests with y up
    "real/motions/rokoko_jesse_dance.bvh": (MIXAMO, "Left Right", "y"),  # rests with all bones along x
    "real/motions/viverse_sample.bvh": (MIXAMO, "Left Right", "y"),
    **{f"mocap/cmu_131_0{n}.bvh": (CMU, "Left Right", "y") for n in (1, 2, 3)},
    **{f"mocap/cmu_02_0{n}.amc": (ACCLAIM, "l r", "y") for n in (1, 3, 4, 5)},
}
KAYKIT = "upperleg.# lowerleg.# foot.# upperarm.# lowerarm.# wrist.#"
QUATERNIUS = "UpperLeg.# LowerLeg.# Foot.# UpperArm.# LowerArm.# #"
ANIMATED = {
    ("real/motions/three_vrm_test.vrma", 0): ("#UpperLeg #LowerLeg #Foot #UpperArm #LowerArm #Hand", "left right"),
    ("real/models/mannequiny_gdquest.glb", 9): ("thigh.# calf.# foot.# upperarm.# lowerarm.# hand.#", "l r"),
    ("real/models/kaykit_mage.glb", 20): (KAYKIT, "l r"),
    ("real/models/kaykit_mage.glb", 24): (KAYKIT, "l r"),  # lies on the floor, feet above the origin
    ("real/models/robot_expressive.glb", 10): (QUATERNIUS, "L R"),
    ("real/models/quaternius_knight.glb", 8): (QUATERNIUS, "L R"),
    ("real/models/quaternius_cyberpunk_character.glb", 17): (QUATERNIUS, "L R"),
}


def named(names: str, marks: str) -> dict[str, str]:
    """Our joint -> the file's."""
    sides = zip(("left", "right"), marks.split(), strict=True)
    return {
        f"{side}_{part}": name.replace("#", mark)
        for side, mark in sides
        for part, name in zip(PARTS, names.split(), strict=True)
    }


def posed(motion: Motion, skeleton: Skeleton, frames: np.ndarray) -> np.ndarray:
    """[T, 55, 4, 4]"""
    return np.array([skeleton.forward(motion.rotations[i], motion.trans[i]) for i in frames])


def worst_angle(theirs: dict[str, np.ndarray], ours: np.ndarray) -> float:
    """Degrees between bones, over all frames; of the four headings by right angles the one that fits best."""
    worst = []
    for heading in HEADINGS:
        angles = []
        for a, b in BONES:
            if a in theirs and b in theirs:
                u, v = (theirs[b] - theirs[a]) @ heading.T, ours[:, AT[b], :3, 3] - ours[:, AT[a], :3, 3]
                sin, cos = np.linalg.norm(np.cross(u, v), axis=1), np.einsum("ti,ti->t", u, v)
                angles.append(np.degrees(np.arctan2(sin, cos)).max())
        worst.append(max(angles))
    return min(worst)


@pytest.mark.check
@pytest.mark.shared
@pytest.mark.parametrize("name", FILES)
def test_captured_motions(shared_data: Path, skeleton: Skeleton, name: str) -> None:
    path, (names, marks, up) = shared_data / name, FILES[name]
    motion = load_motion(path, skeleton)
    every = max(1, len(motion) // 40)
    if path.suffix == ".amc":
        at = acclaim_positions(path.with_name("cmu_02.asf"), path, every)
    else:
        at, step = bvh_positions(path, every, added="makehuman" in name)
        assert motion.fps == pytest.approx(1 / step)
    theirs = {ours: at[other] @ (Z_UP.T if up == "z" else np.eye(3)) for ours, other in named(names, marks).items()}
    ours = posed(motion, skeleton, np.arange(0, len(motion), every))
    assert worst_angle(theirs, ours) < MOST

    # upright, and the lower sole where it is in the zero pose, most of the time that it stands
    trunk = ours[:, AT["neck"], 1, 3] - ours[:, AT["pelvis"], 1, 3]
    assert np.median(trunk) > 0.3
    feet = [AT[f"{side}_{part}"] for side in ("left", "right") for part in ("ankle", "foot")]
    low = (ours[:, feet, 1, 3] - skeleton.joints[feet, 1]).min(axis=1)
    assert abs(np.percentile(low, 20)) < 0.03
    ahead = load_motion(path, skeleton, forward=True)
    first = posed(ahead, skeleton, np.array([0]))[0]
    assert first[0, 2, 2] > 0.3 and abs(first[0, 0, 2]) < 1e-6
    across = first[AT["left_hip"], :3, 3] - first[AT["right_hip"], :3, 3]
    assert across[0] > 0.5 * np.linalg.norm(across)


@pytest.mark.check
@pytest.mark.shared
@pytest.mark.parametrize(("name", "number"), ANIMATED)
def test_animations(shared_data: Path, skeleton: Skeleton, name: str, number: int) -> None:
    path, (names, marks) = shared_data / name, ANIMATED[name, number]
    motion = load_motion(path, skeleton, animation=str(number))
    tree, blob = glb_parts(path.read_bytes())
    start = min(accessor(tree, blob, sampler["input"])[0, 0] for sampler in tree["animations"][number]["samplers"])
    frames = np.arange(0, len(motion), max(1, len(motion) // 20))
    at = gltf_positions(path, start + frames / motion.fps, number)
    called = [node.get("name", "") for node in tree["nodes"]]
    theirs = {ours: at[called.index(other)] for ours, other in named(names, marks).items() if other in called}
    assert len(theirs) >= 10
    assert worst_angle(theirs, posed(motion, skeleton, frames)) < MOST
