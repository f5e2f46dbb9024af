"""Calibration: from a few seconds of standing still to the avatar's scale, the floor and the head's offset."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any

from glsplat.errors import FormatError, PoseError
from glsplat.formats.files import replace_file
from glsplat.skinning.skeleton import Skeleton
from glsplat.tracking.sample import Sample
from glsplat.tracking.solve.body import HEAD_FRAME, Body
from glsplat.tracking.solve.heading import head_pitch
from glsplat.tracking.solve.quat import conj, length, mul, normalized, sub

__all__ = ["Calibration", "calibrate"]

SMALLEST, LARGEST = 0.5, 2.0  # limits of the avatar's scale
STILL = 0.05  # metres the head may move while it is measured
EYES_OF_STATURE = 0.936  # eye height / stature (Drillis & Contini 1966)
ARM_WEIGHT = 0.25  # of the arm span against the eye height in the scale
SHOULDERS = 0.65, 1.05  # of the eye height; hands of arms that are stretched sideways are between


@dataclass(frozen=True, slots=True)
class Calibration:
    """How a user's room maps to the avatar. The defaults fit a user of the avatar's own size on a floor at y = 0."""

    scale: float = 1.0  # user metres = avatar metres * scale; the avatar is drawn at unit size, the world is divided
    floor: float = 0.0  # y of the floor in the tracking space, metres
    head_pitch: float = 0.0  # radians the headset points down when its user looks straight ahead
    eye_height: float | None = None  # metres, as measured; for information
    arm_span: float | None = None  # metres from wrist to wrist, as measured; for information

    def __post_init__(self) -> None:
        if not SMALLEST <= self.scale <= LARGEST:
            raise PoseError(f"a calibration's scale needs {SMALLEST} to {LARGEST}, not {self.scale:g}")
        if not abs(self.floor) < 100 or not abs(self.head_pitch) < 0.8:
            raise PoseError("a calibration needs a floor within 100 m and a head pitch below 45 degrees")

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
        scale = _with_arms(self.scale, span / Body.of(skeleton).arm_span())
        if scale is None:
            return self
        return replace(self, scale=min(max(scale, SMALLEST), LARGEST), arm_span=span)

    def to_json(self) -> dict[str, float | None]:
        """The object that ``save`` writes."""
        return asdict(self)

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


def _number(value: Any, key: str) -> float | None:
    if value is None and key in ("eye_height", "arm_span"):
        return None
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ValueError(f"{key} is {type(value).__name__}")
    return float(value)


def _with_arms(scale: float, ratio: float) -> float | None:
    """The scale by eye height and by arm span, ``ratio`` of the avatar's; None: the arms were not stretched."""
    if not 0.85 * scale <= ratio <= 1.2 * scale:
        return None
    return (1 - ARM_WEIGHT) * scale + ARM_WEIGHT * ratio


def calibrate(
    samples: Sequence[Sample], skeleton: Skeleton, floor: float | None = None, height: float | None = None
) -> Calibration:
    """From a user who stands still and looks ahead for some seconds; arms stretched sideways also give the arm span.

    ``floor``: its y in the tracking space. Without it, it is where a user of the given ``height`` (metres) stands, or
    y = 0, where the runtimes of headsets put it.

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
        fitted = _with_arms(scale, widest / body.arm_span())
        if fitted is not None:
            span, scale = widest, fitted
    return Calibration(
        scale=min(max(scale, SMALLEST), LARGEST),
        floor=floor,
        head_pitch=pitch if abs(pitch) < 0.35 else 0.0,
        eye_height=eyes,
        arm_span=span,
    )
