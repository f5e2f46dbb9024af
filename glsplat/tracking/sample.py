"""Sample: the tracking of a headset at one moment, and its JSON form (docs/tracking.md).

Frames are those of OpenXR and WebXR: world right-handed, y up, metres; a pose is a position and a quaternion xyzw.

* ``head``: between the eyes; x right, y up, -z where the eyes look.
* ``left``/``right``: the wrist joint of hand tracking (XR_HAND_JOINT_WRIST_EXT, WebXR "wrist"): at the centre of the
  wrist, -z from it to the middle finger's knuckle, y out of the back of the hand, x to the right of a palm held down.
* a controller's grip pose (OpenXR 1.1, section 6.3.2, "grip") becomes a wrist pose on reading: ``wrist_from_grip``.
* ``left_joints``/``right_joints``: the 25 joints of WebXR Hand Input, section 4.2, in that order (the wrist, then thumb
  to little finger, each from the palm outwards), [x, y, z] or [x, y, z, qx, qy, qz, qw] each; OpenXR's 26 (palm first)
  lose the palm.
* ``waist``, ``left_foot``, ``right_foot``: trackers on the body, mounted anyhow; ``Tracker`` learns how.
* ``expression``: weights of ARKit's shapes by name, or 52 numbers in its order (skinning/expression.py); missing is 0.
* ``leftEye``, ``rightEye``: where an eye looks, [x, y, z] of any length in the head's axes (-z ahead).
* ``body``: joints of the WebXR Body Tracking Module by name (OpenXR's XR_FB_body_tracking behind it); places are used,
  of ``BODY_JOINTS`` alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Any

from glsplat.errors import PoseError
from glsplat.skinning.expression import ARKIT, MOST_NAMES

Transform = tuple[float, float, float, float, float, float, float]
"""x, y, z in metres, then the quaternion x, y, z, w."""

TRACKERS = ("waist", "left_foot", "right_foot")
"""Trackers that may be there beside head and hands."""

_LEG = ("upper-leg", "lower-leg", "foot-ankle", "foot-ball")  # hip, knee, ankle, ball of the foot
BODY_JOINTS: tuple[str, ...] = ("hips", "spine-lower", *(f"{side}-{j}" for side in ("left", "right") for j in _LEG))
"""WebXR's names (XRBodyJoint) of the joints that are used; others are ignored."""

MOST_JOINTS = 256  # entries of ``body``; WebXR has 83

GRIP_TO_WRIST_M = 0.09
"""From the palm's centre (the grip's origin) back to the wrist along the metacarpals (mean adult hand)."""

_WRIST_AXES = {"left": (-0.5, 0.5, 0.5, 0.5), "right": (-0.5, -0.5, -0.5, 0.5)}
"""Quaternions xyzw whose columns are the wrist's axes in the grip's."""

WRISTS = ("head", "left", "right", "left_grip", "right_grip")
"""Keys of JSON of which a sample needs one."""


@dataclass(frozen=True, slots=True)
class Sample:
    """Tracking at time ``t`` (seconds, any origin). None = not tracked. Numbers may be bad: the tracker judges them."""

    t: float
    head: Transform | None = None
    left: Transform | None = None
    right: Transform | None = None
    left_joints: tuple[tuple[float, ...], ...] | None = None  # 25 of 3 or 7 numbers
    right_joints: tuple[tuple[float, ...], ...] | None = None
    left_curl: float | None = None  # 0 open hand .. 1 fist (a controller's squeeze), used when the joints are unknown
    right_curl: float | None = None
    waist: Transform | None = None
    left_foot: Transform | None = None
    right_foot: Transform | None = None
    body: Mapping[str, tuple[float, ...]] | None = None  # of BODY_JOINTS, 3 or 7 numbers
    expression: Mapping[str, float] | None = None  # weights by name
    left_eye: tuple[float, ...] | None = None  # a direction in the head's axes
    right_eye: tuple[float, ...] | None = None

    @classmethod
    def from_json(cls, data: Any, t: float | None = None) -> Sample:
        """Parse the wire form of docs/protocol.md: {"head": [7], "left": [7] | null, ...}; ``t`` overrides "t".

        Unknown keys are ignored. Wrong counts or types are a PoseError; NaN is left for the tracker to handle.
        """
        if not isinstance(data, Mapping):
            raise PoseError(f'a tracking sample is an object {{"head": [7 numbers], ...}}, not {type(data).__name__}')
        if not any(key in data for key in WRISTS):
            raise PoseError(f'a tracking sample needs "head" or a hand; found {", ".join(map(str, data)) or "nothing"}')
        poses: dict[str, Transform | None] = {key: _transform(data.get(key), key) for key in WRISTS}
        for side in ("left", "right"):
            grip = poses[f"{side}_grip"]
            if poses[side] is None and grip is not None:
                poses[side] = wrist_from_grip(grip, side)
        time = _number(data.get("t", 0.0) if t is None else t, "t")
        return cls(
            0.0 if time is None else time,
            poses["head"],
            poses["left"],
            poses["right"],
            **{name: read(data.get(key), key) for name, (key, read) in _OPTIONAL.items()},
        )

    def to_json(self) -> dict[str, Any]:
        """Return the wire form plus "t"; absent poses are null, other absent keys are left out."""
        out: dict[str, Any] = {"t": self.t}
        for key in ("head", "left", "right"):
            out[key] = _plain(getattr(self, key))
        given = {key: getattr(self, name) for name, (key, _) in _OPTIONAL.items()}
        return out | {key: _plain(value) for key, value in given.items() if value is not None}


def wrist_from_grip(grip: Transform, side: str) -> Transform:
    """Return the wrist pose of a hand that holds a controller with this grip pose.

    The specification's grip: -z from the little finger to the thumb through the closed fingers, x along the palm's
    normal (out of the left palm, into the right one), so y points from the fingers to the wrist. The wrist frame has
    -z along the fingers and y out of the back of the hand; both follow from an ideal straight grip.
    """
    px, py, pz, x, y, z, w = grip
    # wrist axes in grip axes: z_w = y_g (to the forearm); left: y_w = -x_g, x_w = -z_g; right: y_w = x_g, x_w = z_g
    bx, by, bz, bw = _WRIST_AXES[side]
    quat = (
        w * bx + x * bw + y * bz - z * by,
        w * by - x * bz + y * bw + z * bx,
        w * bz + x * by - y * bx + z * bw,
        w * bw - x * bx - y * by - z * bz,
    )
    norm2 = x * x + y * y + z * z + w * w
    s = GRIP_TO_WRIST_M / norm2 if norm2 > 0 else 0.0
    return (
        px + s * 2 * (x * y - w * z),
        py + s * (w * w - x * x + y * y - z * z),
        pz + s * 2 * (y * z + w * x),
        *quat,
    )


def _plain(value: Any) -> Any:
    """Return lists and dictionaries for tuples and mappings, as JSON has them."""
    if isinstance(value, Mapping):
        return {name: _plain(item) for name, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, (tuple, list)) else value


def _number(value: Any, key: str) -> float | None:
    if value is None:
        return None
    if not _real(value):
        raise PoseError(f'"{key}" of a tracking sample is a number, not {type(value).__name__}')
    try:
        return float(value)
    except OverflowError:
        raise PoseError(f'"{key}" of a tracking sample is too large a number') from None


def _numbers(value: Any, key: str, counts: tuple[int, ...]) -> tuple[float, ...]:
    listed = isinstance(value, Sequence) and not isinstance(value, (str, bytes))
    if not listed or len(value) not in counts:
        raise PoseError(f'"{key}" of a tracking sample needs {" or ".join(map(str, counts))} numbers')
    for v in value:
        if not _real(v):
            raise PoseError(f'"{key}" of a tracking sample needs numbers, found {type(v).__name__}')
    try:
        return tuple([float(v) for v in value])
    except OverflowError:
        raise PoseError(f'"{key}" of a tracking sample holds too large a number') from None


def _real(value: Any) -> bool:
    """Return whether a value is a number; a bool is not."""
    kind = type(value)
    return kind is float or kind is int or (isinstance(value, Real) and not isinstance(value, bool))


def _transform(value: Any, key: str) -> Transform | None:
    return None if value is None else _numbers(value, key, (7,))  # type: ignore[return-value]


def hand_joints(value: Any, key: str) -> tuple[tuple[float, ...], ...] | None:
    """Parse 25 joints of 3 or 7 numbers; None: not tracked. Raises PoseError."""
    if value is None:
        return None
    if not isinstance(value, Sequence) or isinstance(value, (str, bytes)):
        raise PoseError(f'"{key}" of a tracking sample is a list of joints, not {type(value).__name__}')
    return tuple([_numbers(joint, key, (3, 7)) for joint in grouped(value, key)])


def grouped(value: Sequence[Any], key: str) -> Sequence[Any]:
    """Return the 25 joints of a hand from nested or flat numbers, without OpenXR's palm. Contents are not checked.

    Raises PoseError for other counts.
    """
    if value and isinstance(value[0], (int, float)):  # a flat list
        size = {75: 3, 175: 7, 78: 3, 182: 7}.get(len(value))
        if size is None:
            raise PoseError(f'"{key}" of a tracking sample needs 25 joints of 3 or 7 numbers, not {len(value)} numbers')
        value = [value[i : i + size] for i in range(0, len(value), size)]
    if len(value) not in (25, 26):
        raise PoseError(f'"{key}" of a tracking sample needs 25 joints, not {len(value)}')
    return value[len(value) - 25 :]


def _direction(value: Any, key: str) -> tuple[float, ...] | None:
    return None if value is None else _numbers(value, key, (3,))


def _expression(value: Any, key: str = "expression") -> Mapping[str, float] | None:
    """Parse weights by name; null, as a whole or for a name, is not tracked. NaN is left for the tracker to handle."""
    if value is None:
        return None
    if isinstance(value, Mapping):
        pairs = value.items()
        if len(value) > MOST_NAMES:
            raise PoseError(f'"expression" of a tracking sample needs at most {MOST_NAMES} names, not {len(value)}')
    else:
        pairs = zip(ARKIT, _numbers(value, "expression", (len(ARKIT),)), strict=True)  # type: ignore[assignment]
    found = {str(name)[:64]: _number(weight, f"expression.{name!s:.40}") for name, weight in pairs}
    return {name: weight for name, weight in found.items() if weight}  # not a number is true


def _body(value: Any, key: str = "body") -> dict[str, tuple[float, ...]] | None:
    """Parse the joints that are used; null, as a whole or for a joint, is not tracked."""
    if value is None:
        return None
    if not isinstance(value, Mapping):
        raise PoseError(f'"body" of a tracking sample is an object of joints by name, not {type(value).__name__}')
    if len(value) > MOST_JOINTS:
        raise PoseError(f'"body" of a tracking sample needs at most {MOST_JOINTS} joints, not {len(value)}')
    found = {name: value.get(name) for name in BODY_JOINTS}
    return {name: _numbers(joint, f"body.{name}", (3, 7)) for name, joint in found.items() if joint is not None}


_OPTIONAL: dict[str, tuple[str, Callable[[Any, str], Any]]] = {
    **{name: (name, hand_joints) for name in ("left_joints", "right_joints")},
    **{name: (name, _number) for name in ("left_curl", "right_curl")},
    **{name: (name, _transform) for name in TRACKERS},
    "body": ("body", _body),
    "expression": ("expression", _expression),
    "left_eye": ("leftEye", _direction),
    "right_eye": ("rightEye", _direction),
}
"""Fields of a Sample that JSON may leave out: their key and how it is read."""
