"""The learned solver's promises whatever its network says: exact head and hands, feet that stand, bounded motion."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from glsplat.errors import FormatError, PoseError
from glsplat.extras.evaluate.tracking_score import TrackingScore, mean_score, score
from glsplat.extras.learned import network as module
from glsplat.extras.learned.network import PoseNetwork, embedded_network
from glsplat.extras.learned.solver import LearnedSolver
from glsplat.extras.motions.derive import Disturbance, derive, disturb, forward_all, truth_from_motion
from glsplat.formats.motion_files import load_motion
from glsplat.skinning.skeleton import Skeleton
from glsplat.tracking import Tracker
from glsplat.tracking.solve.body import FEET, HEAD, PELVIS, WRISTS, Body
from glsplat.tracking.solvers import solver_of
from tests.tracking.moves import DT, Stage, Track, hand_turn, head_turn, seconds


def measured(skeleton: Skeleton, name: str, rate: float, solver: str, how: Disturbance | None = None) -> TrackingScore:
    motion = load_motion(name, skeleton)
    count = min(len(motion), round(8 * motion.fps))
    truth = truth_from_motion(skeleton, motion.rotations[:count], motion.trans[:count], motion.fps, rate)
    samples = derive(skeleton, truth)
    tracker = Tracker(skeleton, solver=solver)  # type: ignore[arg-type]
    poses = [tracker.update(sample) for sample in (samples if how is None else disturb(samples, how))]
    rotations, trans = np.array([p.rotations for p in poses]), np.array([p.trans for p in poses])
    positions, _ = forward_all(skeleton, rotations, trans)
    return score(positions, truth.positions, rate, Body.of(skeleton).sole, rotations, truth.rotations)


@pytest.mark.parametrize("solver", ["learned", "analytic"])
def test_head_and_reachable_hands_are_exact(stage: Stage, track: Track, solver: str) -> None:
    forward = {"left_turn": hand_turn("left", (0, -1.4, 0)), "right_turn": hand_turn("right", (0, 1.4, 0))}
    hands = {"left": (0.2, 0.72 * stage.body.eye_height, 0.4), "right": (-0.3, 0.9 * stage.body.eye_height, 0.3)}
    samples = [stage.sample(t, turn=head_turn(0.2, 0.2), **hands, **forward) for t in seconds(1.0)]
    result = track(samples, solver=solver)
    assert max(result.reach[-1]) < 2e-3
    np.testing.assert_allclose(result.joints[-1, WRISTS[0]], hands["left"], atol=2e-3)
    np.testing.assert_allclose(result.joints[-1, WRISTS[1]], hands["right"], atol=2e-3)
    eyes = result.joints[-1, 23:25].mean(0)
    np.testing.assert_allclose(eyes, stage.eye, atol=1e-6 if solver == "learned" else 2e-3)


@pytest.mark.parametrize("name", ["walk", "wave-and-turn", "idle"])
def test_feet_stand_and_motion_is_no_rougher_than_it_should_be(skeleton: Skeleton, name: str) -> None:
    result = measured(skeleton, name, 72.0, "learned")
    assert result.skate < 1 and result.penetration < 0.1 and result.hands < 0.5 and result.fingers < 1
    assert name == "walk" or (result.mpjpe < 4.5 and result.upper < 2)
    assert result.jitter < max(2 * result.jitter_truth, 1.5)


def test_noise_at_rest_does_not_shake_the_body(skeleton: Skeleton) -> None:
    """Half a millimetre and a tenth of a degree, on somebody who stands."""
    clean = measured(skeleton, "idle", 72.0, "learned")
    noisy = measured(skeleton, "idle", 72.0, "learned", Disturbance(noise_mm=0.5, noise_deg=0.1, seed=1))
    assert noisy.jitter < 2 * max(clean.jitter_truth, 1.0)


@pytest.mark.parametrize("turn", [0.7, np.pi / 2, np.pi])
def test_who_turned_on_the_spot_stands_as_before(stage: Stage, track: Track, turn: float) -> None:
    """Head and hands turn about the eyes within 0.4 s, as those of an emulated headset do, and rest."""
    samples = []
    for i in range(720):
        t = i * DT
        yaw = turn * float(np.clip((t - 3) / 0.4, 0, 1))
        s, c = np.sin(yaw), np.cos(yaw)
        about = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
        off = {side: np.subtract(stage.hand(side, 0.22, 0.53, 0.05), stage.eye) for side in ("left", "right")}
        hands = {side: tuple(np.add(stage.eye, about @ place)) for side, place in off.items()}
        samples.append(stage.sample(t, turn=head_turn(yaw), **hands))
    joints = track(samples, solver="learned").joints
    before, after = (joints[row][list(FEET)] - joints[row][PELVIS] for row in (200, -1))
    assert np.linalg.norm((after @ about - before)[:, [0, 2]], axis=1).max() < 0.09


def test_hands_lost_and_found_head_only_and_teleports(stage: Stage, track: Track) -> None:
    samples = []
    for i, t in enumerate(seconds(6.0)):
        gone = 1.0 < t < 3.0
        far = 3.0 if t > 4.0 else 0.0
        head = (far + 0.05 * np.sin(t), stage.eye[1] - 0.1 * max(0.0, np.sin(t)), 0.13)
        left, right = None if gone or far else "rest", None if gone else "rest"
        samples.append(stage.sample(i * DT, head=head, left=left, right=right))
    result = track(samples, solver="learned")
    assert any("teleport" in flags for flags in result.flags)


def test_any_network_at_all_is_kept_in_bounds(skeleton: Skeleton, stage: Stage, track: Track) -> None:
    """Random weights, a hundred times too large: nonsense, but finite, inside limits, rates and above the floor."""
    rng = np.random.default_rng(4)
    known = embedded_network()
    for size in (1.0, 100.0):
        shapes = [getattr(known, name).shape for name in PoseNetwork.__slots__ if name != "note"]
        wild = PoseNetwork(*[rng.normal(0, size, shape).astype(np.float32) for shape in shapes])
        samples = [
            stage.sample(t, head=(np.sin(t), stage.eye[1] * (0.6 + 0.4 * np.cos(3 * t)), t), turn=head_turn(2 * t))
            for t in seconds(3.0)
        ]
        result = track(samples, solver=LearnedSolver(stage.body, wild))
        lowest = result.joints[:, list(FEET), 1].min()
        assert lowest > stage.body.sole - 0.011
        assert not result.tracker.solver_error


def test_solvers_by_name(body: Body, skeleton: Skeleton) -> None:
    assert isinstance(solver_of("learned", body), LearnedSolver)
    with pytest.raises(PoseError, match="learned, analytic"):
        Tracker(skeleton, solver="lerned")  # type: ignore[arg-type]


def test_a_broken_model_is_a_clear_error_and_the_analytic_solver_stays(
    skeleton: Skeleton, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = (resources.files("glsplat.extras.learned") / "network.npz").read_bytes()
    (tmp_path / "network.npz").write_bytes(whole[: len(whole) // 2])
    monkeypatch.setattr(module.resources, "files", lambda package: tmp_path)
    embedded_network.cache_clear()
    try:
        with pytest.raises(FormatError, match=r"network.npz: a tracking model"):
            Tracker(skeleton, solver="learned")
        Tracker(skeleton, solver="analytic")
    finally:
        embedded_network.cache_clear()


def test_the_analytic_solver_steps_in_near_the_ground_and_leaves_again(stage: Stage, track: Track) -> None:
    """Down on all fours and up again: the head stays exact, nothing jumps, feet do not slide."""
    x, y, z = stage.eye

    def head(t: float) -> tuple[float, float, float]:
        low = 0.5 - 0.5 * np.cos(np.pi * min(max(t - 1, 0.0), 4.0) / 2)
        return (x, y * (1 - 0.62 * low), z + 0.5 * low)

    samples = [stage.sample(t, head=head(t), left=None, right=None) for t in seconds(7.0)]
    solver = LearnedSolver(stage.body, embedded_network())
    shares = []
    update = solver.uncertainty.update
    solver.uncertainty.update = lambda *seen: shares.append(update(*seen)) or shares[-1]  # type: ignore[method-assign]
    result = track(samples, solver=solver)
    assert min(shares) == 0 and max(shares) == 1 and shares[-1] == 0
    eyes = np.array([s.head[:3] for s in samples])  # type: ignore[index]
    moved = result.joints[:, HEAD] - eyes
    assert np.abs(moved[:, 1] - moved[0, 1]).max() < 0.1  # a head that tilts is not below its eyes
    assert np.linalg.norm(np.diff(result.joints[:, list(FEET)], axis=0), axis=-1).max() * 72 < 8  # as of a step
    assert np.linalg.norm(np.diff(result.joints[:, :1], axis=0), axis=-1).max() * 72 < 3


LAGS = range(-10, 11)  # samples that the pelvis may be behind


@pytest.mark.check
@pytest.mark.shared
def test_dances_tremble_little_more_than_the_truth(shared_data: Path, skeleton: Skeleton, track: Track) -> None:
    """Three dances of 131, 4 s of each: at 72 Hz jitter was 1.4 times the truth's, by swings that were hurried."""
    scores, alike = [], dict.fromkeys(LAGS, 0.0)
    for clip in (1, 2, 3):
        motion = load_motion(str(shared_data / "mocap" / f"cmu_131_0{clip}.bvh"), skeleton)
        count = round(4 * motion.fps)
        truth = truth_from_motion(skeleton, motion.rotations[:count], motion.trans[:count], motion.fps, 72.0)
        run = track(derive(skeleton, truth, fingers=False), solver="learned")
        scores.append(score(run.joints, truth.positions, 72.0, Body.of(skeleton).sole))
        ours, true = (np.gradient(joints[:, 0, [0, 2]], axis=0) for joints in (run.joints, truth.positions))
        for k in LAGS:
            pair = ours[max(k, 0) : len(ours) + min(k, 0)], true[max(-k, 0) : len(true) - max(k, 0)]
            alike[k] += float((pair[0] * pair[1]).sum())
    assert max(alike, key=alike.__getitem__) / 72 <= 0.035  # behind; ahead is no lag
    mean = mean_score(scores)
    assert mean.jitter < 1.35 * mean.jitter_truth
    assert mean.skate < 1.0
