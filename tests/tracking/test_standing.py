"""Upper bodies on legs that stand, and a network that says how far off it is: what the learned solver is made from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from glsplat.motion.motion import load_motion
from glsplat.skinning.skeleton import Skeleton
from glsplat.tracking.batch import forward_all, resample
from glsplat.tracking.learned.frames import KNOWN, OUTPUTS, Guess
from glsplat.tracking.learned.mixture import ALIKE, UNSEEN, Mixture
from glsplat.tracking.learned.steady import Steady
from glsplat.tracking.solve.body import ANKLES, FEET, PELVIS, SPINE1, SPINE3, WRISTS, Body
from glsplat.tracking.solvers import embedded_network
from glsplat.tracking.training.clips import clips_of, unit_of_skeleton
from glsplat.tracking.training.doubting import _fitted, _guessed, doubting
from glsplat.tracking.training.fit import MADE, shares_of
from glsplat.tracking.training.standing import TALL, stances_of, stood


def test_an_upper_body_stands_on_feet_that_stay(skeleton: Skeleton, rng: np.random.Generator) -> None:
    body = Body.of(skeleton)
    stances = stances_of(load_motion("wave-and-turn", skeleton), skeleton)
    assert stances and all(stance.height > TALL * (body.joints[PELVIS][1] - body.ground) for stance in stances)
    waves = load_motion("wave-and-turn", skeleton)
    made = stood(waves, stances, skeleton, rng)
    assert made is not None and made.fps == 30
    at, _ = forward_all(skeleton, made.rotations, made.trans)
    assert np.ptp(at[:, list(FEET)], axis=0).max() < 2e-3 and np.ptp(at[:, list(ANKLES)], axis=0).max() < 0.02
    np.testing.assert_allclose(at[:, list(FEET), 1] - body.ground, body.sole, atol=2e-3)
    assert np.ptp(at[:, PELVIS, [0, 2]], axis=0).max() > 0.01  # it sways
    # arms and spine are the other's
    theirs, _ = forward_all(skeleton, *resample(waves.rotations, waves.trans, waves.fps, 30.0))
    for joint in (*WRISTS, SPINE3):
        ours, other = (np.linalg.norm(p[:, joint] - p[:, SPINE1], axis=-1) for p in (at, theirs[: len(at)]))
        np.testing.assert_allclose(ours, other, atol=1e-6)


def test_who_would_fall_is_left_out(skeleton: Skeleton, rng: np.random.Generator) -> None:
    walk = load_motion("walk", skeleton)
    stances = stances_of(load_motion("wave-and-turn", skeleton), skeleton)
    rotations = walk.rotations.copy()
    rotations[:, PELVIS] = (1.5, 0.0, 0.0)  # lies on the belly
    assert stood(replace(walk, rotations=rotations), stances, skeleton, rng) is None
    assert stood(walk, [], skeleton, rng) is None


def test_clips_made_of_several_have_their_share(skeleton: Skeleton) -> None:
    walk = load_motion("walk", skeleton)
    clips = [*clips_of("a", walk, skeleton), *clips_of("b", walk, skeleton, made=True)]
    assert [clip.made for clip in clips].count(True) == 2
    share = shares_of(clips)
    assert share.sum() == pytest.approx(1)
    assert sum(s for s, clip in zip(share, clips, strict=True) if clip.made) == pytest.approx(MADE)


def test_a_doubt_is_fitted_to_what_is_off(rng: np.random.Generator) -> None:
    x = rng.normal(size=(20000, 5))
    rows, bias = np.array([0.4, -0.3, 0.0, 0.2, 0.0]), -2.0
    off = rng.exponential(np.exp(x @ rows + bias))
    found, at = _fitted(x, off, np.full(len(x), 1 / len(x)))
    np.testing.assert_allclose(found, rows, atol=0.03)
    assert at == pytest.approx(bias, abs=0.03)


def test_what_a_network_says_it_is_off_is_what_it_is(skeleton: Skeleton) -> None:
    """In the mean over the clips it was told of; the network itself is the same as before, to the last bit."""
    body, network = Body.of(skeleton), embedded_network()
    clips = [clips_of("a", load_motion(name, skeleton), skeleton, (1.0,))[0] for name in ("walk", "wave-and-turn")]
    told = doubting(network, clips, body)
    np.testing.assert_array_equal(told.back[:KNOWN], network.back[:KNOWN])
    assert told.back.shape[0] == OUTPUTS
    said, was = [], []
    for clip in clips:
        hidden, guessed = _guessed(told, clip, body)
        guess = Guess.of(hidden @ told.back.T + told.back_bias, unit_of_skeleton(skeleton))
        said.append(guess.off[:, 0, 0].mean())
        was.append(np.linalg.norm(guessed[:, 0] - clip.points[:, 0], axis=-1).mean())
    np.testing.assert_allclose(said, was, rtol=0.4)
    assert np.mean(said) == pytest.approx(np.mean(was), rel=0.2)


def best(network: float, analytic: float) -> float:
    """The share of the analytic guess for which the mean of two correlated guesses is off least, by trying all."""
    shares = np.linspace(0, 1, 10001)
    network *= UNSEEN[0]
    rest = 1 - shares
    off = (rest * network) ** 2 + (shares * analytic) ** 2 + 2 * ALIKE * shares * rest * network * analytic
    return float(shares[off.argmin()])


def test_shares_are_the_best_and_go_there_without_a_jump() -> None:
    mixture = Mixture()
    assert mixture.update(([0.1] * 3, [0.12] * 3), 1 / 72)[0] == pytest.approx(best(0.1, 0.12), abs=1e-3)
    assert Mixture().update(([0.02] * 3, [0.3] * 3), 1 / 72) == [0, 0, 0]
    shares = [mixture.update(([0.2] * 3, [0.15] * 3), 1 / 72)[0] for _ in range(144)]
    assert np.all(np.diff(shares) > 0) and np.diff(shares).max() < 0.02 and np.abs(np.diff(shares, 2)).max() < 2e-3
    assert shares[-1] == pytest.approx(best(0.2, 0.15), abs=0.01)


def test_a_steady_place_trembles_less_and_is_not_behind(rng: np.random.Generator) -> None:
    steady, dt = Steady(), 1 / 72
    walks = [(1.4 * i * dt, 0.9, 0.0) for i in range(200)]
    shown = [steady.update(place, dt) for place in walks]
    assert abs(shown[-1][0] - walks[-1][0]) < 1e-3
    steady.reset()
    trembles = rng.normal(0, 0.002, (400, 3))
    shown = np.array([steady.update((x, y, z), dt) for x, y, z in trembles.tolist()])
    jerk = [np.linalg.norm(np.diff(p, n=3, axis=0), axis=-1).mean() for p in (shown, trembles)]
    assert jerk[0] < 0.5 * jerk[1]
