"""People of every family do what the reference body does: walk, wave, and follow a headset."""

from __future__ import annotations

import numpy as np
import pytest

from glsplat.data import default_avatar
from glsplat.extras.authoring.body.open_body import open_body
from glsplat.extras.rigs.meshes.reader import read_gltf_person
from glsplat.formats.motion_files import load_motion
from glsplat.meshes import RiggedMesh
from glsplat.motion.fitted import leg_length
from glsplat.skinning.pose import Pose
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES, PARENTS
from glsplat.tracking.calibration import calibrate
from glsplat.tracking.config import TrackerConfig
from glsplat.tracking.recording import embedded_recording
from glsplat.tracking.tracker import Tracker
from tests.extras.rigs.gltf.built import FAMILIES, build

SIDES = ("left", "right")
LIMBS = [
    (f"{side}_{a}", f"{side}_{b}")
    for side in SIDES
    for a, b in (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"))
    + (("index1", "index2"), ("middle2", "middle3"), ("thumb1", "thumb2"))
]


@pytest.fixture(scope="module", params=list(FAMILIES))
def person(request: pytest.FixtureRequest, tmp_path_factory) -> tuple[RiggedMesh, dict[str, np.ndarray]]:
    """A built person, and by SMPL-X joint the vertices of the cube around it."""
    built = build(FAMILIES[request.param])
    path = tmp_path_factory.mktemp("family") / "person.glb"
    path.write_bytes(built.data)
    mesh = read_gltf_person(path)
    return mesh, {joint: np.arange(16 * node, 16 * node + 8) for joint, node in built.joint_nodes.items()}


def test_the_map_is_the_one_that_the_family_means(person, request) -> None:
    mesh, _ = person
    family = FAMILIES[request.node.callspec.params["person"]]
    assert mesh.meta["rig"] == mesh.meta["rig"] | dict(family.names)
    assert len(mesh.meta["rig"]) - len(family.names) <= 2  # a toy's feet may be called anything
    assert mesh.skeleton.names == JOINT_NAMES


def test_limbs_point_where_those_of_the_body_point(person) -> None:
    """In world positions, by bone lengths: within a centimetre at every twentieth frame."""
    mesh, cubes = person
    body = Skeleton.from_joints(JOINT_NAMES, PARENTS, open_body().joints)
    theirs, ours = load_motion("walk", body), load_motion("walk", mesh.skeleton)
    pairs = [(a, b) for a, b in LIMBS if a in cubes and b in cubes]
    assert len(pairs) >= 4
    for frame in range(0, len(theirs), 20):
        vertices = mesh.posed(ours.pose(frame))
        where = body.forward(theirs.pose(frame).rotations, theirs.pose(frame).trans)[:, :3, 3]
        for a, b in pairs:
            bone = vertices[cubes[b]].mean(axis=0) - vertices[cubes[a]].mean(axis=0)
            wanted = where[JOINT_NAMES.index(b)] - where[JOINT_NAMES.index(a)]
            wanted = wanted / np.linalg.norm(wanted) * np.linalg.norm(bone)
            assert np.linalg.norm(bone - wanted) < 0.01, (a, b, frame)


def test_the_skin_is_blended_linearly(person) -> None:
    """glTF 2.0, 3.7.3.3: a joint's cube is rigid, one between two joints is moved half by each."""
    mesh, cubes = person
    rng, still = np.random.default_rng(1), mesh.posed(Pose.zero())
    pose = Pose(rng.normal(0, 0.4, (55, 3)), rng.normal(0, 1, 3))
    frames, vertices = mesh.skeleton.forward(pose.rotations, pose.trans), mesh.posed(pose)
    moves = frames @ np.linalg.inv(mesh.skeleton.forward(np.zeros((55, 3))))
    bones = pose.bones(mesh.skeleton)  # from where the skin was bound
    for joint, cube in cubes.items():
        index, parent = JOINT_NAMES.index(joint), int(PARENTS[JOINT_NAMES.index(joint)])
        # 1e-6 of a person's height: the file holds float32
        assert np.abs(vertices[cube].mean(axis=0) - frames[index, :3, 3]).max() < 1e-5
        parts = [(cube, still, moves[index])]
        if parent >= 0 and JOINT_NAMES[parent] in cubes:
            parts.append((cube + 8, mesh.vertices, (bones[index] + bones[parent]) / 2))
        for some, start, move in parts:
            assert np.abs(vertices[some] - start[some] @ move[:3, :3].T - move[:3, 3]).max() < 1e-5, joint


def test_they_stand_on_the_floor_and_face_forward(person) -> None:
    mesh, cubes = person
    vertices = mesh.posed(Pose.zero())
    assert vertices[:, 1].min() == pytest.approx(0, abs=1e-6)
    at = {joint: vertices[cube].mean(axis=0) for joint, cube in cubes.items()}
    assert at["left_shoulder"][0] > 0.1 and at["right_shoulder"][0] < -0.1
    assert at["left_elbow"][1] == pytest.approx(at["left_shoulder"][1], abs=0.03 * np.ptp(vertices[:, 1]))
    if "left_foot" in at and "left_ankle" in at:
        assert at["left_foot"][2] > at["left_ankle"][2] + 0.02
    assert np.abs(mesh.skeleton.joints[0, [0, 2]]).max() < 1e-6


def test_feet_stand_where_those_of_the_body_stand(person) -> None:
    """In leg lengths above where they rest: to a tenth of a millimetre."""
    mesh, _ = person
    first, feet = default_avatar().skeleton, [JOINT_NAMES.index(f"{s}_{p}") for s in SIDES for p in ("ankle", "foot")]
    theirs, ours = load_motion("walk", first), load_motion("walk", mesh.skeleton)
    scale = leg_length(mesh.skeleton.joints) / leg_length(first.joints)
    for frame in range(0, len(theirs), 7):
        heights = [
            float((skeleton.forward(pose.rotations, pose.trans)[feet, 1, 3] - skeleton.joints[feet, 1]).min())
            for skeleton, pose in ((first, theirs.pose(frame)), (mesh.skeleton, ours.pose(frame)))
        ]
        assert heights[1] == pytest.approx(scale * heights[0], abs=1e-4)


@pytest.mark.check
def test_a_headset_moves_the_hands_to_where_they_are(person) -> None:
    """The wrists of what is drawn, at every fourth moment of the recording: within 2 cm, however long the arms are."""
    mesh, cubes = person
    if "left_wrist" not in cubes:
        pytest.skip("has no hands")
    samples = embedded_recording()
    tracker = Tracker(mesh.skeleton, calibrate(samples[:100], mesh.skeleton), TrackerConfig.raw())
    off: list[float] = []
    for sample in samples[::4]:
        vertices = mesh.posed(tracker.update(sample))
        for side, hand in (("left", sample.left), ("right", sample.right)):
            if hand is not None:
                target = (np.array(hand[:3]) - (0, tracker.calibration.floor, 0)) / tracker.calibration.scale
                off.append(float(np.linalg.norm(vertices[cubes[f"{side}_wrist"]].mean(axis=0) - target)))
    assert len(off) > 200 and max(off) < 0.02
