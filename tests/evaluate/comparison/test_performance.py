"""What participants do, and how avatars are driven by it."""

from __future__ import annotations

import numpy as np
import pytest

from glsplat.errors import PoseError
from glsplat.evaluate.comparison.control import recorded, tracked, true_poses
from glsplat.evaluate.comparison.participant import Participant
from glsplat.evaluate.comparison.performance import RATE, TASKS, perform, perform_motion
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


def test_poses_are_what_they_say(people: list[Participant]) -> None:
    mesh = people[1].mesh
    done = perform(mesh)
    joints = {name: mesh.skeleton.forward(done.pose(i).rotations)[:, :3, 3] for i, name in enumerate(done.names)}
    index = {name: i for i, name in enumerate(mesh.skeleton.names)}
    left, right, head, pelvis = (index[name] for name in ("left_wrist", "right_wrist", "head", "pelvis"))
    assert joints["arms overhead"][[left, right], 1].min() > joints["arms overhead"][head, 1]
    assert joints["waving"][right, 1] > joints["waving"][head, 1] > joints["waving"][left, 1]
    assert joints["reaching forward"][[left, right], 2].min() > joints["reaching forward"][head, 2] + 0.3
    hands, hips = joints["hands on hips"][[left, right]], joints["hands on hips"][pelvis]
    assert np.abs(hands[:, 1] - hips[1]).max() < 0.2 and np.abs(hands[:, 0] - hips[0]).max() < 0.35
    assert joints["standing"][[left, right], 1].max() < joints["standing"][head, 1] - 0.5


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


def test_a_motion_in_place_of_the_tasks(people: list[Participant]) -> None:
    done = perform_motion("walk", people[0].mesh.skeleton, 5)
    assert len(done.moments) == len(set(done.moments)) == 5
    assert 0 <= min(done.moments) <= max(done.moments) < len(done.rotations)
    assert done.names[0].endswith(" s")
