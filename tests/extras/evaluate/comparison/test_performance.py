"""What participants do, and how avatars are driven by it."""

from __future__ import annotations

import numpy as np
import pytest

from glsplat.errors import PoseError
from glsplat.extras.evaluate.comparison.participant import Participant
from glsplat.extras.evaluate.comparison.protocol import RATE, TASKS, perform, recorded, tracked, true_poses
from glsplat.rotations import rotation_matrices
from glsplat.skinning.skeleton import Skeleton


def test_soles_stand_on_the_floor_and_nobody_jumps(people: list[Participant]) -> None:
    mesh = people[2].mesh
    done = perform(mesh)
    assert done.names == tuple(TASKS) and len(done.moments) == 8
    used = np.unique(mesh.faces)
    for moment in range(8):
        vertices = mesh.posed(done.pose(moment))[used]
        assert vertices[:, 1].min() == pytest.approx(0, abs=1e-9)
    turned = rotation_matrices(done.rotations)
    steps = np.einsum("tjab,tjab->tj", turned[1:], turned[:-1])
    degrees = np.degrees(np.arccos(np.clip((steps - 1) / 2, -1, 1)))
    assert degrees.max() * RATE < 400  # degrees a second: people can do that
    for frame in done.moments:  # the pose is held when the picture is taken
        np.testing.assert_array_equal(done.rotations[frame], done.rotations[frame - 20])


@pytest.mark.check
def test_head_and_hands_are_followed_on_another_body(people: list[Participant]) -> None:
    performer, other = people[0].mesh, people[1].mesh
    done = perform(performer)
    samples = recorded(done, performer.skeleton)
    assert len(samples) == len(done.rotations)
    for skeleton, allowed in ((performer.skeleton, 0.01), (other.skeleton, 0.12)):
        poses = tracked(samples, done.moments, skeleton)
        assert len(poses) == 8
        wrist = skeleton.names.index("left_wrist")
        for moment, pose in enumerate(poses):
            there = skeleton.forward(pose.rotations, pose.trans)[wrist, :3, 3]
            seen = np.array(samples[done.moments[moment]].left[:3])
            assert np.linalg.norm(there - seen) < allowed, done.names[moment]


def test_the_true_pose_goes_by_names(people: list[Participant]) -> None:
    mesh = people[0].mesh
    done = perform(mesh, ("waving",))
    rig = Skeleton.from_joints(("foot", "right_shoulder", "pelvis"), [-1, 0, 0], np.zeros((3, 3)))
    (pose,) = true_poses(done, mesh.skeleton, rig)
    own = done.pose(0).rotations
    np.testing.assert_array_equal(pose.rotations[1], own[mesh.skeleton.names.index("right_shoulder")])
    assert not pose.rotations[0].any()
    stranger = Skeleton.from_joints(("Hips", "Spine"), [-1, 0], np.zeros((2, 3)))
    with pytest.raises(PoseError, match="no joint of the avatar"):
        true_poses(done, mesh.skeleton, stranger)
    with pytest.raises(PoseError, match="cannot drive this skeleton: no joint for head"):
        tracked(recorded(done, mesh.skeleton), done.moments, stranger)
