"""Calibration: the avatar's scale, the floor and the head's offset, measured beforehand or found in the session.

A mount is the rigid offset of a body tracker: its joint's pose in the tracker's frame, in metres of the avatar. Joints:
pelvis for the waist, ankles for the feet, as in the rest frames of SMPL-X.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from math import hypot, sqrt
from pathlib import Path
from statistics import median
from typing import Any

import msgspec

from glsplat.errors import FormatError, PoseError
from glsplat.io.files import replace_file
from glsplat.skinning.skeleton import Skeleton
from glsplat.tracking.body_size import STRETCHED_WRISTS, BodySizeFinder, with_arms
from glsplat.tracking.judge import MAX_DISTANCE_M, head_frame, read_pose
from glsplat.tracking.sample import TRACKERS, Sample, Transform
from glsplat.tracking.solve import quat
from glsplat.tracking.solve.body import ANKLES, EYES, HEAD_FRAME, PELVIS, Body
from glsplat.tracking.solve.heading import head_pitch
from glsplat.tracking.solve.quat import JointPose, Quat, Vec, clamp, conj, length, mul, sub

MIN_SCALE, MAX_SCALE = 0.5, 2.0  # of the avatar
MAX_HEAD_MOVE_M = 0.05  # while it is measured
MIN_SAMPLES = 10  # with a head
MIN_EYES_M, MAX_EYES_M = 0.5, 2.6  # above the floor
MAX_HEAD_PITCH_RAD = 0.35  # a larger one is not the headset's but the user's, who looks up or down
SPAN_QUANTILE = 0.9  # of the distances between both wrists, that is the arm span
EYES_OF_STATURE = 0.936  # eye height / stature (Drillis & Contini 1966)
MAX_GAP_S = 0.5  # between samples that measure a size
MIN_MOUNT_SAMPLES = 10  # with a tracker, to learn how it is mounted
MAX_MOUNT_ERROR_M = 0.5  # from a tracker to its joint
MIN_SCALE_CHANGE = 1e-5  # smaller changes of the found scale are ignored

JOINTS = (PELVIS, *ANKLES)
"""Joints of the waist, the left and the right foot, in the order of ``TRACKERS``."""

MAX_MOUNT_M = (0.25, 0.2, 0.2)
"""Limit of the distance from each tracker to its joint: a tracker is on its user's body."""


@dataclass(frozen=True, slots=True)
class Calibration:
    """How a user's room maps to the avatar. The defaults fit a user of the avatar's own size on a floor at y = 0."""

    scale: float = 1.0  # user metres = avatar metres * scale; the avatar is drawn at unit size, the world is divided
    floor: float = 0.0  # y of the floor in the tracking space, metres
    head_pitch: float = 0.0  # radians the headset points down when its user looks straight ahead
    eye_height: float | None = None  # metres, as measured; for information
    arm_span: float | None = None  # metres from wrist to wrist, as measured; for information
    # joints in the frames of their trackers (pelvis, ankles), metres of the user; None: learned when they are seen
    waist: Transform | None = None
    left_foot: Transform | None = None
    right_foot: Transform | None = None
    automatic: bool = False  # the session finds the scale, beginning with this one
    found: float | None = None  # the scale that a session would have found, beside a measured one; for information

    def __post_init__(self) -> None:
        for scale in (self.scale, self.scale if self.found is None else self.found):
            if not MIN_SCALE <= scale <= MAX_SCALE:
                raise PoseError(f"a calibration's scale needs {MIN_SCALE} to {MAX_SCALE}, not {scale:g}")
        if not abs(self.floor) < 100 or not abs(self.head_pitch) < 0.8:
            raise PoseError("a calibration needs a floor within 100 m and a head pitch below 45 degrees")
        for name, mount in zip(TRACKERS, self.mounts, strict=True):
            if mount is not None and not (len(mount) == 7 and hypot(*mount[:3]) < 1 and 0.9 < hypot(*mount[3:]) < 1.1):
                raise PoseError(f"a calibration's {name} needs a place within 1 m and a unit quaternion, not {mount}")

    @property
    def mounts(self) -> tuple[Transform | None, Transform | None, Transform | None]:
        """The trackers' mounts, in the order of ``TRACKERS``."""
        return self.waist, self.left_foot, self.right_foot

    @classmethod
    def of_height(cls, skeleton: Skeleton, height: float, floor: float = 0.0) -> Calibration:
        """Return the calibration of a stature in metres: eyes at 93.6 % of it (Drillis & Contini 1966)."""
        if not 0.5 <= height <= 2.8:
            raise PoseError(f"a height needs 0.5 to 2.8 metres, not {height:g}")
        eyes = EYES_OF_STATURE * height
        scale = clamp(eyes / Body.of(skeleton).eye_height, MIN_SCALE, MAX_SCALE)
        return cls(scale=scale, floor=floor, eye_height=eyes)

    def with_span(self, skeleton: Skeleton, span: float) -> Calibration:
        """Return a copy with a quarter of the scale by the user's arm span, wrist to wrist in metres.

        A span too far from the scale is not that of stretched arms: nothing changes.
        """
        scale = with_arms(self.scale, span / Body.of(skeleton).arm_span())
        if scale is None:
            return self
        return replace(self, scale=clamp(scale, MIN_SCALE, MAX_SCALE), arm_span=span)

    def to_json(self) -> dict[str, Any]:
        """Return the object that ``save`` writes, without mounts and a found size that are None."""
        optional = ("found", *TRACKERS)
        return {key: value for key, value in asdict(self).items() if value is not None or key not in optional}

    def save(self, path: str | Path) -> None:
        """Write JSON; an existing file is replaced whole."""
        replace_file(Path(path), [(json.dumps(self.to_json(), indent=1) + "\n").encode()])

    @classmethod
    def load(cls, path: str | Path) -> Calibration:
        """Read a file of ``save``. Raises FormatError naming the file."""
        try:
            data: Any = json.loads(Path(path).read_text(encoding="utf-8"))
            if isinstance(data, dict) and "scale" not in data:
                raise ValueError('found no "scale"')
            return msgspec.convert(data, cls)
        except OSError as error:
            raise FormatError(f"{path}: cannot read the calibration ({error.strerror})") from None
        except (ValueError, RecursionError, msgspec.ValidationError) as error:
            raise FormatError(f"{path}: a calibration is a JSON object of numbers, but {error}") from None
        except PoseError as error:
            raise FormatError(f"{path}: {error}") from None


def calibrate(
    samples: Sequence[Sample], skeleton: Skeleton, floor: float | None = None, height: float | None = None
) -> Calibration:
    """Calibrate by a user who stands still and looks ahead for some seconds, with arms stretched for the arm span.

    ``floor``: its y in the tracking space. Without it, it is where a user of the given ``height`` (metres) stands, or
    y = 0, where the runtimes of headsets put it.

    ``found`` of the result is the scale that a session would have found; the measured one is in use.

    Takes the stillest half of the samples (distance from the median eye). Raises PoseError when there are fewer than 10
    samples with a head, when the head moved, or when the eyes are not 0.5 to 2.6 m above the floor.
    """
    body = Body.of(skeleton)
    heads = [s.head for s in samples if s.head is not None and all(abs(v) < MAX_DISTANCE_M for v in s.head)]
    if len(heads) < MIN_SAMPLES:
        raise PoseError(f"calibration needs at least {MIN_SAMPLES} samples with a head, found {len(heads)}")
    middle = (median(h[0] for h in heads), median(h[1] for h in heads), median(h[2] for h in heads))
    heads.sort(key=lambda h: length(sub(h[:3], middle)))
    still = heads[: max(MIN_SAMPLES, len(heads) // 2)]
    if length(sub(still[-1][:3], middle)) > MAX_HEAD_MOVE_M:
        raise PoseError("the head moved while calibrating; stand still for two seconds and look straight ahead")
    level = sum(h[1] for h in still) / len(still)
    if floor is None:
        floor = 0.0 if height is None else level - EYES_OF_STATURE * height
    eyes = level - floor
    if not MIN_EYES_M <= eyes <= MAX_EYES_M:
        expected = f"{MIN_EYES_M} to {MAX_EYES_M} m"
        raise PoseError(f"the eyes are {eyes:.2f} m above the floor; expected {expected} (is the floor right?)")
    pitches = [head_pitch(quat.normalized(mul((h[6], h[3], h[4], h[5]), conj(HEAD_FRAME)))) for h in still]
    pitch = sum(pitches) / len(pitches)
    scale, span = eyes / body.eye_height, None
    spans = [
        length(sub(s.left[:3], s.right[:3]))
        for s in samples
        if s.left is not None
        and s.right is not None
        and all(abs(v) < MAX_DISTANCE_M for v in (*s.left, *s.right))
        # one hand that waves while the other hangs is as far from it as stretched arms of a smaller user
        and all(
            STRETCHED_WRISTS[0] * eyes <= hand[1] - floor <= STRETCHED_WRISTS[1] * eyes for hand in (s.left, s.right)
        )
    ]
    if spans:
        widest = sorted(spans)[int(SPAN_QUANTILE * (len(spans) - 1))]
        fitted = with_arms(scale, widest / body.arm_span())
        if fitted is not None:
            span, scale = widest, fitted
    scale = clamp(scale, MIN_SCALE, MAX_SCALE)
    size = found_size(samples, skeleton, floor)
    return Calibration(
        scale=scale,
        floor=floor,
        head_pitch=pitch if abs(pitch) < MAX_HEAD_PITCH_RAD else 0.0,
        eye_height=eyes,
        arm_span=span,
        found=None if size.eye_height is None else size.scale,
        **_mounts(samples, middle, body, scale, floor),  # type: ignore[arg-type]
    )


def found_size(samples: Sequence[Sample], skeleton: Skeleton, floor: float = 0.0) -> Calibration:
    """Return the automatic calibration that a session of these samples ends with; nobody needs to stand still.

    Its ``eye_height`` is None where the samples are not enough; the scale is then the avatar's own.
    """
    known, last = Calibration(floor=floor, automatic=True), None
    finder = BodySizeFinder(Body.of(skeleton), known.scale)
    for sample in samples:
        dt = 0.0 if last is None else sample.t - last
        last = sample.t
        if 0 < dt < MAX_GAP_S:
            finder.observe(sample, floor, conj(HEAD_FRAME), dt)
    return replace(known, scale=finder.goal, eye_height=finder.eye_height, arm_span=finder.arm_span)


def _mounts(samples: Sequence[Sample], middle: Vec, body: Body, scale: float, floor: float) -> dict[str, Transform]:
    """Return the mounts of trackers on a user who stands straight, the feet flat and side by side, and looks ahead."""
    means = {name: MeanMount() for name in TRACKERS}
    for sample in samples:
        head = read_pose(sample.head, scale, floor, [])
        if head is None or sample.head is None or length(sub(sample.head[:3], middle)) > MAX_HEAD_MOVE_M:
            continue
        yaw = quat.swing_twist_y(mul(head[1], conj(HEAD_FRAME)))
        if yaw is None:
            continue
        for name, joint in zip(TRACKERS, standing_joints(body, head[0], yaw), strict=True):
            tracker = read_pose(getattr(sample, name), scale, floor, [])
            if tracker is not None and length(sub(tracker[0], joint[0])) < MAX_MOUNT_ERROR_M:
                means[name].add(quat.relative(tracker, joint), 1.0)
    return {
        name: transform_of(bounded(mean.mount(), most), scale)
        for (name, mean), most in zip(means.items(), MAX_MOUNT_M, strict=True)
        if mean.weight >= MIN_MOUNT_SAMPLES
    }


def bounded(mount: JointPose, most: float) -> JointPose:
    """Return the mount with its offset shortened to ``most`` metres."""
    far = length(mount[0])
    return mount if far <= most else (quat.scale(mount[0], most / far), mount[1])


def standing_joints(body: Body, eye: Vec, yaw: float) -> list[JointPose]:
    """Return pelvis and ankles of the zero pose on the ground, its eyes over ``eye``, its heading ``yaw``."""
    turn = quat.yaw_quat(yaw)
    a, b = (body.joints[joint] for joint in EYES)
    x, _, z = quat.rotate(turn, (0.5 * (a[0] + b[0]), 0.0, 0.5 * (a[2] + b[2])))
    origin = (eye[0] - x, -body.ground, eye[2] - z)
    return [(quat.add(origin, quat.rotate(turn, body.joints[joint])), turn) for joint in JOINTS]


class MeanMount:
    """The weighted mean of several mounts."""

    def __init__(self) -> None:
        self.weight = 0.0
        self._offset: Vec = (0.0, 0.0, 0.0)
        self._turn: Quat = (0.0, 0.0, 0.0, 0.0)
        self._first: Quat | None = None

    def add(self, mount: JointPose, weight: float) -> None:
        """Add a mount."""
        offset, turn = mount
        first = self._first = self._first or turn
        sign = weight if sum([a * b for a, b in zip(first, turn, strict=True)]) >= 0 else -weight
        w, x, y, z = self._turn
        self._turn = (w + sign * turn[0], x + sign * turn[1], y + sign * turn[2], z + sign * turn[3])
        self._offset = quat.add(self._offset, quat.scale(offset, weight))
        self.weight += weight

    def mount(self) -> JointPose:
        """Return the mean; the identity where nothing was added."""
        if self.weight <= 0:
            return (0.0, 0.0, 0.0), quat.IDENTITY
        return quat.scale(self._offset, 1 / self.weight), quat.normalized(self._turn)


def transform_of(mount: JointPose, metres: float) -> Transform:
    """Return x, y, z times ``metres``, then the quaternion x, y, z, w."""
    (x, y, z), (w, i, j, k) = mount
    n = 1 / sqrt(w * w + i * i + j * j + k * k)
    return (x * metres, y * metres, z * metres, i * n, j * n, k * n, w * n)


class SessionCalibration:
    """The stage of a Tracker that finds the scale while the session runs, where the calibration is automatic."""

    def __init__(self, body: Body, start: Calibration, max_gap: float) -> None:
        self.body, self.start, self.max_gap = body, start, max_gap  # seconds between samples that measure a size
        self._head_frame = head_frame(start.head_pitch)
        self.reset()

    def reset(self) -> None:
        """Forget the user."""
        self.calibration = self.start
        self._finder = BodySizeFinder(self.body, self.start.scale) if self.start.automatic else None

    def update(self, sample: Sample, dt: float) -> Calibration:
        """Return the calibration after a sample ``dt`` seconds after the last one."""
        finder, start = self._finder, self.start
        if finder is None or not 0 < dt <= self.max_gap:
            return self.calibration
        scale = finder.observe(sample, start.floor, self._head_frame, dt)
        if abs(scale - self.calibration.scale) > MIN_SCALE_CHANGE:
            eyes, span = finder.eye_height or start.eye_height, finder.arm_span or start.arm_span
            self.calibration = replace(start, scale=scale, eye_height=eyes, arm_span=span)
        return self.calibration
