"""Calibration: from a few seconds of standing still to the avatar's scale, the floor and the head's offset."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from math import hypot
from pathlib import Path
from statistics import median
from typing import Any

from glsplat.errors import FormatError, PoseError
from glsplat.io.files import replace_file
from glsplat.skinning.skeleton import Skeleton
from glsplat.tracking.body_size import SHOULDERS, Finder, with_arms
from glsplat.tracking.mounts import MOST, Mean, between, numbers, standing, within
from glsplat.tracking.reading import read_pose
from glsplat.tracking.sample import TRACKERS, Sample, Transform
from glsplat.tracking.solve.body import HEAD_FRAME, Body
from glsplat.tracking.solve.heading import head_pitch
from glsplat.tracking.solve.quat import Vec, conj, length, mul, normalized, sub, swing_twist_y

__all__ = ["Calibration", "calibrate", "found_size"]

SMALLEST, LARGEST = 0.5, 2.0  # limits of the avatar's scale
STILL = 0.05  # metres the head may move while it is measured
EYES_OF_STATURE = 0.936  # eye height / stature (Drillis & Contini 1966)
GAP = 0.5  # seconds between samples, beyond which they say nothing of what was between
LEAST = 10  # samples with a tracker that tell how it is mounted
NEARBY = 0.5  # metres that it is from its joint at most


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
    automatic: bool = False  # the scale is found while the session runs, from this one on
    # the scale that a session finds by itself, beside one that was measured; it does not count
    found: float | None = None

    def __post_init__(self) -> None:
        for scale in (self.scale, self.scale if self.found is None else self.found):
            if not SMALLEST <= scale <= LARGEST:
                raise PoseError(f"a calibration's scale needs {SMALLEST} to {LARGEST}, not {scale:g}")
        if not abs(self.floor) < 100 or not abs(self.head_pitch) < 0.8:
            raise PoseError("a calibration needs a floor within 100 m and a head pitch below 45 degrees")
        for name, mount in zip(TRACKERS, self.mounts, strict=True):
            if mount is not None and not (len(mount) == 7 and hypot(*mount[:3]) < 1 and 0.9 < hypot(*mount[3:]) < 1.1):
                raise PoseError(f"a calibration's {name} needs a place within 1 m and a unit quaternion, not {mount}")

    @property
    def mounts(self) -> tuple[Transform | None, Transform | None, Transform | None]:
        """Of the trackers, in the order of ``TRACKERS``."""
        return self.waist, self.left_foot, self.right_foot

    @classmethod
    def of_height(cls, skeleton: Skeleton, height: float, floor: float = 0.0) -> Calibration:
        """By a user's stature in metres (crown to floor); eyes are at 93.6 % of it (Drillis & Contini 1966)."""
        if not 0.5 <= height <= 2.8:
            raise PoseError(f"a height needs 0.5 to 2.8 metres, not {height:g}")
        eyes = EYES_OF_STATURE * height
        scale = min(max(eyes / Body.of(skeleton).eye_height, SMALLEST), LARGEST)
        return cls(scale=scale, floor=floor, eye_height=eyes)

    def with_span(self, skeleton: Skeleton, span: float) -> Calibration:
        """The same with a quarter of the scale by the user's arm span, wrist to wrist in metres.

        A span that is far from what the scale says is none of stretched arms: nothing changes.
        """
        scale = with_arms(self.scale, span / Body.of(skeleton).arm_span())
        if scale is None:
            return self
        return replace(self, scale=min(max(scale, SMALLEST), LARGEST), arm_span=span)

    def to_json(self) -> dict[str, Any]:
        """The object that ``save`` writes; what nobody wore, and a size that nobody looked for, is left out."""
        left_out = ("found", *TRACKERS)
        return {key: value for key, value in asdict(self).items() if value is not None or key not in left_out}

    def save(self, path: str | Path) -> None:
        """Write JSON; a file that is there is replaced whole."""
        replace_file(Path(path), [(json.dumps(self.to_json(), indent=1) + "\n").encode()])

    @classmethod
    def load(cls, path: str | Path) -> Calibration:
        """Read what ``save`` wrote. Raises FormatError naming the file."""
        try:
            data: Any = json.loads(Path(path).read_text(encoding="utf-8"))
            if not isinstance(data, dict):
                raise ValueError(f"found {type(data).__name__}")
            if "scale" not in data:
                raise ValueError('found no "scale"')
            known = {key: _number(data[key], key) for key in asdict(cls()) if key in data}
            return cls(**known)  # type: ignore[arg-type]
        except OSError as error:
            raise FormatError(f"{path}: cannot read the calibration ({error.strerror})") from None
        except (ValueError, TypeError, OverflowError, RecursionError) as error:
            raise FormatError(f"{path}: a calibration is a JSON object of numbers, but {error}") from None
        except PoseError as error:
            raise FormatError(f"{path}: {error}") from None


def _number(value: Any, key: str) -> float | bool | Transform | None:
    if key == "automatic":
        if not isinstance(value, bool):
            raise ValueError("automatic is neither true nor false")
        return value
    if value is None and key in ("eye_height", "arm_span", "found", *TRACKERS):
        return None
    if key in TRACKERS:
        if not isinstance(value, list) or len(value) != 7:
            raise ValueError(f"{key} is not a list of 7 numbers")
        if any(isinstance(v, bool) or not isinstance(v, (int, float)) for v in value):
            raise ValueError(f"{key} holds what is no number")
        return tuple([float(v) for v in value])  # type: ignore[return-value]
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ValueError(f"{key} is {type(value).__name__}")
    return float(value)


def calibrate(
    samples: Sequence[Sample], skeleton: Skeleton, floor: float | None = None, height: float | None = None
) -> Calibration:
    """From a user who stands still and looks ahead for some seconds; arms stretched sideways also give the arm span.

    ``floor``: its y in the tracking space. Without it, it is where a user of the given ``height`` (metres) stands, or
    y = 0, where the runtimes of headsets put it.

    ``found`` is what a session would have found by itself; files of both keep both, and what was measured counts.

    Takes the stillest half of the samples (distance from the median eye). Raises PoseError when there are fewer than 10
    samples with a head, when the head moved, or when the eyes are not 0.5 to 2.6 m above the floor.
    """
    body = Body.of(skeleton)
    heads = [s.head for s in samples if s.head is not None and all(abs(v) < 1e4 for v in s.head)]
    if len(heads) < 10:
        raise PoseError(f"calibration needs at least 10 samples with a head, found {len(heads)}")
    middle = (median(h[0] for h in heads), median(h[1] for h in heads), median(h[2] for h in heads))
    heads.sort(key=lambda h: length(sub((h[0], h[1], h[2]), middle)))
    still = heads[: max(10, len(heads) // 2)]
    if length(sub((still[-1][0], still[-1][1], still[-1][2]), middle)) > STILL:
        raise PoseError("the head moved while calibrating; stand still for two seconds and look straight ahead")
    level = sum(h[1] for h in still) / len(still)
    if floor is None:
        floor = 0.0 if height is None else level - EYES_OF_STATURE * height
    eyes = level - floor
    if not 0.5 <= eyes <= 2.6:
        raise PoseError(f"the eyes are {eyes:.2f} m above the floor; expected 0.5 to 2.6 m (is the floor right?)")
    pitches = [head_pitch(normalized(mul((h[6], h[3], h[4], h[5]), conj(HEAD_FRAME))), 0.0) for h in still]
    pitch = sum(pitches) / len(pitches)
    scale, span = eyes / body.eye_height, None
    spans = [
        length(sub((s.left[0], s.left[1], s.left[2]), (s.right[0], s.right[1], s.right[2])))
        for s in samples
        if s.left is not None
        and s.right is not None
        and all(abs(v) < 1e4 for v in (*s.left, *s.right))
        # one hand that waves while the other hangs is as far from it as stretched arms of somebody smaller
        and all(SHOULDERS[0] * eyes <= hand[1] - floor <= SHOULDERS[1] * eyes for hand in (s.left, s.right))
    ]
    if spans:
        widest = sorted(spans)[int(0.9 * (len(spans) - 1))]
        fitted = with_arms(scale, widest / body.arm_span())
        if fitted is not None:
            span, scale = widest, fitted
    scale = min(max(scale, SMALLEST), LARGEST)
    size = found_size(samples, skeleton, floor)
    return Calibration(
        scale=scale,
        floor=floor,
        head_pitch=pitch if abs(pitch) < 0.35 else 0.0,
        eye_height=eyes,
        arm_span=span,
        found=None if size.eye_height is None else size.scale,
        **_mounts(samples, middle, body, scale, floor),  # type: ignore[arg-type]
    )


def found_size(samples: Sequence[Sample], skeleton: Skeleton, floor: float = 0.0) -> Calibration:
    """What a session of these samples finds by itself: nobody needs to stand still. Goes on where it is used.

    Its ``eye_height`` is None where the samples tell nothing; the scale is then the avatar's own.
    """
    body, known, last = Body.of(skeleton), Calibration(floor=floor, automatic=True), None
    finder = Finder(body, known.scale)
    for sample in samples:
        head, *hands = [read_pose(pose, 1.0, floor, []) for pose in (sample.head, sample.left, sample.right)]
        dt = 0.0 if last is None else sample.t - last
        last = sample.t
        if head is not None and 0 < dt < GAP:
            turn = mul(head[1], conj(HEAD_FRAME))
            finder.update(head[0], turn, [hand[0] for hand in hands if hand is not None], dt)
    return replace(known, scale=finder.goal, eye_height=finder.eye_height, arm_span=finder.arm_span)


def _mounts(samples: Sequence[Sample], middle: Vec, body: Body, scale: float, floor: float) -> dict[str, Transform]:
    """How trackers sit on somebody who stands straight, the feet flat and side by side, and looks ahead."""
    found: dict[str, Mean] = {name: Mean() for name in TRACKERS}
    for sample in samples:
        head = read_pose(sample.head, scale, floor, [])
        if head is None or sample.head is None or length(sub(sample.head[:3], middle)) > STILL:
            continue
        yaw = swing_twist_y(mul(head[1], conj(HEAD_FRAME)))
        if yaw is None:
            continue
        for name, joint in zip(TRACKERS, standing(body, head[0], yaw), strict=True):
            tracker = read_pose(getattr(sample, name), scale, floor, [])
            if tracker is not None and length(sub(tracker[0], joint[0])) < NEARBY:
                found[name].add(between(tracker, joint), 1.0)
    return {
        name: numbers(within(mean.pose(), most), scale)
        for (name, mean), most in zip(found.items(), MOST, strict=True)
        if mean.worth >= LEAST
    }
