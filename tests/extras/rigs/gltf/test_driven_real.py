"""Real models of other makers, driven by motions and by a headset."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from glsplat.extras.authoring.body.open_body import open_body
from glsplat.extras.rigs.meshes.reader import read_gltf_person
from glsplat.formats.motion_files import load_motion
from glsplat.meshes import RiggedMesh
from glsplat.skinning.pose import Pose
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES, PARENTS

pytestmark = [pytest.mark.check, pytest.mark.shared]

PEOPLE = {  # the joints that have to be found
    "babylon_25skins.glb": 52,
    "cesium_man.glb": 19,
    "cool_loops.vrm": 52,
    "godette.vrm": 45,
    "godot_platformer_player.glb": 15,
    "kaykit_mage.glb": 18,
    "lumberjack_rigify.glb": 20,
    "mannequiny_gdquest.glb": 45,
    "quaternius_cyberpunk_character.glb": 20,
    "quaternius_knight.glb": 23,
    "robot_expressive.glb": 35,
    "rpm_template_xr.glb": 54,
    "vrm0_armature_transform.vrm": 17,
}
LIMBS = [
    [f"{side}_{part}" for part in parts]
    for side in ("left", "right")
    for parts in (
        ("hip", "knee", "ankle"),
        ("shoulder", "elbow", "wrist"),
        *((f"{finger}1", f"{finger}2", f"{finger}3") for finger in ("thumb", "index", "middle", "ring", "pinky")),
    )
]
FEET = [JOINT_NAMES.index(f"{side}_{part}") for side in ("left", "right") for part in ("ankle", "foot")]
STATURE = 1.7


@pytest.fixture(scope="module", params=list(PEOPLE))
def person(request: pytest.FixtureRequest, shared_data: Path) -> tuple[str, RiggedMesh]:
    path = shared_data / "real" / "models" / request.param
    mesh = read_gltf_person(path)
    height = float(np.ptp(mesh.posed(Pose.zero())[:, 1]))
    return request.param, mesh if 0.5 < height < 3 else read_gltf_person(path, scale=STATURE / height)


def test_every_joint_that_it_has_is_found(person) -> None:
    name, mesh = person
    assert mesh.skeleton.names == JOINT_NAMES and len(mesh.meta["rig"]) == PEOPLE[name]


def test_left_is_where_the_feet_say(person) -> None:
    """People face +z in the zero pose: their toes are before the ankles, the left hand on +x."""
    _, mesh = person
    at = dict(zip(JOINT_NAMES, mesh.skeleton.joints, strict=True))
    assert at["left_wrist"][0] > at["left_shoulder"][0] > at["right_shoulder"][0] > at["right_wrist"][0]
    assert all(at[f"{side}_foot"][2] > at[f"{side}_ankle"][2] + 0.01 for side in ("left", "right"))


def test_limbs_are_where_those_of_the_body_are(person) -> None:
    """Joint after joint from hip, shoulder and knuckle on, by bone lengths: within a centimetre."""
    _, mesh = person
    body = Skeleton.from_joints(JOINT_NAMES, PARENTS, open_body().joints)
    theirs, ours = load_motion("wave-and-turn", body), load_motion("wave-and-turn", mesh.skeleton)
    for frame in range(0, len(theirs), 20):
        where, mine = (
            dict(zip(JOINT_NAMES, skeleton.forward(pose.rotations, pose.trans)[:, :3, 3], strict=True))
            for skeleton, pose in ((body, theirs.pose(frame)), (mesh.skeleton, ours.pose(frame)))
        )
        for chain in LIMBS:
            at = mine[chain[0]]
            for a, b in pairwise(chain):
                if a not in mesh.meta["rig"] or b not in mesh.meta["rig"]:
                    break
                bone = where[b] - where[a]
                at = at + bone / np.linalg.norm(bone) * np.linalg.norm(mine[b] - mine[a])
                assert np.linalg.norm(at - mine[b]) < 0.01, (a, b, frame)


def test_it_stands_on_the_floor(person) -> None:
    """While it waves: the lowest point of the feet within 7 mm of the floor."""
    _, mesh = person
    feet = (np.isin(mesh.joints, FEET) & (mesh.weights > 0.3)).any(axis=1)
    feet = feet if feet.any() else np.full(len(feet), True)  # stiff legs
    motion = load_motion("wave-and-turn", mesh.skeleton)
    lowest = [mesh.posed(motion.pose(frame))[feet, 1].min() for frame in range(0, len(motion), 40)]
    assert min(lowest) > -0.007 and max(lowest) < 0.007
