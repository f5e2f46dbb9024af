from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from glsplat.camera import head_matrix
from glsplat.errors import PoseError
from glsplat.extras.evaluate.tracking_score import baseline, mean_score, score
from glsplat.extras.motions.derive import Disturbance, TrueMotion, derive, disturb, truth_from_motion
from glsplat.formats.motion_files import load_motion
from glsplat.skinning.skeleton import Skeleton
from glsplat.tracking.solve.body import Body


@pytest.fixture(scope="module")
def truth(skeleton: Skeleton) -> TrueMotion:
    motion = load_motion("wave-and-turn", skeleton)
    return truth_from_motion(skeleton, motion.rotations, motion.trans, motion.fps, 30.0)


def test_a_t_pose_gives_the_frames_of_openxr(skeleton: Skeleton, body: Body) -> None:
    zero = truth_from_motion(skeleton, np.zeros((2, 55, 3)), np.zeros((2, 3)), 30.0, 30.0)
    sample = derive(skeleton, zero)[0]
    assert sample.head is not None and sample.left is not None and sample.right is not None
    head, left, right = (head_matrix(p[:3], p[3:]) for p in (sample.head, sample.left, sample.right))
    np.testing.assert_allclose(head[:3, :3], np.diag([-1.0, 1.0, -1.0]), atol=1e-9)  # looks along +z
    np.testing.assert_allclose(head[:3, 3], zero.positions[0, 23:25].mean(0), atol=1e-9)
    np.testing.assert_allclose(-left[:3, 2], (1, 0, 0), atol=1e-9)  # along the left fingers
    np.testing.assert_allclose(-right[:3, 2], (-1, 0, 0), atol=1e-9)
    np.testing.assert_allclose(left[:3, 1], (0, 1, 0), atol=1e-9)  # out of the back of the hand
    assert left[:3, 0] @ (0, 0, 1) > 0.99 and right[:3, 0] @ (0, 0, 1) < -0.99  # the thumbs point forward
    assert sample.left_joints is not None and len(sample.left_joints) == 25
    np.testing.assert_allclose(sample.left_joints[6], zero.positions[0, 25], atol=1e-9)  # index knuckle
    assert sample.left_joints[4][2] > sample.left_joints[0][2]  # the thumb's tip is in front
    assert zero.positions[0, 10, 1] == pytest.approx(body.sole)  # stands on y = 0


def test_disturbances_do_what_they_say(skeleton: Skeleton, truth: TrueMotion) -> None:
    clean = derive(skeleton, truth)
    how = Disturbance(noise_mm=2.0, noise_deg=0.5, dropout=0.3, latency_s=0.1, seed=3)
    noisy = disturb(clean, how)
    assert disturb(clean, how) == noisy and disturb(clean, Disturbance(seed=1)) == clean
    assert [s.t for s in noisy] == [s.t for s in clean]
    lost = np.mean([s.left is None for s in noisy])
    assert 0.1 < lost < 0.6 and all(s.left_joints is None for s in noisy if s.left is None)
    late = np.array([s.head[:3] for s in noisy[10:]]) - np.array([s.head[:3] for s in clean[7:-3]])
    assert late.std() == pytest.approx(0.002, rel=0.3)  # 3 samples later, plus the noise


def test_scores_of_known_errors(truth: TrueMotion, body: Body) -> None:
    perfect = score(truth.positions, truth.positions, 30.0, body.sole, truth.rotations, truth.rotations)
    assert perfect.mpjpe == perfect.mpjve == perfect.hands == 0 and perfect.mpjre < 1e-4
    assert perfect.jitter == perfect.jitter_truth > 0
    shifted = truth.positions + (0.03, 0.0, 0.04)
    moved = score(shifted, truth.positions, 30.0, body.sole)
    assert moved.mpjpe == pytest.approx(5) and moved.upper == pytest.approx(5) and moved.mpjve < 1e-9
    assert np.isnan(moved.mpjre) and moved.to_json()["mpjre"] is None
    turned = truth.rotations.copy()
    turned[:, 0] = 0
    turned[:, 0, 1] = np.radians(22)
    reference = turned.copy()
    reference[:, 0] = 0
    assert score(shifted, truth.positions, 30.0, body.sole, turned, reference).mpjre == pytest.approx(1)  # one of 22
    sliding = np.tile(truth.positions[:1], (30, 1, 1))
    sliding[:, :, 0] += 0.01 * np.arange(30)[:, None]
    assert score(sliding, sliding, 30.0, body.sole).skate == pytest.approx(30)
    sunk = truth.positions - (0, 0.05, 0)
    assert score(sunk, truth.positions, 30.0, body.sole).penetration > 4
    both = mean_score([perfect, moved])
    assert both.mpjpe == pytest.approx(2.5) and both.frames == 2 * perfect.frames


def test_a_baseline_that_is_not_shown_the_first_frame_begins_at_rest(truth: TrueMotion, body: Body) -> None:
    """Its feet are where those of the rest pose are, under the true head; nothing but head and hands is copied."""
    estimate = baseline(truth, "naive", body)
    assert estimate.shape == truth.positions.shape and np.isfinite(estimate).all()
    known = [15, 20, 21]
    np.testing.assert_allclose(estimate[:, known], truth.positions[:, known])
    told = baseline(truth, "naive")
    off = [float(np.linalg.norm(shown[0] - truth.positions[0], axis=-1).mean()) for shown in (estimate, told)]
    assert off[1] < 0.005 < off[0]
    moved = truth.positions.copy()
    moved[:, [joint for joint in range(22) if joint not in known]] += 0.5  # of the rest of the body it hears nothing
    np.testing.assert_array_equal(baseline(replace(truth, positions=moved), "naive", body), estimate)
    feet = estimate[0, [7, 8], 1]
    np.testing.assert_allclose(feet, body.rest[[7, 8], 1] - body.ground, atol=1e-9)


def test_rates_are_checked(skeleton: Skeleton) -> None:
    with pytest.raises(PoseError, match="1 to 1000"):
        truth_from_motion(skeleton, np.zeros((3, 55, 3)), np.zeros((3, 3)), 30.0, 0.0)
    with pytest.raises(PoseError, match="two frames"):
        truth_from_motion(skeleton, np.zeros((1, 55, 3)), np.zeros((1, 3)), 30.0, 72.0)


def test_scores_refuse_what_does_not_match(truth: TrueMotion, body: Body) -> None:
    with pytest.raises(PoseError, match="one shape"):
        score(truth.positions[1:], truth.positions, 30.0, body.sole)
    with pytest.raises(PoseError, match="at least 4"):
        score(truth.positions[:3], truth.positions[:3], 30.0, body.sole)


def test_baselines_know_head_and_hands(truth: TrueMotion, body: Body) -> None:
    for kind in ("glued", "naive"):
        estimate = baseline(truth, kind)
        assert estimate.shape == truth.positions.shape and np.isfinite(estimate).all()
        np.testing.assert_allclose(estimate[:, 20:22], truth.positions[:, 20:22])
        np.testing.assert_allclose(estimate[:, 15], truth.positions[:, 15])
        np.testing.assert_allclose(estimate[0], truth.positions[0], atol=0.06)  # it was shown the first frame
