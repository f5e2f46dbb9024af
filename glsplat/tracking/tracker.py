"""Tracker: samples in, poses out. Judges the input, filters, predicts, solves; the output stays finite and smooth."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import replace
from math import isfinite, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import flag, instance
from glsplat.errors import PoseError
from glsplat.skinning.expression import checked_expression
from glsplat.skinning.pose import Pose
from glsplat.skinning.skeleton import Skeleton
from glsplat.tracking.arm_scaling import Stretch
from glsplat.tracking.body_size import Finder
from glsplat.tracking.calibration import Calibration
from glsplat.tracking.checked import checked, finite, standing, still
from glsplat.tracking.config import TrackerConfig
from glsplat.tracking.devices import Extras
from glsplat.tracking.filters import Device, PositionFilter, RotationFilter
from glsplat.tracking.fingers import Fingers
from glsplat.tracking.gaze import EYES, eye_turn
from glsplat.tracking.guard import Guard
from glsplat.tracking.reading import invalid, read_pose
from glsplat.tracking.sample import Sample, Transform
from glsplat.tracking.solve.body import HAND_FRAMES, HEAD_FRAME, Body
from glsplat.tracking.solve.quat import IDENTITY, Quat, Vec, conj, mul, rotation_vector, to_quat
from glsplat.tracking.solve.solution import Solution, Solver, Targets
from glsplat.tracking.solvers import SolverName, solver_of

__all__ = ["Tracker", "TrackerConfig"]

log: logging.Logger = logging.getLogger("glsplat.tracking")

SHORTEST = 1e-4  # seconds; samples closer than this are the same moment
CHANGED = 1e-5  # of the scale that is found, below which it is the same
FINGERS_IN_TURN = 0.04  # seconds between samples below which the hands' fingers are fitted in turn


class Tracker:
    """A user's tracking turned into the avatar's pose.

    The pose is in the avatar's own metres, its ground at y = 0: world positions are divided by ``calibration.scale``
    after the floor is subtracted. Draw the avatar at unit size and divide the cameras' positions likewise
    (``to_avatar``). Not thread-safe; one Tracker a user. Deterministic: the same samples give the same poses.

    ``solver``: "learned" (the default: a network guesses torso and legs), "analytic", or an object (docs/tracking.md).
    One of your own may raise or return what is no body: the last pose is then held, ``flags`` has
    "solver_failed" and ``solver_error`` says why. Raises PoseError for a solver without ``reset`` and ``solve``.
    """

    config: TrackerConfig

    def __init__(
        self,
        skeleton: Skeleton,
        calibration: Calibration | None = None,
        config: TrackerConfig | None = None,
        solver: Solver | SolverName | None = None,
        head_only: bool = False,
    ) -> None:
        self.skeleton: Skeleton = instance(
            skeleton, Skeleton, "a tracker", PoseError, "an avatar has its own: .skeleton"
        )
        self.calibration: Calibration = instance(calibration or Calibration(), Calibration, "calibration", PoseError)
        self.config = c = instance(config or TrackerConfig(), TrackerConfig, "config", PoseError)
        self.prediction: float = c.prediction  # seconds; may change from sample to sample
        self.body: Body = Body.of(skeleton)
        self.solver: Solver = solver_of(solver, self.body)
        self._keeps_limits = getattr(type(self.solver), "keeps_limits", False)
        self.head_only: bool = flag(head_only, "head_only", PoseError)
        self._root = self.body.joints[0]
        self._stretch = Stretch(self.body, c.stretch)
        self._guard = Guard(self.body, c.joint_speed, c.root_speed, c.foot_speed)
        self._head = Device(
            PositionFilter(c.head_position, c.head_speed), RotationFilter(c.head_rotation, c.turn_speed)
        )
        self._hands = tuple(
            [
                Device(PositionFilter(c.hand_position, c.hand_speed), RotationFilter(c.hand_rotation, c.turn_speed))
                for _ in range(2)
            ]
        )
        self._fingers = (Fingers(self.body, 0, c.finger_smoothing), Fingers(self.body, 1, c.finger_smoothing))
        known = self.calibration
        self._extras = Extras(self.body, c, known.scale, known.floor, known.mounts)
        head = mul(conj(HEAD_FRAME), to_quat((-known.head_pitch, 0.0, 0.0)))
        self._known: Calibration = known  # that the session began with
        self._frames = (head, conj(HAND_FRAMES["left"]), conj(HAND_FRAMES["right"]))
        self.reset()

    def reset(self) -> None:
        """A new user or a new place: forget everything."""
        self.calibration = self._known
        self._finder = Finder(self.body, self._known.scale) if self._known.automatic else None
        self.solver.reset()
        self._guard.reset()
        self._stretch.reset()
        self._head.reset()
        for hand, fingers in zip(self._hands, self._fingers, strict=True):
            hand.reset()
            fingers.reset()
        self._extras.reset()
        self._extras.scale = self._known.scale
        self._time: float | None = None
        self._step = 1 / 72
        self._count = 0
        self._pose: Pose | None = None
        self.flags: tuple[str, ...] = ()
        self.solver_error: str = ""  # why the newest pose is held although there was a sample; one line
        self.reach_error: tuple[float | None, float | None] = (None, None)
        self.expected_error: tuple[float, ...] = ()

    # -- in

    def update(self, sample: Sample) -> Pose:
        """The pose at ``sample.t`` (plus ``config.prediction``), read-only, finite.

        Never raises for what a sample holds, nor for what the solver does.

        ``flags`` then tells what was out of the ordinary, ``reach_error`` the metres by which each wrist misses its
        hand (None: not tracked), ``expected_error`` the metres each of the 22 body joints is probably off by, as the
        learned solver says (empty: not said).
        """
        if not isinstance(sample, Sample):
            raise PoseError(
                f"a tracker takes a Sample (Sample.from_json reads other forms), not {type(sample).__name__}"
            )
        flags: list[str] = []
        dt = self._advance(sample.t, flags)
        if dt is None and self._pose is not None:
            self.flags = tuple(flags)
            return self._pose
        if self._finder is not None:
            self._find(self._finder, sample, dt or 0.0)
        head = self._read(sample.head, 0, flags)
        seen = None if head is None else sample.head
        hands: list[tuple[Vec, Quat] | None] = [None, None]
        if not self.head_only:
            hands = [self._read(sample.left, 1, flags), self._read(sample.right, 2, flags)]
        fresh = self._pose is None
        if head is None:
            flags.append("head_lost")
            if self._head.at is None:  # nothing is known yet: stand at the origin
                eye = self.body.joints[15]
                head = ((eye[0], self.body.eye_height, eye[2] + self.body.eye[2]), IDENTITY)
        elif self._head.at is not None:
            jump = _distance(head[0], self._head.at)
            if jump > self.config.teleport + 8.0 * (dt or 0.0):
                flags.append("teleport")
                fresh = True
        if dt is not None and dt > self.config.gap:
            flags.append("gap")
            fresh = True
        if fresh:
            if head is None and self._head.at is not None:  # lost over a gap: stay where it was last seen
                head = (self._head.at, self._head.turn)
            self._head.reset()
            for hand in self._hands:
                hand.reset()
            self._extras.lose()
        step = min(dt or self._step, self.config.gap)
        if seen is not None:
            self._frozen(seen, flags)
        targets = self._filtered(head, hands, step, flags)
        assert self._head.at is not None
        if not self.head_only:
            self._extras.prediction = self.prediction
            self._extras.update(sample, self._head.at, targets, step, flags)
        solution = self._solve(targets, step, fresh)
        if solution is not None:
            self._extras.learn(solution, self._head.at, step)
        else:
            flags.append("solver_failed")
            last = self._guard.last
            # never a jump: not to the held body, and from it only at the speeds of every body
            solution, fresh = (standing(self._root), True) if last is None else (still(last), False)
        return self._finish(solution, sample, hands, targets, 0.0 if fresh else step, flags)

    def __call__(self, tracking: Mapping[str, Any], t: float) -> Pose:
        """The "tracking" object of a request and the client's time in milliseconds (what a render server calls)."""
        return self.update(Sample.from_json(tracking, t / 1000))

    def to_avatar(self, matrix: NDArray[np.float64]) -> NDArray[np.float64]:
        """A pose [4, 4] of the tracking space (head, camera) in the avatar's space."""
        out = np.array(matrix, np.float64)
        out[1, 3] -= self.calibration.floor
        out[:3, 3] /= self.calibration.scale
        return out

    def joints(self, pose: Pose) -> NDArray[np.float64]:
        """[55, 3] joints of a pose in the tracking space, metres."""
        points = self.skeleton.forward(pose.rotations, pose.trans, pose.translations)[:, :3, 3] * self.calibration.scale
        points[:, 1] += self.calibration.floor
        return points

    def _advance(self, t: float, flags: list[str]) -> float | None:
        """Seconds since the last sample; None for one that must not move the body."""
        try:
            known = isfinite(t)
        except (TypeError, ValueError, OverflowError):  # not a number at all
            known = False
        if not known:
            flags.append("time_invalid")
            return None
        last, self._time = self._time, t
        if last is None:
            return self._step
        dt = t - last
        if dt < -1.0:  # the clock was set back
            flags.append("clock")
            return self._step
        if dt < SHORTEST:
            self._time = last
            flags.append("time_repeated" if dt >= 0 else "time_backwards")
            return None
        if dt < 0.1:
            self._step = dt
        return dt

    def _read(self, pose: Transform | None, device: int, flags: list[str]) -> tuple[Vec, Quat] | None:
        """Place and joint rotation in the avatar's space; None for a pose that is absent or cannot be one."""
        found = read_pose(pose, self.calibration.scale, self.calibration.floor, flags)
        return None if found is None else (found[0], mul(found[1], self._frames[device]))

    def _find(self, finder: Finder, sample: Sample, dt: float) -> None:
        """The scale that is known by now; a hand in nonsense places is no hand."""
        unseen: list[str] = []
        head, *hands = [
            read_pose(p, 1.0, self.calibration.floor, unseen) for p in (sample.head, sample.left, sample.right)
        ]
        if head is None or dt <= 0 or dt > self.config.gap:
            return
        turn = mul(head[1], self._frames[0])
        scale = finder.update(head[0], turn, [hand[0] for hand in hands if hand is not None], dt)
        if abs(scale - self.calibration.scale) > CHANGED:
            known, eyes, span = self._known, finder.eye_height, finder.arm_span
            self.calibration = replace(
                known, scale=scale, eye_height=eyes or known.eye_height, arm_span=span or known.arm_span
            )
            self._extras.scale = scale

    def _frozen(self, head: Transform, flags: list[str]) -> None:
        device, raw = self._head, tuple(head)
        device.frozen = device.frozen + 1 if raw == device.raw else 0
        device.raw = raw
        if device.frozen * self._step > 0.25:
            flags.append("frozen")

    # -- filter, solve

    def _filtered(
        self,
        head: tuple[Vec, Quat] | None,
        hands: list[tuple[Vec, Quat] | None],
        dt: float,
        flags: list[str],
    ) -> Targets:
        config, device = self.config, self._head
        if head is not None:
            device.at = device.position.update(head[0], dt)
            device.turn = device.rotation.update(head[1], dt)
        assert device.at is not None
        ahead = self.prediction, config.predicted_metres, config.predicted_radians
        eye, turn = device.at, device.turn
        if self.prediction > 0 and head is not None:
            eye, turn = device.ahead(*ahead)
        targets = Targets(eye, turn)
        for side, (device, hand) in enumerate(zip(self._hands, hands, strict=True)):
            if hand is None:
                if device.at is not None or not self.head_only:
                    flags.append("right_lost" if side else "left_lost")
                device.reset()
                continue
            device.at = at = device.position.update(hand[0], dt)
            device.turn = turn = device.rotation.update(hand[1], dt)
            if self.prediction > 0:
                at, turn = device.ahead(*ahead)
            if side:
                targets.right, targets.right_hand = at, turn
            else:
                targets.left, targets.left_hand = at, turn
        return targets

    def _solve(self, targets: Targets, dt: float, fresh: bool) -> Solution | None:
        """The solver's body, checked; None where it has none."""
        try:
            if fresh:
                self.solver.reset()
            solution = self.solver.solve(targets, min(dt, 0.1))
            for _ in range(int(dt / 0.1 - 1e-9)):  # a hole of some tenths of a second: let the body settle
                solution = self.solver.solve(targets, 0.1)
            # a solver of this package keeps joint limits exactly; checking them again could change the last bit
            if self._keeps_limits and finite(solution):
                self.solver_error = ""
                return solution
            solution = checked(solution)
        except Exception as error:
            if not self.solver_error:  # once, not at every sample
                log.warning("%s failed; the last pose is held", type(self.solver).__name__, exc_info=True)
            text = str(error) if isinstance(error, PoseError) else f"{type(error).__name__}: {error}"
            self.solver_error = " ".join(text.split())[:300]
            return None
        self.solver_error = ""
        return solution

    # -- out

    @staticmethod
    def _expression(sample: Sample, flags: list[str]) -> Mapping[str, float]:
        """The sample's, as it is, without what is not finite; none where it is no expression."""
        if not sample.expression:
            return {}
        try:
            given = sample.expression.items()
            finite_ones = {name: weight for name, weight in given if isfinite(weight)}
            found, whole = checked_expression(finite_ones), len(finite_ones) == len(given)
        except (AttributeError, TypeError, ValueError, OverflowError, PoseError):  # not a mapping of numbers
            found, whole = {}, False
        if not whole and "invalid" not in flags:
            flags.append("invalid")
        return found

    def _finish(
        self,
        solution: Solution,
        sample: Sample,
        hands: list[tuple[Vec, Quat] | None],
        targets: Targets,
        dt: float,
        flags: list[str],
    ) -> Pose:
        if dt <= 0:
            self._guard.reset()
        self._guard.step(solution, dt)
        longer = self._stretch.step(solution, targets, dt)
        rotations = np.zeros((55, 3))
        rotations[:22] = [rotation_vector(turn) for turn in solution.rotations]
        for joint, gaze in zip(EYES, (sample.left_eye, sample.right_eye), strict=True):
            rotations[joint] = eye_turn(gaze, flags)
        seconds, slow = dt or 1.0, not 0 < dt < FINGERS_IN_TURN
        self._count += 1
        for side, fingers in enumerate(self._fingers):
            joints, curl = (sample.right_joints, sample.right_curl) if side else (sample.left_joints, sample.left_curl)
            hand = hands[side]
            first = 40 if side else 25
            turn = None if hand is None else hand[1]
            fit = slow or self._count % 2 == side
            try:
                if joints is not None and (len(joints) != 25 or min(map(len, joints)) < 3):
                    raise ValueError
                rotations[first : first + 15] = fingers.update(joints, turn, curl, seconds, fit)
            except (TypeError, ValueError, IndexError):  # not 25 joints of numbers
                invalid(flags)
                rotations[first : first + 15] = fingers.update(None, turn, None, seconds)
        root = self._root
        x, y, z = solution.pelvis
        trans = np.array((x - root[0], y - root[1], z - root[2]))
        rotations.flags.writeable = trans.flags.writeable = False  # a repeated time gives the same pose again
        pose = Pose(rotations, trans, longer, self._expression(sample, flags))
        scale = self.calibration.scale
        self.expected_error = tuple([metres * scale for metres in solution.expected_error])
        left, right = solution.reach
        self.reach_error = (
            None if hands[0] is None else left * scale,
            None if hands[1] is None else right * scale,
        )
        for name, hand, miss in (("left", hands[0], left), ("right", hands[1], right)):
            if hand is not None and miss > 0.01:
                flags.append(f"{name}_out_of_reach")
        if solution.head_off > 0.05:
            flags.append("head_limit")
        if solution.airborne:
            flags.append("airborne")
        else:
            flags.extend([f"{n}_planted" for n, p in zip(("left", "right"), solution.planted, strict=True) if p])
        flags.extend(solution.notes)
        self.flags = tuple(flags)
        self._pose = pose
        return pose


def _distance(a: Vec, b: Vec) -> float:
    return sqrt((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2)
