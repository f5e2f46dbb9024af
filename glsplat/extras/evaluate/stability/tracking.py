"""Extreme head and hands: the cases of docs/tracking.md. There is no float64 twin; rows name their measure."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.data import default_avatar
from glsplat.extras.evaluate.stability.frame import Case, Outcome
from glsplat.gl.context import Context
from glsplat.skinning.skeleton import Skeleton
from glsplat.tracking import Sample, Tracker
from glsplat.tracking.solve.body import ELBOWS, FEET, HAND_FRAMES, HEAD, HEAD_FRAME, HIPS, SHOULDERS, WRISTS, Body
from glsplat.tracking.solve.limits import violation
from glsplat.tracking.solve.quat import mul, to_quat, yaw_quat

RATE = 72.0
LIMIT = 0.5  # of ``violation``: rounding of the clamp
STILL = 2e-3  # metres that a joint of a body at rest moves per sample, at most

Vec = tuple[float, float, float]
Samples = Callable[["_User"], list[Sample]]
Judge = Callable[["_Run", "_User"], Outcome]

_Row = tuple[str, str, str, Samples, Judge]


@dataclass(frozen=True)
class _User:
    """Head and hands of a user who stands at the origin and faces +z."""

    body: Body

    @property
    def eye(self) -> Vec:
        return (0.0, self.body.eye_height, 0.13)

    def hand(self, side: int, height: float = 0.62, forward: float = 0.15) -> Vec:
        """Return the place of a hand; ``height`` is a share of the eyes' height, ``forward`` in metres."""
        return (0.25 if side == 0 else -0.25, height * self.body.eye_height, forward)

    def sample(
        self,
        t: float,
        head: Vec | None = None,
        look: Vec = (0.0, 0.0, 0.0),  # yaw, pitch down, roll
        left: Vec | str | None = "rest",
        right: Vec | str | None = "rest",
        stretch: float = 1.0,  # length of the head's quaternion
    ) -> Sample:
        turn = mul(mul(yaw_quat(look[0]), to_quat((look[1], 0.0, 0.0))), to_quat((0.0, 0.0, look[2])))
        w, x, y, z = mul(turn, HEAD_FRAME)
        poses: list[Any] = []
        for side, (name, place) in enumerate((("left", left), ("right", right))):
            at = self.hand(side) if place == "rest" else place
            hanging = mul(to_quat((0.0, 0.0, -1.2 if side == 0 else 1.2)), HAND_FRAMES[name])
            poses.append(None if at is None else (*at, *hanging[1:], hanging[0]))
        k = stretch
        return Sample(t, (*(head or self.eye), k * x, k * y, k * z, k * w), *poses)


@dataclass(frozen=True, eq=False)
class _Run:
    """A tracker's output for samples."""

    joints: NDArray[np.float64]  # [T, 55, 3]
    rotations: NDArray[np.float64]  # [T, 55, 3]
    flags: list[tuple[str, ...]]
    reach: list[tuple[float | None, float | None]]
    limits: float  # the largest violation

    @property
    def sound(self) -> bool:
        """Whether all poses are finite and within the joints' limits."""
        return bool(np.isfinite(self.joints).all() and np.isfinite(self.rotations).all()) and self.limits < LIMIT

    def said(self, flag: str) -> bool:
        return any(flag in flags for flags in self.flags)

    def restless(self) -> float:
        """Return the largest movement of a joint per sample in the last fifteen, metres."""
        return float(np.abs(np.diff(self.joints[-15:], axis=0)).max(initial=0))


def tracking_cases() -> list[Case]:
    """Return cases of arms, heads, devices and clocks at their limits."""
    rows = [*_arms(), *_heads(), *_devices(), *_clocks(), *_users()]
    return [
        Case("tracking", name, given, stated, _tracked(samples, judge)) for name, given, stated, samples, judge in rows
    ]


def _arms() -> list[_Row]:
    def straight(run: _Run, user: _User) -> Outcome:
        shoulder, elbow, wrist = (run.joints[-1, pair[0]] for pair in (SHOULDERS, ELBOWS, WRISTS))
        upper, lower = elbow - shoulder, wrist - elbow
        cosine = float(upper @ lower / np.linalg.norm(upper) / np.linalg.norm(lower))
        bend = math.degrees(math.acos(min(1.0, cosine)))
        missed = abs((run.reach[-1][0] or 0.0) - float(np.linalg.norm(np.array((2.0, 1.2, 2.0)) - wrist)))
        return Outcome(
            run.said("left_out_of_reach") and bend < 3 and missed < 1e-5, bend, "degrees of bend", _words(run)
        )

    def followed(run: _Run, user: _User) -> Outcome:
        fastest = float(np.linalg.norm(np.diff(run.joints[:, ELBOWS[0]], axis=0), axis=1).max()) * RATE
        return Outcome(fastest < 6, fastest, "m/s of the elbow", _words(run))

    def reached(within: float) -> Judge:
        def judge(run: _Run, user: _User) -> Outcome:
            missed = max(e for e in run.reach[-1] if e is not None)
            return Outcome(missed < within and run.restless() < STILL, missed, "m", _words(run))

        return judge

    def behind(user: _User) -> list[Sample]:
        back = 0.61 * user.body.eye_height
        return [user.sample(t, left=(0.05, back, -0.2), right=(-0.05, back, -0.2)) for t in _times(1.5)]

    def inside(user: _User) -> list[Sample]:
        return [user.sample(t, left=(0.0, 0.68 * user.body.eye_height, 0.0)) for t in _times(2)]

    def swapped(user: _User) -> list[Sample]:
        left, right = user.hand(0, forward=0.3), user.hand(1, forward=0.3)
        return [user.sample(t, left=left if t < 1 else right, right=right if t < 1 else left) for t in _times(2.5)]

    def far(user: _User) -> list[Sample]:
        return [user.sample(t, left=(2.0, 1.2, 2.0), right=(-2.0, 1.5, 2.0)) for t in _times(1)]

    def leaves(user: _User) -> list[Sample]:
        return [user.sample(t, left=(0.2, 1.35, 0.6 + 0.35 * math.sin(3.2 * t))) for t in _times(2)]

    def folded(run: _Run, user: _User) -> Outcome:
        upper = float(np.linalg.norm(run.joints[-1, ELBOWS[0]] - run.joints[-1, SHOULDERS[0]]))
        rest = float(np.linalg.norm(run.joints[0, ELBOWS[0]] - run.joints[0, SHOULDERS[0]]))
        return Outcome(abs(upper - rest) < 1e-6 and run.restless() < STILL, abs(upper - rest), "m of bone", _words(run))

    return [
        ("hands out of reach", "3 m in front", "straight arms towards them, the distance is told", far, straight),
        (
            "a hand leaves its reach",
            "and returns, 0.25 to 0.95 m ahead, at 1.1 m/s",
            "the elbow does not flip",
            leaves,
            followed,
        ),
        ("hands behind the back", "both", "reached within 6 cm, at rest", behind, reached(0.06)),
        ("hands swapped", "left and right change places", "arms cross within 10 cm, at rest", swapped, reached(0.1)),
        ("a hand inside the torso", "at the spine", "the arm folds, no bone is squeezed", inside, folded),
    ]


def _heads() -> list[_Row]:
    def up(user: _User) -> list[Sample]:
        x, y, z = user.eye
        return [user.sample(t, head=(x, min(y + 2 * t, 3.0), z), left=None, right=None) for t in _times(4)]

    def landed(run: _Run, user: _User) -> Outcome:
        above = float(run.joints[-1, list(FEET), 1].max()) - user.body.sole
        held = run.said("airborne") and "head_out_of_reach" in run.flags[-1] and above < 0.01
        return Outcome(held, above, "m above the floor", _words(run))

    def down(user: _User) -> list[Sample]:
        x, y, z = user.eye
        return [user.sample(t, head=(x, max(0.05, y - 1.2 * t), z), left=None, right=None) for t in _times(3)]

    def floor(run: _Run, user: _User) -> Outcome:
        lowest = float(run.joints[-1, :22, 1].min())
        return Outcome(lowest > -0.05 and run.joints[-1, 0, 1] > 0.15, lowest, "m, the lowest joint", _words(run))

    def looking(pitch: float) -> Samples:
        def samples(user: _User) -> list[Sample]:
            out = []
            for t in _times(2.5):
                shake = (0.01 * math.sin(40 * t), 0.01 * math.cos(37 * t))
                out.append(user.sample(t, look=(shake[0], pitch * min(1.0, 2 * t), shake[1])))
            return out

        return samples

    def heading(most: float) -> Judge:
        def judge(run: _Run, user: _User) -> Outcome:
            across = run.joints[:, HIPS[0]] - run.joints[:, HIPS[1]]
            turned = float(np.abs(np.degrees(np.arctan2(-across[:, 2], across[:, 0]))).max())
            return Outcome(turned < most, turned, "degrees of turn", _words(run))

        return judge

    def rolled(user: _User) -> list[Sample]:
        return [user.sample(t, look=(0.0, 0.0, math.pi * min(1.0, t))) for t in _times(3)]

    def still(run: _Run, user: _User) -> Outcome:
        return Outcome(run.restless() < STILL, run.restless(), "m a sample", _words(run))

    def crouches(user: _User) -> list[Sample]:
        x, y, z = user.eye
        return [user.sample(t, head=(x, y - 0.02 * (1 - math.cos(6 * t)), z)) for t in _times(3)]

    def knees(run: _Run, user: _User) -> Outcome:
        bend = np.linalg.norm(run.rotations[:, 4], axis=1)  # of the left knee
        fastest = float(np.degrees(np.abs(np.diff(bend)).max())) * RATE
        return Outcome(fastest < 400, fastest, "degrees/s of the knee", _words(run))

    return [
        ("head 3 m up", "at 2 m/s", "a jump that ends on the floor below it", up, landed),
        ("head on the floor", "5 cm up", "crouched, nothing below the floor", down, floor),
        ("head straight up", "for seconds, trembling", "the body does not turn", looking(-math.pi / 2), heading(12)),
        ("head straight down", "for seconds, trembling", "the body does not turn", looking(math.pi / 2), heading(12)),
        ("head rolled by half a turn", "about its nose", "nothing flickers", rolled, still),
        ("straight knees", "bent by 4 cm of the head, and straight again", "no knee snaps", crouches, knees),
    ]


def _devices() -> list[_Row]:
    def teleports(user: _User) -> list[Sample]:
        x, y, z = user.eye
        return [user.sample(t, head=(x + 5.0 * (t > 1), y, z), left=None, right=None) for t in _times(2)]

    def arrived(run: _Run, user: _User) -> Outcome:
        declared = [i for i, flags in enumerate(run.flags) if "teleport" in flags]
        off = abs(float(run.joints[declared[0], HEAD, 0]) - 5) if declared else math.inf
        return Outcome(len(declared) == 1 and off < 0.1, off, "m", _words(run))

    def bad(user: _User) -> list[Sample]:
        out = []
        for i, t in enumerate(_times(1)):
            head = (math.nan, 1.0, 0.0) if i % 5 == 4 else None
            out.append(user.sample(t, head=head, left=(math.inf, 0.0, 0.0) if i % 7 == 6 else "rest"))
        return out

    def as_clean(run: _Run, user: _User) -> Outcome:
        clean = _solved([user.sample(t) for t in _times(1)])
        off = float(np.abs(run.joints[:, :22] - clean.joints[:, :22]).max())
        return Outcome(run.said("head_lost") and run.said("left_lost") and off < 0.03, off, "m", _words(run))

    def lost(user: _User) -> list[Sample]:
        return [user.sample(t) if t < 1 else Sample(t) for t in _times(3)]

    def stays(run: _Run, user: _User) -> Outcome:
        moved = float(np.abs(run.joints[-1, HEAD] - run.joints[int(0.9 * RATE), HEAD]).max())
        held = {"head_lost", "left_lost", "right_lost"} <= set(run.flags[-1]) and moved < 0.01
        return Outcome(held and run.restless() < STILL, moved, "m", _words(run))

    def lengths(user: _User) -> list[Sample]:
        return [user.sample(t, look=(0.2, 0.1, 0.0), stretch=(-1) ** i * (0.01 + i)) for i, t in enumerate(_times(0.5))]

    def as_unit(run: _Run, user: _User) -> Outcome:
        plain = _solved([user.sample(t, look=(0.2, 0.1, 0.0)) for t in _times(0.5)])
        off = float(np.abs(run.joints - plain.joints).max())
        return Outcome(off < 1e-9, off, "m", _words(run))

    return [
        ("the head jumps", "5 m within a sample", "declared, taken at once", teleports, arrived),
        ("NaN and infinity", "in every 5th head, every 7th hand", "lost for that sample, within 3 cm", bad, as_clean),
        ("everything is lost", "after a second", "the body stays", lost, stays),
        ("quaternions of any length", "0.01 to 35, either sign", "as of length 1", lengths, as_unit),
    ]


def _clocks() -> list[_Row]:
    def at(times: Sequence[float]) -> Samples:
        return lambda user: [user.sample(t, left=user.hand(0, 0.6 + 0.03 * (i % 5))) for i, t in enumerate(times)]

    def same(bad: Sequence[int]) -> Judge:
        def judge(run: _Run, user: _User) -> Outcome:
            off = max(float(np.abs(run.rotations[i] - run.rotations[i - 1]).max()) for i in bad)
            told = all(any(flag.startswith("time_") for flag in run.flags[i]) for i in bad)
            return Outcome(told and off == 0, off, "rad", _words(run))

        return judge

    def anew(flag: str) -> Judge:
        def judge(run: _Run, user: _User) -> Outcome:
            return Outcome(run.said(flag), None, seen=flag if run.said(flag) else _words(run))

        return judge

    dt = 1 / RATE
    return [
        ("time stamps repeat", "two of six", "the last pose again",
         at([0, dt, dt, 2 * dt, 2 * dt, 3 * dt]), same([2, 4])),
        ("time runs backwards", "two of six", "the last pose again",
         at([0, dt, 0.5 * dt, 2 * dt, 0, 3 * dt]), same([2, 4])),
        ("time not finite", "NaN, +-infinity", "the last pose again",
         at([0, math.nan, dt, math.inf, 2 * dt, -math.inf]), same([1, 3, 5])),
        ("tracking stalls", "10 s without a sample", "starts anew, declared",
         at([0, dt, 10.0, 10.0 + dt]), anew("gap")),
        ("the clock is set back", "by 1.5 s", "goes on from there, declared",
         at([*_times(1.5), *_times(0.3)]), anew("clock")),
        ("samples repeat", "one sample for 2 s", "flagged as frozen",
         lambda user: [user.sample(t) for t in _times(2)], anew("frozen")),
    ]  # fmt: skip


def _users() -> list[_Row]:
    def of(height: float) -> Samples:
        return lambda user: [user.sample(t, head=(0.0, 0.936 * height, 0.13), left=None, right=None) for t in _times(1)]

    def stands(run: _Run, user: _User) -> Outcome:
        off = abs(float(run.joints[-1, list(FEET), 1].min()) - user.body.sole)
        return Outcome(off < 0.02, off, "m off the floor", _words(run))

    return [
        (f"a user of {height:g} m", "without calibration", "still on the floor", of(height), stands)
        for height in (1.2, 2.1)
    ]


def _tracked(samples: Samples, judge: Judge) -> Callable[[Context], Outcome]:
    def check(_: Context) -> Outcome:
        user = _User(Body.of(_skeleton()))
        run = _solved(samples(user))
        outcome = judge(run, user)
        if run.sound:
            return outcome
        return Outcome(False, outcome.error, outcome.unit, f"not finite or beyond the limits ({run.limits:.2g})")

    return check


def _solved(samples: Sequence[Sample]) -> _Run:
    tracker = Tracker(_skeleton())
    poses, flags, reach, joints = [], [], [], []
    for sample in samples:
        pose = tracker.update(sample)
        poses.append(pose.rotations)
        flags.append(tracker.flags)
        reach.append(tracker.reach_error)
        joints.append(tracker.joints(pose))
    limits = max(float(violation(rotations)) for rotations in poses)
    return _Run(np.array(joints), np.array(poses), flags, reach, limits)


@lru_cache(maxsize=1)
def _skeleton() -> Skeleton:
    return default_avatar().skeleton


def _times(seconds: float) -> list[float]:
    return [i / RATE for i in range(math.ceil(seconds * RATE))]


def _words(run: _Run) -> str:
    """Return the tracker's flags in order of appearance, without "planted" and "frozen"."""
    said = dict.fromkeys(flag for flags in run.flags for flag in flags if not flag.endswith(("planted", "frozen")))
    return ", ".join(said) or "nothing to tell"
