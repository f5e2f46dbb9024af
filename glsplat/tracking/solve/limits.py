"""Joint limits: published ranges of motion, written for the axes of the SMPL-X zero pose (T-pose, palms down).

Sources, degrees from the anatomical position:

* AAOS: American Academy of Orthopaedic Surgeons, Joint Motion: Method of Measuring and Recording (1965); Greene &
  Heckman, The Clinical Measurement of Joint Motion (1994): shoulder flexion 180, extension 60, abduction 180, internal
  and external rotation 70 and 90, horizontal adduction 135; elbow 0-150, pronation and supination 80; wrist flexion 80,
  extension 70, radial 20, ulnar 30; hip flexion 120, extension 30, abduction 45, adduction 30, rotation 45; knee 0-135;
  ankle plantar flexion 50, dorsiflexion 20; neck flexion, extension and side 45, rotation 60; trunk flexion 80,
  extension 25, side 35, rotation 45; finger MCP 90 (extension 45), PIP 100, DIP 90; thumb MCP 50, IP 80.
* CDC: Soucie et al., Range of motion measurements: reference values and a database for comparison studies, Haemophilia
  17 (2011), the CDC's normal joint range of motion study (674 people): elbow flexion 144-150, hip flexion 130-134, knee
  flexion 138-142, shoulder flexion 168-172, ankle dorsiflexion 13, plantar flexion 55-62 (adults, means).
* Weight-bearing dorsiflexion (knee-to-wall lunge) is 38-45: Bennell et al., Aust. J. Physiother. 44 (1998).

Where two tables differ the wider one is taken, and a few degrees are added to measured means, since a limit must not
stop an able user. A joint of SMPL-X that shares an anatomical motion with others gets its share (spine: a third each).
"""

from __future__ import annotations

from math import atan2, cos, degrees, hypot, pi, radians, sin

import numpy as np
from numpy.typing import NDArray

from glsplat.tracking.solve import body
from glsplat.tracking.solve.quat import Quat, clamp, conj, mul, rotation_vector, to_quat

Box = tuple[float, float, float, float, float, float]


def _box(x: tuple[float, float], y: tuple[float, float], z: tuple[float, float]) -> Box:
    low_high = [radians(v) for v in (x[0], y[0], z[0], x[1], y[1], z[1])]
    return (low_high[0], low_high[1], low_high[2], low_high[3], low_high[4], low_high[5])


def _mirror(box: Box) -> Box:
    """Return the right side of a left box: turns about y and z change sign."""
    return (box[0], -box[4], -box[5], box[3], -box[1], -box[2])


_SPINE = _box((-12, 31), (-18, 18), (-15, 15))  # trunk 25-36 / 80-93 / 45-54 / 35-45, a third each
_NECK = _box((-32, 32), (-32, 32), (-24, 24))  # neck with skull: 60 / 60 / 66 / 45; the neck's share is 45 %
_HEAD = _box((-36, 36), (-38, 38), (-28, 28))
_COLLAR = _box((-15, 15), (-28, 20), (-8, 36))  # clavicle: protraction 26, retraction 18, elevation 35 (Ludewig 2009)
_ELBOW = _box((-90, 90), (-152, 8), (-14, 14))  # flexion about -y; pronation and supination about x
_WRIST = _box((-90, 90), (-32, 40), (-86, 78))  # rest of the pronation; radial and ulnar about y; flexion about -z
_HIP = _box((-134, 34), (-50, 50), (-38, 60))  # flexion about -x, abduction about +z; rotation about the thigh
_KNEE = _box((-6, 148), (-15, 15), (-12, 12))
_ANKLE = _box((-42, 64), (-30, 30), (-36, 36))  # dorsiflexion about -x

BOXES: dict[int, Box] = {
    **{joint: _SPINE for joint in (body.SPINE1, body.SPINE2, body.SPINE3)},
    body.NECK: _NECK,
    body.HEAD: _HEAD,
    **{
        pair[i]: box if i == 0 else _mirror(box)
        for pair, box in (
            (body.COLLARS, _COLLAR),
            (body.ELBOWS, _ELBOW),
            (body.WRISTS, _WRIST),
            (body.HIPS, _HIP),
            (body.KNEES, _KNEE),
            (body.ANKLES, _ANKLE),
        )
        for i in (0, 1)
    },
}
"""Bounds of the rotation vector (x, y, z lows, then highs; radians). Hips, elbows, wrists: of swing, and twist along
the bone (see ``TWIST``)."""

TWIST = {**{j: 1 for j in body.HIPS}, **{j: 0 for j in (*body.ELBOWS, *body.WRISTS)}}
"""Axis (0 x, 1 y) along the bone of the joints whose rotation is taken apart into swing and twist."""

# shoulder, left: how far the arm may swing from the T-pose, by the direction of the swing: 0 forward, 90 up, 180 back,
# 270 down. Forward: horizontal adduction 135; up: abduction and flexion 180; back: horizontal extension 50; between
# back and down: extension 60 of a hanging arm; down: adduction 20 across the body
_SHOULDER = tuple([radians(v) for v in (135, 132, 114, 100, 82, 64, 52, 92, 100, 112, 124, 132, 135)])  # each 30
_SHOULDER_TWIST = (radians(-105), radians(105))  # external, internal: 90 and 70, wider for the T-pose's reference

MARGIN = radians(2)  # outside a hip's box up to which its coordinates are clamped one by one
_FLEXED = radians(-67)  # the middle of what a solver may ask of a hip: from 40 behind to 180 and more in front
_MIDDLE = to_quat((_FLEXED, 0.0, 0.0))
_FROM_MIDDLE = conj(_MIDDLE)
_MIDDLE_COS, _MIDDLE_SIN = cos(_FLEXED), sin(_FLEXED)
_WIDEST_TWIST = radians(110)  # about the thigh, from the middle; the box has none wider

FINGER_LOW = np.radians([[-25.0, -30.0, -100.0], [-25.0, -25.0, -110.0], [-25.0, -25.0, -95.0]])
FINGER_HIGH = np.radians([[25.0, 30.0, 48.0], [25.0, 25.0, 12.0], [25.0, 25.0, 18.0]])
"""[3, 3] left fingers, joints 1 to 3: flexion about -z, spreading about y; 25 for bones that do not lie along x at
rest. Thumbs have ``THUMB_LIMIT``."""

THUMB_LIMIT = radians(75)  # either way, about any axis

_SMALLEST = {joint: min(abs(v) for v in box) for joint, box in BOXES.items()}
_SAFE = {joint: cos(0.5 * value) for joint, value in _SMALLEST.items()}


def clamp_box(q: Quat, box: tuple[float, ...]) -> Quat:
    """Return q with its rotation vector limited to the box."""
    x, y, z = rotation_vector(q)
    kx, ky, kz = clamp(x, box[0], box[3]), clamp(y, box[1], box[4]), clamp(z, box[2], box[5])
    return q if (kx, ky, kz) == (x, y, z) else to_quat((kx, ky, kz))


def clamp_joint(joint: int, q: Quat) -> Quat:
    """Return the rotation of a body joint limited to its range; the same object where it is inside."""
    if joint in body.SHOULDERS:
        return _shoulder(q, 1.0 if joint == body.SHOULDERS[0] else -1.0)
    safe = _SAFE.get(joint)
    if safe is None or abs(q[0]) >= safe:
        return q
    box = BOXES[joint]
    axis = TWIST.get(joint)
    if axis == 1:
        q = _nearby(q, box)
    if axis is None:
        return clamp_box(q, box)
    swing, twist = _swing_twist(q, axis)
    sx, sy, sz = rotation_vector(swing)
    if axis == 0:
        k = (0.0, clamp(sy, box[1], box[4]), clamp(sz, box[2], box[5]))
    else:
        k = (clamp(sx, box[0], box[3]), 0.0, clamp(sz, box[2], box[5]))
    angle = clamp(twist, box[axis], box[axis + 3])
    if angle == twist and abs(k[0] - sx) + abs(k[1] - sy) + abs(k[2] - sz) < 1e-9:
        return q
    return mul(to_quat(k), to_quat((angle, 0.0, 0.0) if axis == 0 else (0.0, angle, 0.0)))


def _nearby(q: Quat, box: Box) -> Quat:
    """Bring a thigh far outside its range to where its swing from the rest pose is at most MARGIN outside.

    Swing and twist from the rest pose say little of a thigh that points up: there, a degree more or less would put the
    knee on one side or the other. So it goes the way to the range's middle, whose opposite is behind the back, where no
    thigh gets.
    """
    swing, twist = _swing_twist(mul(_FROM_MIDDLE, q), 1)
    vx, _, vz = rotation_vector(swing)
    size = hypot(vx, vz)
    if abs(twist) <= _WIDEST_TWIST and (size < 1e-9 or _outside(vx / size, vz / size, size, box) <= MARGIN):
        return q
    ax, az = (vx / size, vz / size) if size > 1e-9 else (1.0, 0.0)
    if _outside(ax, az, size, box) > MARGIN:
        low, high = 0.0, size
        for _ in range(16):
            half = 0.5 * (low + high)
            low, high = (low, half) if _outside(ax, az, half, box) > MARGIN else (half, high)
        size = low
    near = mul(_MIDDLE, to_quat((ax * size, 0.0, az * size)))
    return mul(near, to_quat((0.0, clamp(twist, -_WIDEST_TWIST, _WIDEST_TWIST), 0.0)))


def _outside(ax: float, az: float, size: float, box: Box) -> float:
    """Return the radians by which a thigh swung by ``size`` from the middle is outside the box of swings from rest."""
    s = sin(size)
    x, y, z = az * s, -cos(size), -ax * s  # where the thigh points: (ax, 0, az) x (0, -1, 0) is (az, 0, -ax)
    c, s = _MIDDLE_COS, _MIDDLE_SIN
    y, z = y * c - z * s, y * s + z * c
    across = hypot(x, z)
    k = atan2(across, -y) / across if across > 1e-9 else 0.0
    sx, sz = -z * k, x * k
    return max(box[0] - sx, sx - box[3], box[2] - sz, sz - box[5])


def _swing_twist(q: Quat, axis: int) -> tuple[Quat, float]:
    w, v = q[0], q[1 + axis]
    n = hypot(w, v)
    if n < 1e-9:  # a half turn of the bone: no twist to tell
        return q, 0.0
    if w < 0:
        w, v = -w, -v
    twist = (w / n, v / n, 0.0, 0.0) if axis == 0 else (w / n, 0.0, v / n, 0.0)
    return mul(q, conj(twist)), 2 * atan2(v, w)


def _shoulder(q: Quat, sign: float) -> Quat:
    swing, twist = _swing_twist(q, 0)
    _, y, z = rotation_vector(swing)
    size = hypot(y, z)
    low, high = _SHOULDER_TWIST
    angle = clamp(twist, low, high)
    most = shoulder_reach(y * sign, z * sign)
    if size <= most and angle == twist:
        return q
    k = most / size if size > most else 1.0
    return mul(to_quat((0.0, y * k, z * k)), to_quat((angle, 0.0, 0.0)))


def shoulder_reach(y: float, z: float) -> float:
    """Return the radians that a left arm may swing in the direction of the rotation vector (0, y, z)."""
    place = (atan2(z, -y) % (2 * pi)) / (pi / 6)
    i = min(int(place), 11)
    return _SHOULDER[i] + (_SHOULDER[i + 1] - _SHOULDER[i]) * (place - i)


def violation(rotations: NDArray[np.float64]) -> float:
    """Return the degrees by which the worst body joint of an axis-angle pose [55 or 22, 3] is outside its limits."""
    worst = 0.0
    for joint in range(1, 22):
        q = to_quat((float(rotations[joint, 0]), float(rotations[joint, 1]), float(rotations[joint, 2])))
        inside = clamp_joint(joint, q)
        dot = abs(sum(a * b for a, b in zip(q, inside, strict=True)))
        worst = max(worst, 2 * atan2(max(0.0, 1 - dot * dot) ** 0.5, dot))
    return degrees(worst)
