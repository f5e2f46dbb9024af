"""Control: the poses of an avatar at the moments of a performance, by the true pose or by head and hands alone."""

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
"""By head and hands through the solver, as users do; by the true pose, which no headset knows."""


def recorded(performance: Performance, skeleton: Skeleton) -> list[Sample]:
    """What an ideal headset sees of the performer, whose ``skeleton`` it is, at RATE. PoseError for another rig."""
    ground = np.array([0.0, Body.of(skeleton).ground, 0.0])
    truth = truth_from_motion(skeleton, performance.rotations, performance.trans + ground, RATE, RATE)
    return derive(skeleton, truth)


def tracked(samples: list[Sample], moments: tuple[int, ...], skeleton: Skeleton) -> list[Pose]:
    """The poses of an avatar's ``skeleton`` at those samples, driven through all of them by the product's tracker."""
    tracker = Tracker(skeleton, config=TrackerConfig(arm_scaling=0))  # an avatar is compared with the limbs it has
    poses = []
    for index, sample in enumerate(samples[: max(moments) + 1]):
        pose = tracker.update(sample)
        if index in moments:
            poses.append(pose)
    return poses


def true_poses(performance: Performance, performer: Skeleton, skeleton: Skeleton) -> list[Pose]:
    """The performer's own rotations at the moments, joint by name, and their translation. PoseError: none in common."""
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
