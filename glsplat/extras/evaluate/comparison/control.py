"""Controls: an avatar's poses at the moments of a performance, from the true pose or from head and hands alone."""

from __future__ import annotations

import numpy as np

from glsplat.errors import PoseError
from glsplat.extras.evaluate.comparison.performance import RATE, Performance
from glsplat.extras.motions.derive import derive, truth_from_motion
from glsplat.skinning.pose import Pose
from glsplat.skinning.skeleton import Skeleton
from glsplat.tracking.config import TrackerConfig
from glsplat.tracking.sample import Sample
from glsplat.tracking.solve.body import Body
from glsplat.tracking.tracker import Tracker

CONTROLS = ("tracking", "pose")
"""From head and hands through the solver, as for users; from the true pose, which no headset knows."""


def recorded(performance: Performance, skeleton: Skeleton) -> list[Sample]:
    """Return an ideal headset's samples of the performer at RATE. Raises PoseError unless the rig is SMPL-X's."""
    ground = np.array([0.0, Body.of(skeleton).ground, 0.0])
    truth = truth_from_motion(skeleton, performance.rotations, performance.trans + ground, RATE, RATE)
    return derive(skeleton, truth)


def tracked(samples: list[Sample], moments: tuple[int, ...], skeleton: Skeleton) -> list[Pose]:
    """Return poses of an avatar's ``skeleton`` at ``moments`` (indices), tracked through all samples before them."""
    tracker = Tracker(skeleton, config=TrackerConfig(arm_scaling=0))  # compare avatars with their own limbs
    poses = []
    for index, sample in enumerate(samples[: max(moments) + 1]):
        pose = tracker.update(sample)
        if index in moments:
            poses.append(pose)
    return poses


def true_poses(performance: Performance, performer: Skeleton, skeleton: Skeleton) -> list[Pose]:
    """Return the performer's rotations, by joint name, and translations. Raises PoseError without a common joint."""
    index = {name: i for i, name in enumerate(performer.names)}
    known = [(i, index[name]) for i, name in enumerate(skeleton.names) if name in index]
    if not known:
        raise PoseError(
            f"no joint of the avatar ({', '.join(skeleton.names[:4])}, ...) has a name of the participant's"
        )
    own, theirs = np.array(known).T
    poses = []
    for moment in range(len(performance.moments)):
        pose = performance.pose(moment)
        rotations = np.zeros((len(skeleton), 3))
        rotations[own] = pose.rotations[theirs]
        poses.append(Pose(rotations, pose.trans))
    return poses
