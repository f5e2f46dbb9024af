from __future__ import annotations

import numpy as np
import pytest

from glsplat.extras.motions.derive import TrueMotion, derive, forward_all
from glsplat.rotations import rotation_matrices
from glsplat.skinning.skeleton import Skeleton
from glsplat.tracking import Tracker, TrackerConfig
from glsplat.tracking.solve.body import Body
from tests.tracking.moves import Stage

HANDS = {"left": slice(25, 40), "right": slice(40, 55)}


def posed(skeleton: Skeleton, rng: np.random.Generator, size: float = 1.0) -> tuple[TrueMotion, np.ndarray]:
    """A standing body with bent fingers: flexion, a little spreading of the knuckles."""
    rotations = np.zeros((1, 55, 3))
    rotations[:, 16:18, 2] = (-1.2, 1.2)
    rotations[:, 20:22] = (0.3, 0.4, 0.2)
    rest = skeleton.joints
    for joints in HANDS.values():
        knuckles = rest[joints].reshape(5, 3, 3)
        bones = np.stack([knuckles[:, 1] - knuckles[:, 0], *[knuckles[:, 2] - knuckles[:, 1]] * 2], 1)
        axes = np.cross(bones, (0.0, -1.0, 0.0))  # across each bone, towards the palm
        axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
        bend = rng.uniform(0.0, 1.2, (5, 3))
        bend[4] *= 0.4  # thumb
        fingers = axes * bend[..., None]
        fingers[:, 0, 1] += rng.uniform(-0.1, 0.1, 5)  # spread
        rotations[0, joints] = fingers.reshape(15, 3)
    positions, frames = forward_all(skeleton, rotations, np.zeros((1, 3)))
    wrist = {"left": 20, "right": 21}
    for side, joints in HANDS.items():  # a larger hand with the same pose
        palm = positions[:, wrist[side], None]
        positions[:, joints] = palm + size * (positions[:, joints] - palm)
    return TrueMotion(np.zeros(1), rotations, np.zeros((1, 3)), positions, frames), rotations[0]


@pytest.mark.parametrize("size", [1.0, 1.25])
def test_tracked_joints_give_the_pose_back(skeleton: Skeleton, rng: np.random.Generator, size: float) -> None:
    truth, rotations = posed(skeleton, rng, size)
    tracker = Tracker(skeleton, config=TrackerConfig.raw())
    pose = tracker.update(derive(skeleton, truth)[0])
    for joints in HANDS.values():
        ours, theirs = rotation_matrices(pose.rotations[joints]), rotation_matrices(rotations[joints])
        angle = np.degrees(np.arccos(np.clip((np.einsum("jab,jab->j", ours, theirs) - 1) / 2, -1, 1)))
        # a bone's direction does not tell its twist: spread knuckles leave some degrees
        assert angle.max() < 8 and angle.mean() < 2


def test_curl_closes_both_hands_alike(skeleton: Skeleton, stage: Stage) -> None:
    def fingers(curl: float | None) -> np.ndarray:
        tracker = Tracker(skeleton, config=TrackerConfig.raw())
        return tracker.update(stage.sample(0.0, left_curl=curl, right_curl=curl)).rotations

    open_hand, fist, relaxed = fingers(0.0), fingers(1.0), fingers(None)
    assert np.abs(open_hand[25:]).max() == 0
    assert fist[25 + 1, 2] < -1.4  # the left index's middle joint bends about -z
    assert 0 > relaxed[26, 2] > fist[26, 2]
    np.testing.assert_allclose(fist[40:], fist[25:40] * (1, -1, -1), atol=1e-12)


@pytest.mark.parametrize("bad", [(0.0, 0.0, 0.0), (float("nan"),) * 3, (1e9, 0.0, 0.0)])
def test_impossible_joints_count_as_unknown(skeleton: Skeleton, stage: Stage, bad: tuple[float, ...]) -> None:
    joints = tuple([bad] * 25)
    plain = Tracker(skeleton).update(stage.sample(0.0)).rotations
    np.testing.assert_array_equal(Tracker(skeleton).update(stage.sample(0.0, left_joints=joints)).rotations, plain)


def test_fingers_are_limited_and_smooth(skeleton: Skeleton, body: Body, stage: Stage, rng: np.random.Generator) -> None:
    tracker = Tracker(skeleton)
    last = None
    for i in range(60):
        joints = tuple([tuple(v) for v in rng.normal(0, 0.1, (25, 3))])
        value = tracker.update(stage.sample(i / 72, left_joints=joints)).rotations[25:40]
        assert np.isfinite(value).all() and np.abs(value).max() < 2.0
        if last is not None:
            assert np.abs(value - last).max() <= 40 / 72 + 1e-9
        last = value
