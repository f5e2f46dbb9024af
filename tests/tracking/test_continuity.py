"""Whatever head and hands do, no joint jumps, no foot goes under the floor, and what is called planted stands still.

Seeded walks with stops, squats, turns and glances; recordings that begin in mid-stride; teleports; noise; heads that
are nowhere twice. The bounds hold from every sample to the next, but for declared jumps.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from glsplat.skinning.skeleton import Skeleton
from glsplat.tracking import Sample, Solution, Targets, TrackerConfig
from glsplat.tracking.solve.body import ANKLES, FEET, Body
from glsplat.tracking.solve.quat import IDENTITY
from glsplat.tracking.solve.solver import AnalyticSolver
from tests.tracking.moves import DECLARED, DT, Run, Stage, Track, hand_turn, head_turn

SPEEDS = (0.0, 0.0, 0.3, 1.3, 1.3, 3.5)  # m/s that a stroller changes between
HEIGHTS = (1.0, 1.0, 1.0, 0.95, 0.7, 0.5, 1.1)  # of the eyes


def stroll(body: Body, seed: int, rate: float, begin: float = 0.0, noise: float = 0.0, jumps: bool = False):
    """Four seconds of an aimless user; ``begin``: m/s at first; ``noise``: metres and 7 times as many rad."""
    rng = np.random.default_rng(seed)
    dt, yaw = 1 / rate, rng.uniform(-3, 3)
    place, velocity = np.array([0.0, body.eye_height - 0.02, 0.1]), begin * np.array([np.sin(yaw), 0, np.cos(yaw)])
    goal, height, look, nod, spin, phase = velocity[[0, 2]], place[1], np.zeros(2), np.zeros(2), 0.0, rng.uniform(0, 6)
    for i in range(int(4 * rate)):
        if rng.random() < dt / 0.7:
            way = yaw + rng.normal(0, 0.8)
            goal = rng.choice(SPEEDS) * np.array([np.sin(way), np.cos(way)])
            spin = rng.normal(0, 1.5) * (rng.random() < 0.5)
            height, look = body.eye_height * rng.choice(HEIGHTS) - 0.02, rng.normal(0, 0.4, 2)
        velocity[[0, 2]] += (goal - velocity[[0, 2]]) * dt / 0.25
        velocity[1] += (20 * (height - place[1]) - 8 * velocity[1]) * dt
        place = place + velocity * dt + (rng.normal(0, noise, 3) if noise else 0)
        if jumps and rng.random() < dt / 1.5:
            place = place + np.array([rng.normal(0, 3), 0.0, rng.normal(0, 3)])
        yaw += spin * dt + (rng.normal(0, 7 * noise) if noise else 0)
        nod = nod + (look - nod) * dt / 0.3
        speed = np.hypot(*velocity[[0, 2]])
        phase += dt * 2 * np.pi * (0.6 + 0.3 * speed)
        s, c, swing = np.sin(yaw), np.cos(yaw), 0.2 * np.sin(phase) * min(1.0, speed)
        hands = []
        for side, sign in (("left", 1), ("right", -1)):
            x, z = 0.25 * sign, 0.1 + sign * swing
            at = place + [x * c + z * s, -0.6, -x * s + z * c]
            hands.append((*at, *hand_turn(side, (0.0, yaw, -1.2 * sign))))
        yield Sample(i * dt, (*place, *head_turn(yaw, nod[0], 0.5 * nod[1])), hands[0], hands[1])


def nowhere(seed: int, rate: float):
    """A head that is somewhere else every sample, within less than a teleport."""
    rng = np.random.default_rng(seed)
    for i in range(int(2 * rate)):
        turn = rng.normal(size=4)
        head = (*(rng.uniform(-0.25, 0.25, 3) + (0, 1.45, 0)), *(turn / np.linalg.norm(turn)))
        yield Sample(i / rate, head, (*(rng.uniform(-1, 1, 3) + (0, 1, 0)), 0.0, 0.0, 0.0, 1.0))


def moved(result: Run) -> np.ndarray:
    """[T-1, 22] metres a second from sample to sample; 0 where a jump was declared."""
    steps = np.linalg.norm(np.diff(result.joints[:, :22], axis=0), axis=-1) / np.diff(result.times)[:, None]
    steps[[bool(DECLARED & set(flags)) for flags in result.flags[1:]]] = 0
    return steps


def bounded(result: Run, body: Body, most: float) -> None:
    """The bounds that hold for all of them."""
    speeds, config = moved(result), TrackerConfig()
    feet = speeds[:, list(FEET)] - speeds[:, :1]
    assert feet.max() < config.foot_speed + 0.01
    assert (speeds[:, list(ANKLES)] - speeds[:, :1]).max() < config.foot_speed + 6  # the foot may turn as well
    assert speeds.max() < most
    assert result.joints[:, list(FEET + ANKLES), 1].min() > body.sole - 0.01
    planted = np.array([[f"{side}_planted" in flags for side in ("left", "right")] for flags in result.flags])
    declared = np.array([bool(DECLARED & set(flags)) for flags in result.flags[1:]])
    still = planted[1:] & planted[:-1] & ~declared[:, None]
    assert (speeds[:, list(FEET)] * still).max() < 0.1


@pytest.mark.parametrize("rate", [30.0, pytest.param(72.0, marks=pytest.mark.check)])
@pytest.mark.parametrize("seed", range(4))
def test_strolls_with_stops_squats_and_turns(body: Body, track: Track, seed: int, rate: float) -> None:
    result = track(stroll(body, seed, rate))
    bounded(result, body, 18.0)
    assert not any(DECLARED & set(flags) for flags in result.flags)


@pytest.mark.parametrize("speed", [1.0, 2.0, 4.0])
def test_recordings_that_begin_in_mid_stride(body: Body, track: Track, speed: float) -> None:
    for seed in range(3):
        bounded(track(stroll(body, 10 + seed, 30.0, begin=speed)), body, 24.0)


@pytest.mark.parametrize(("moves", "hurries"), [(1, 1), (3, 1), (4, 0)])
def test_feet_hurry_only_into_a_walk_of_the_first_moves(
    stage: Stage, monkeypatch: pytest.MonkeyPatch, moves: int, hurries: int
) -> None:
    """A gait that is recognised after so many moves of the body, at once a whole walk or not."""
    solver, calls, started = AnalyticSolver(stage.body), itertools.count(), []

    def walks(*_: object) -> None:
        solver.legs.gait.walking = next(calls) >= moves

    monkeypatch.setattr(solver.legs.gait, "update", walks)
    monkeypatch.setattr(solver.legs, "start_walking", started.append)
    for i in range(8):
        x, y, z = stage.eye
        solver.solve(Targets((x, y, z + 1.3 * i * DT), IDENTITY), DT)
    assert len(started) == hurries


@pytest.mark.parametrize("seed", range(3))
def test_teleports_start_anew_without_a_jump_after_them(body: Body, track: Track, seed: int) -> None:
    result = track(stroll(body, 20 + seed, 72.0, begin=1.5, jumps=True))
    assert any("teleport" in flags for flags in result.flags)
    bounded(result, body, 25.0)


@pytest.mark.parametrize("seed", range(3))
def test_rough_noise(body: Body, track: Track, seed: int) -> None:
    bounded(track(stroll(body, 30 + seed, 72.0, noise=0.02)), body, 40.0)


@pytest.mark.parametrize("rate", [30.0, 90.0])
def test_heads_that_are_nowhere_twice(body: Body, track: Track, rate: float) -> None:
    """The limit of a joint's speed holds through the joint limits, too."""
    for seed in range(2):
        result = track(nowhere(seed, rate))
        bounded(result, body, 60.0)
        assert 10 < result.rates()[:, 1:].max() < 1.02 * TrackerConfig().joint_speed


def test_walking_that_begins_in_mid_step_goes_on_with_the_step(stage: Stage, track: Track) -> None:
    """A sway becomes a walk while a foot is in the air, at every moment of its swing."""
    x, y, z = stage.eye
    for late in np.linspace(0.3, 0.9, 4):
        samples = []
        for i in range(180):
            t = i / 72
            way = 0.3 * min(t, late) + 1.4 * max(0.0, t - late)
            samples.append(stage.sample(t, head=(x, y, z + way), left=None, right=None))
        bounded(track(samples), stage.body, 12.0)


def test_a_slow_walk_backwards_does_not_lean_back(stage: Stage, track: Track) -> None:
    x, y, z = stage.eye
    for speed in (0.15, 0.25, 0.35):
        result = track([stage.sample(i / 72, head=(x, y, z - speed * i / 72)) for i in range(360)])
        torso = result.joints[72:, 12] - result.joints[72:, 0]
        lean = np.degrees(np.arctan2(torso[:, 2], torso[:, 1]))
        assert np.quantile(lean, 0.05) > -4, f"{speed} m/s: {lean.min():.1f} degrees"


def test_feet_of_any_solver_stay_on_the_floor(stage: Stage, skeleton: Skeleton, track: Track) -> None:
    """A plugged-in solver without any sense of the floor."""

    class Sinking:
        def reset(self) -> None:
            pass

        def solve(self, targets: Targets, dt: float) -> Solution:
            return Solution([IDENTITY] * 22, (0.0, targets.eye[1] - 0.7, 0.0))

    result = track([stage.sample(i / 72, head=(0.0, 1.7 - 0.01 * i, 0.0)) for i in range(100)], solver=Sinking())
    assert result.joints[:, list(FEET), 1].min() > stage.body.sole - 0.01


@pytest.mark.parametrize("height", [0.6, 0.75, 0.9, 1.05])
def test_a_level_head_low_over_the_floor_that_trembles_does_not_shake_the_body(
    stage: Stage, track: Track, rng: np.random.Generator, height: float
) -> None:
    """Half a millimetre and a twentieth of a degree, about a pitch of 0."""
    y = stage.body.eye_height
    samples = []
    for i in range(288):
        down = min(1.0, i / 72)
        head = np.array([0.0, y + (height - y) * down, 0.1]) + rng.normal(0, 5e-4, 3)
        samples.append(stage.sample(i / 72, head=tuple(head), turn=head_turn(*rng.normal(0, 1e-3, 3)), left=None))
    assert moved(track(samples))[144:].max() < 2.0
