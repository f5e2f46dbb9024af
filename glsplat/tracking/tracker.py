"""Tracker: samples in, poses out. Judges the input, filters, predicts, solves; the output stays finite and smooth."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import flag, instance
from glsplat.errors import PoseError
from glsplat.skinning.pose import Pose
from glsplat.skinning.skeleton import Skeleton
from glsplat.tracking.arm_scaling import ArmScaling
from glsplat.tracking.body_trackers import BodyTrackers
from glsplat.tracking.calibration import Calibration, SessionCalibration
from glsplat.tracking.checked_solver import CheckedSolver, repeated, zero_pose
from glsplat.tracking.config import TrackerConfig
from glsplat.tracking.face import eye_turn, finite_expression
from glsplat.tracking.filters import HeadAndHandFilters
from glsplat.tracking.fingers import BothHandsFingers
from glsplat.tracking.guard import Guard
from glsplat.tracking.judge import InputJudge, Moment
from glsplat.tracking.sample import Sample
from glsplat.tracking.solve.body import EYES, FINGERS, Body
from glsplat.tracking.solve.quat import rotation_vector, sub
from glsplat.tracking.solve.solution import Solution, Solver
from glsplat.tracking.solvers import SolverName, solver_of

OUT_OF_REACH_M = 0.01  # metres a wrist misses its hand by before that is flagged
HEAD_LIMIT_RAD = 0.05  # radians a head gives up to the neck's limits before that is flagged


class Tracker:
    """Turn a user's tracking into the avatar's pose.

    The pose is in the avatar's own metres, its ground at y = 0: world positions are divided by ``calibration.scale``
    after the floor is subtracted. Draw the avatar at unit size and divide the cameras' positions likewise
    (``to_avatar``). Not thread-safe; one Tracker a user. Deterministic: the same samples give the same poses.

    ``solver``: "learned" (the default: a network guesses torso and legs), "analytic", or an object (docs/tracking.md).
    An object of your own may raise or return an invalid body: the last pose is then held, ``flags`` has
    "solver_failed" and ``solver_error`` has the reason. Raises PoseError for a solver without ``reset`` and ``solve``.

    The stages, in the order of ``update``: session calibration, input judge, filters and prediction of head and hands,
    body trackers, solver, guard, arm scaling, face, fingers.
    """

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
        start = instance(calibration or Calibration(), Calibration, "calibration", PoseError)
        self.config: TrackerConfig = instance(config or TrackerConfig(), TrackerConfig, "config", PoseError)
        self.prediction: float = self.config.prediction  # seconds; may change from sample to sample
        self.body: Body = Body.of(skeleton)
        self.solver: Solver = solver_of(solver, self.body)
        self.head_only: bool = flag(head_only, "head_only", PoseError)
        self._session = SessionCalibration(self.body, start, self.config.gap)
        self._judge = InputJudge(self.body, self.config, start.head_pitch, self.head_only)
        self._filters = HeadAndHandFilters(self.config, self.head_only)
        self._body_trackers = BodyTrackers(self.body, self.config, start)
        self._checked_solver = CheckedSolver(self.solver)
        self._guard = Guard(self.body, self.config.joint_speed, self.config.root_speed, self.config.foot_speed)
        self._arm_scaling = ArmScaling(self.body, self.config.arm_scaling)
        self._fingers = BothHandsFingers(self.body, self.config.finger_smoothing)
        self.reset()

    def reset(self) -> None:
        """Forget everything: a new user or a new place."""
        stages = (self._session, self._judge, self._filters, self._body_trackers, self._checked_solver)
        for stage in (*stages, self._guard, self._arm_scaling, self._fingers):
            stage.reset()
        self._pose: Pose | None = None
        self.flags: tuple[str, ...] = ()
        self.reach_error: tuple[float | None, float | None] = (None, None)
        self.expected_error: tuple[float, ...] = ()

    @property
    def calibration(self) -> Calibration:
        """The calibration in use; an automatic one changes while the session runs."""
        return self._session.calibration

    @property
    def solver_error(self) -> str:
        """Why the newest pose is held although there was a sample, in one line; empty where it is not."""
        return self._checked_solver.error

    def update(self, sample: Sample) -> Pose:
        """Return the pose at ``sample.t`` (plus ``prediction`` seconds), read-only and finite.

        Never raises for a sample's contents, nor for the solver's errors.

        Sets ``flags`` (what was out of the ordinary), ``reach_error`` (metres by which each wrist misses its hand;
        None: not tracked) and ``expected_error`` (metres each of the 22 body joints is probably off by, as the learned
        solver estimates; empty: no estimate).
        """
        if not isinstance(sample, Sample):
            raise PoseError(
                f"a tracker takes a Sample (Sample.from_json reads other forms), not {type(sample).__name__}"
            )
        flags: list[str] = []
        dt = self._judge.advance(sample.t, flags)
        if dt is None and self._pose is not None:
            self.flags = tuple(flags)
            return self._pose
        calibration = self._session.update(sample, dt or 0.0)
        scale, floor, first = calibration.scale, calibration.floor, self._pose is None
        moment = self._judge.update(sample, dt, self._filters.head.pose, scale, floor, first, flags)
        if moment.restart:
            self._filters.reset()
            self._body_trackers.lose()
        targets = self._filters.update(moment, self.prediction, flags)
        eye = self._filters.eye
        if not self.head_only:
            self._body_trackers.update(sample, eye, targets, moment.dt, self.prediction, scale, flags)
        solution = self._checked_solver.update(targets, moment.dt, moment.restart)
        past_dt = 0.0 if moment.restart else moment.dt  # 0: speeds have no bound, the body starts anew
        if solution is not None:
            self._body_trackers.learn(solution, eye, moment.dt)
        else:
            flags.append("solver_failed")
            # never a jump: not to the held body, and from it only at the speeds of every body
            last = self._guard.last
            solution, past_dt = (zero_pose(self.body), 0.0) if last is None else (repeated(last), moment.dt)
        self._guard.update(solution, past_dt)
        translations = self._arm_scaling.update(solution, targets, past_dt)
        rotations = np.zeros((55, 3))
        rotations[:22] = [rotation_vector(turn) for turn in solution.rotations]
        for joint, gaze in zip(EYES, (sample.left_eye, sample.right_eye), strict=True):
            rotations[joint] = eye_turn(gaze, flags)
        for joints, fingers in zip(FINGERS, self._fingers.update(sample, moment.hands, past_dt, flags), strict=True):
            rotations[joints] = fingers
        trans = np.array(sub(solution.pelvis, self.body.joints[0]))
        rotations.flags.writeable = trans.flags.writeable = False  # a repeated time gives the same pose again
        self._pose = Pose(rotations, trans, translations, finite_expression(sample, flags))
        self._report(solution, moment, scale, flags)
        return self._pose

    def __call__(self, tracking: Mapping[str, Any], t: float) -> Pose:
        """Track the "tracking" object of a request at the client's time ``t`` in milliseconds, as render servers do."""
        return self.update(Sample.from_json(tracking, t / 1000))

    def to_avatar(self, matrix: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return a pose [4, 4] of the tracking space (head, camera) in the avatar's space."""
        out = np.array(matrix, np.float64)
        out[1, 3] -= self.calibration.floor
        out[:3, 3] /= self.calibration.scale
        return out

    def joints(self, pose: Pose) -> NDArray[np.float64]:
        """Return the joints [55, 3] of a pose in the tracking space, metres."""
        points = self.skeleton.forward(pose.rotations, pose.trans, pose.translations)[:, :3, 3] * self.calibration.scale
        points[:, 1] += self.calibration.floor
        return points

    def _report(self, solution: Solution, moment: Moment, scale: float, flags: list[str]) -> None:
        """Set flags and errors of the newest pose; ``scale``: the user's metres in one of the avatar's."""
        self.expected_error = tuple([metres * scale for metres in solution.expected_error])
        (left, right), (left_hand, right_hand) = solution.reach, moment.hands
        self.reach_error = (left * scale if left_hand else None, right * scale if right_hand else None)
        for name, hand, miss in (("left", left_hand, left), ("right", right_hand, right)):
            if hand is not None and miss > OUT_OF_REACH_M:
                flags.append(f"{name}_out_of_reach")
        if solution.head_off > HEAD_LIMIT_RAD:
            flags.append("head_limit")
        if solution.airborne:
            flags.append("airborne")
        else:
            flags.extend([f"{n}_planted" for n, p in zip(("left", "right"), solution.planted, strict=True) if p])
        self.flags = (*flags, *solution.notes)
