"""A solver of one's own that misbehaves: update() never raises, what is shown stays finite and never jumps."""

from __future__ import annotations

import itertools
import logging
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from glsplat.data import default_avatar
from glsplat.errors import PoseError
from glsplat.rotations import rotation_matrices
from glsplat.tracking.config import TrackerConfig
from glsplat.tracking.sample import Sample
from glsplat.tracking.solve.body import Body
from glsplat.tracking.solve.solution import Solution
from glsplat.tracking.solve.solver import AnalyticSolver
from glsplat.tracking.tracker import Tracker

NAN, INF = math.nan, math.inf
SKELETON = default_avatar().skeleton
CONFIG = TrackerConfig()
IDENTITY = (1.0, 0.0, 0.0, 0.0)


def spoiled(joint: int, value: Any) -> Any:
    def spoil(s: Solution) -> Any:
        rotations: list[Any] = [*s.rotations]
        rotations[joint % 22] = value
        return replace(s, rotations=rotations)

    return spoil


def failing(error: Exception) -> Any:
    def fail(s: Solution) -> Any:
        raise error

    return fail


GOOD = {
    "as it is": lambda s: s,
    "numpy": lambda s: replace(s, rotations=np.array(s.rotations), pelvis=np.array(s.pelvis), notes=()),
    "float32": lambda s: replace(s, rotations=list(np.array(s.rotations, np.float32)), reach=np.zeros(2)),
    "of length 3": lambda s: replace(s, rotations=[tuple(3 * v for v in q) for q in s.rotations]),
    "other sign": lambda s: replace(s, rotations=[tuple(-v for v in q) for q in s.rotations]),
    "no feet": lambda s: replace(s, feet=[None, None], planted=[1, 0]),
}
BAD = {
    "NaN": spoiled(3, (NAN, 0.0, 0.0, 0.0)),
    "NaN last": spoiled(21, (1.0, 0.0, 0.0, NAN)),
    "infinite": spoiled(0, (INF, 0.0, 0.0, 0.0)),
    "zero": spoiled(7, (0.0, 0.0, 0.0, 0.0)),
    "three numbers": spoiled(9, (1.0, 0.0, 0.0)),
    "matrices": lambda s: replace(s, rotations=np.tile(np.eye(3), (22, 1, 1))),
    "strings": spoiled(1, ("1", "0", "0", "0")),
    "None": spoiled(2, None),
    "huge": spoiled(4, (1e200, 0.0, 0.0, 0.0)),
    "21 joints": lambda s: replace(s, rotations=s.rotations[:21]),
    "55 joints": lambda s: replace(s, rotations=[IDENTITY] * 55),
    "pelvis NaN": lambda s: replace(s, pelvis=(0.0, NAN, 0.0)),
    "pelvis far": lambda s: replace(s, pelvis=(1e300, 0.0, 0.0)),
    "pelvis short": lambda s: replace(s, pelvis=(0.0, 1.0)),
    "reach NaN": lambda s: replace(s, reach=(NAN, 0.0)),
    "reach None": lambda s: replace(s, reach=None),
    "head_off": lambda s: replace(s, head_off="much"),
    "notes": lambda s: replace(s, notes="limited"),
    "notes of numbers": lambda s: replace(s, notes=[1]),
    "feet": lambda s: replace(s, feet=((0.0, INF, 0.0), None)),
    "planted": lambda s: replace(s, planted=(True,)),
    "nothing": lambda s: None,
    "a dict": lambda s: {"rotations": s.rotations},
    "ValueError": failing(ValueError("a\nb")),
    "RuntimeError": failing(RuntimeError("CUDA out of memory")),
    "ZeroDivisionError": failing(ZeroDivisionError()),
    "RecursionError": failing(RecursionError()),
}
KINDS = GOOD | BAD


class Own:
    """The analytic solver behind what ``kind`` makes of its solutions."""

    def __init__(self) -> None:
        self.inner, self.kind, self.fails_to_reset = AnalyticSolver(Body.of(SKELETON)), "as it is", False

    def reset(self) -> None:
        self.inner.reset()
        if self.fails_to_reset:
            raise RuntimeError("no reset")

    def solve(self, targets: Any, dt: float) -> Any:
        return KINDS[self.kind](self.inner.solve(targets, dt))


def sample(t: float, x: float) -> Sample:
    hands = (x + 0.3, 1.2 + 0.2 * math.sin(5 * t), 0.3, 0.0, 0.0, 0.0, 1.0), (x - 0.3, 1.1, 0.3, 0.0, 0.0, 0.0, 1.0)
    return Sample(t, (x, 1.6 + 0.05 * math.sin(3 * t), 0.1, 0.0, 0.0, 0.0, 1.0), *hands)


def turned(a: np.ndarray, b: np.ndarray) -> float:
    """Radians, the largest of the joints."""
    chord = np.linalg.norm(rotation_matrices(a) - rotation_matrices(b), axis=(1, 2)) / np.sqrt(8)
    return float((2 * np.arcsin(np.clip(chord, 0, 1))).max())


@pytest.fixture(autouse=True)
def quiet(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.CRITICAL, "glsplat.tracking")


@settings(suppress_health_check=list(HealthCheck))
@given(
    st.lists(st.tuples(st.sampled_from(sorted(KINDS)), st.integers(1, 6)), min_size=1, max_size=8),
    st.sampled_from([1 / 90, 1 / 72, 1 / 30]),
    st.sampled_from([0.0, 0.8, 3.0]),
    st.booleans(),
)
def test_whatever_a_solver_does_the_body_stays_finite_and_does_not_jump(
    phases: list[tuple[str, int]], dt: float, speed: float, fails_to_reset: bool
) -> None:
    own = Own()
    tracker = Tracker(SKELETON, solver=own)
    own.fails_to_reset = fails_to_reset
    last, t = None, 0.0
    for kind, count in phases:
        own.kind = kind
        for _ in range(count):
            t += dt
            pose = tracker.update(sample(t, speed * t))
            assert np.isfinite(pose.rotations).all() and np.isfinite(pose.trans).all()
            failed = kind in BAD or (fails_to_reset and last is None)
            assert ("solver_failed" in tracker.flags) == failed == bool(tracker.solver_error), (kind, tracker.flags)
            assert "\n" not in tracker.solver_error and len(tracker.solver_error) <= 300
            if last is not None:
                assert turned(pose.rotations[:22], last.rotations[:22]) <= CONFIG.joint_speed * dt * 1.02 + 1e-6
                assert np.linalg.norm(pose.trans - last.trans) <= CONFIG.root_speed * dt * 1.02
                if failed:
                    np.testing.assert_array_equal(pose.rotations[:22], last.rotations[:22])
                    np.testing.assert_array_equal(pose.trans, last.trans)
            last = pose


@pytest.mark.parametrize("kind", BAD)
def test_each_fault_is_held_told_and_over_when_the_solver_recovers(kind: str) -> None:
    own, reference = Own(), Tracker(SKELETON, solver="analytic")
    tracker = Tracker(SKELETON, solver=own)
    for i in range(30):
        own.kind = kind if 10 <= i < 13 else "as it is"
        pose, expected = tracker.update(sample(i / 72, 0.2 * i / 72)), reference.update(sample(i / 72, 0.2 * i / 72))
        assert ("solver_failed" in tracker.flags) == (10 <= i < 13)
    np.testing.assert_allclose(pose.rotations, expected.rotations, atol=1e-3)
    np.testing.assert_allclose(pose.trans, expected.trans, atol=1e-3)


def test_a_teleport_while_the_solver_fails_is_a_walk_and_not_a_jump() -> None:
    own = Own()
    tracker = Tracker(SKELETON, solver=own)
    poses = []
    for i in range(60):
        own.kind = "NaN" if 10 <= i < 15 else "as it is"
        poses.append(tracker.update(sample(i / 72, 0.0 if i < 12 else 3.0)).trans)
    steps = np.linalg.norm(np.diff(poses, axis=0), axis=1) * 72
    assert steps.max() <= CONFIG.root_speed * 1.02 and abs(poses[-1][0] - 3.0) < 0.1


def test_a_solver_that_returns_one_object_again_and_again_is_bounded_too() -> None:
    shared = Solution([IDENTITY] * 22, (0.0, 0.95, 0.0))

    class Reusing:
        def reset(self) -> None: ...

        def solve(self, targets: Any, dt: float) -> Solution:
            shared.pelvis = targets.eye[0], 0.95, 0.0
            shared.rotations[16] = (0.0, 0.0, 0.0, 1.0) if targets.eye[0] > 0.2 else IDENTITY
            return shared

    tracker = Tracker(SKELETON, config=TrackerConfig.raw(), solver=Reusing())
    poses = [tracker.update(sample(i / 72, 0.0 if i < 5 else 0.6)) for i in range(12)]
    for a, b in itertools.pairwise(poses):
        assert turned(a.rotations[:22], b.rotations[:22]) <= CONFIG.joint_speed / 72 * 1.02


def test_limits_hold_for_a_solver_that_knows_none() -> None:
    """A knee that bends forwards is brought inside its range."""
    own = Own()
    KINDS["knee"] = spoiled(4, (math.cos(0.5), -math.sin(0.5), 0.0, 0.0))
    tracker = Tracker(SKELETON, solver=own)
    own.kind = "knee"
    try:
        pose = tracker.update(sample(0.0, 0.0))
    finally:
        del KINDS["knee"]
    assert np.linalg.norm(pose.rotations[4]) < 0.2


@pytest.mark.parametrize("solver", [object(), 5, lambda targets, dt: None])
def test_what_is_no_solver_is_refused(solver: Any) -> None:
    with pytest.raises(PoseError, match=r"needs the methods reset\(\) and solve\(targets, dt\)"):
        Tracker(SKELETON, solver=solver)


def test_a_solver_that_never_works_leaves_the_zero_pose_on_the_floor() -> None:
    own = Own()
    own.kind = "nothing"
    tracker = Tracker(SKELETON, solver=own)
    for i in range(3):
        pose = tracker.update(sample(i / 72, 0.0))
        assert not pose.rotations[:22].any() and abs(pose.trans[1]) < 0.02
        assert tracker.solver_error == "a solver returns a Solution, not NoneType"


def test_an_interruption_is_not_swallowed() -> None:
    own = Own()
    tracker = Tracker(SKELETON, solver=own)
    KINDS["stop"] = failing(KeyboardInterrupt())  # type: ignore[arg-type]
    own.kind = "stop"
    try:
        with pytest.raises(KeyboardInterrupt):
            tracker.update(sample(0.0, 0.0))
    finally:
        del KINDS["stop"]
