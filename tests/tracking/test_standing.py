"""Upper bodies on legs that stand, and a network that says how far off it is: what the learned solver is made from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from glsplat.motion.loading import load_motion
from glsplat.skinning.skeleton import Skeleton
from glsplat.tracking.batch import forward_all, resample
from glsplat.tracking.learned.steady import Steady
from glsplat.tracking.solve.body import ANKLES, FEET, PELVIS, SPINE1, SPINE3, WRISTS, Body
from glsplat.tracking.training.clips import clips_of
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
