"""Judge samples: the first stage of a Tracker checks time stamps, poses and jumps; poses in the avatar's metres."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite, sqrt

from glsplat.tracking.config import TrackerConfig
from glsplat.tracking.sample import Sample, Transform
from glsplat.tracking.solve.body import HAND_FRAMES, HEAD, HEAD_FRAME, Body
from glsplat.tracking.solve.quat import IDENTITY, JointPose, Quat, Vec, conj, distance, mul, to_quat

MAX_DISTANCE_M = 1e4  # a device farther away is not tracked
MIN_STEP_S = 1e-4  # samples closer than this are of one moment
FIRST_STEP_S = 1 / 72  # assumed between samples until two were seen
MAX_TYPICAL_STEP_S = 0.1  # longer ones are holes, not the device's rate
CLOCK_SET_BACK_S = 1.0  # time that runs back by more begins anew
TELEPORT_SPEED = 8.0  # m/s a head may move beyond ``TrackerConfig.teleport``
FROZEN_AFTER_S = 0.25  # of the very same head pose


@dataclass(frozen=True, slots=True)
class Moment:
    """The judged head and hands of one sample: joint poses in the avatar's metres; None: not tracked."""

    head: JointPose | None
    hands: tuple[JointPose | None, JointPose | None]
    dt: float  # seconds since the last sample, at most ``TrackerConfig.gap``
    restart: bool  # the body starts anew: the first sample, a teleport or a gap


class InputJudge:
    """Decide what of a sample can be believed."""

    def __init__(self, body: Body, config: TrackerConfig, head_pitch: float, head_only: bool) -> None:
        self.body, self.config, self.head_only = body, config, head_only
        self._head_frame: Quat = head_frame(head_pitch)
        self._hand_frames = (conj(HAND_FRAMES["left"]), conj(HAND_FRAMES["right"]))
        # of the device, so that a new user changes nothing
        self._last_head: tuple[float, ...] | None = None  # as in the sample
        self._repeats = 0  # samples in a row with that head
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._time: float | None = None
        self._typical_dt = FIRST_STEP_S

    def advance(self, t: float, flags: list[str]) -> float | None:
        """Return the seconds since the last sample; None for a time that must not move the body."""
        try:
            valid = isfinite(t)
        except (TypeError, ValueError, OverflowError):  # not a number at all
            valid = False
        if not valid:
            flags.append("time_invalid")
            return None
        last, self._time = self._time, t
        if last is None:
            return self._typical_dt
        dt = t - last
        if dt < -CLOCK_SET_BACK_S:
            flags.append("clock")
            return self._typical_dt
        if dt < MIN_STEP_S:
            self._time = last
            flags.append("time_repeated" if dt >= 0 else "time_backwards")
            return None
        if dt < MAX_TYPICAL_STEP_S:
            self._typical_dt = dt
        return dt

    def update(
        self,
        sample: Sample,
        dt: float | None,
        last_head: JointPose | None,  # as filtered
        scale: float,
        floor: float,
        first: bool,
        flags: list[str],
    ) -> Moment:
        """Return the moment of a sample ``dt`` seconds after the last one; ``first``: there was no pose before it."""

        def read(pose: Transform | None, frame: Quat) -> JointPose | None:
            found = read_pose(pose, scale, floor, flags)
            return None if found is None else (found[0], mul(found[1], frame))

        head, restart = read(sample.head, self._head_frame), first
        tracked = head is not None
        hands: tuple[JointPose | None, JointPose | None] = (None, None)
        if not self.head_only:
            hands = (read(sample.left, self._hand_frames[0]), read(sample.right, self._hand_frames[1]))
        if head is None:
            flags.append("head_lost")
            if last_head is None:  # nothing is known yet: stand at the origin
                x, _, z = self.body.joints[HEAD]
                head = ((x, self.body.eye_height, z + self.body.eye[2]), IDENTITY)
        elif last_head is not None:
            if distance(head[0], last_head[0]) > self.config.teleport + TELEPORT_SPEED * (dt or 0.0):
                flags.append("teleport")
                restart = True
        if dt is not None and dt > self.config.gap:
            flags.append("gap")
            restart = True
        if restart and head is None:  # lost over a gap: stay where it was last seen
            head = last_head
        if tracked and sample.head is not None:
            raw = tuple(sample.head)
            self._repeats = self._repeats + 1 if raw == self._last_head else 0
            self._last_head = raw
            if self._repeats * self._typical_dt > FROZEN_AFTER_S:
                flags.append("frozen")
        return Moment(head, hands, min(dt or self._typical_dt, self.config.gap), restart)


def head_frame(pitch: float) -> Quat:
    """Return the rotation from a headset's axes, pitched down by ``pitch`` radians, to the head joint's rest axes."""
    return mul(conj(HEAD_FRAME), to_quat((-pitch, 0.0, 0.0)))


def read_pose(pose: Sequence[float] | None, scale: float, floor: float, flags: list[str]) -> JointPose | None:
    """Return position and rotation of 7 numbers; a pose that is not seven numbers is flagged "invalid"."""
    if pose is None:
        return None
    try:
        x, y, z, qx, qy, qz, qw = pose
        if not within_range(x, y, z):
            return None
        n = qx * qx + qy * qy + qz * qz + qw * qw
        if not 1e-8 < n < 1e8:  # NaN fails this too
            return None
        n = 1 / sqrt(n)
    except (TypeError, ValueError):  # not seven numbers
        flag_invalid(flags)
        return None
    k = 1 / scale
    return (x * k, (y - floor) * k, z * k), (qw * n, qx * n, qy * n, qz * n)


def read_position(joint: Sequence[float] | None, scale: float, floor: float, flags: list[str]) -> Vec | None:
    """Return the position in the first three numbers."""
    if joint is None:
        return None
    try:
        x, y, z = joint[:3]
        return (x / scale, (y - floor) / scale, z / scale) if within_range(x, y, z) else None
    except (TypeError, ValueError):
        flag_invalid(flags)
        return None


def within_range(x: float, y: float, z: float) -> bool:
    """Return whether a position is finite and within ``MAX_DISTANCE_M``."""
    far = MAX_DISTANCE_M  # NaN fails every comparison, infinity these
    return -far < x < far and -far < y < far and -far < z < far


def flag_invalid(flags: list[str]) -> None:
    """Flag that the sample holds something of another type than it should."""
    if "invalid" not in flags:
        flags.append("invalid")
