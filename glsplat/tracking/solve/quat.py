"""Quaternions (w, x, y, z) and vectors as plain tuples of floats: a numpy call on so few numbers costs far more.

All rotations are active and right-handed; ``mul(a, b)`` rotates by b first, then by a.
"""

from __future__ import annotations

from math import acos, atan2, copysign, cos, hypot, pi, sin, sqrt

Vec = tuple[float, float, float]
Quat = tuple[float, float, float, float]
JointPose = tuple[Vec, Quat]
"""Position in metres and rotation of a joint or a tracker, both in one space."""

IDENTITY: Quat = (1.0, 0.0, 0.0, 0.0)
TINY = 1e-12  # lengths below this have no direction


def add(a: Vec, b: Vec) -> Vec:
    """Return a + b."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def sub(a: Vec, b: Vec) -> Vec:
    """Return a - b."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def scale(a: Vec, s: float) -> Vec:
    """Return a scaled by s."""
    return (a[0] * s, a[1] * s, a[2] * s)


def dot(a: Vec, b: Vec) -> float:
    """Return the dot product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vec, b: Vec) -> Vec:
    """Return the cross product a x b."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def length(a: Vec) -> float:
    """Return the Euclidean length."""
    return sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


def distance(a: Vec, b: Vec) -> float:
    """Return |a - b|."""
    return sqrt((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2)


def unit(a: Vec, fallback: Vec = (0.0, 1.0, 0.0)) -> Vec:
    """Return a / |a|, or ``fallback`` where a has no direction."""
    n = sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])
    if n < TINY:
        return fallback
    n = 1.0 / n
    return (a[0] * n, a[1] * n, a[2] * n)


def clamp(value: float, low: float, high: float) -> float:
    """Limit the value to low ... high."""
    return low if value < low else high if value > high else value


def smoothstep(t: float) -> float:
    """Ease t in [0, 1]: the slope is 0 at both ends."""
    return t * t * (3 - 2 * t)


def wrap(angle: float) -> float:
    """Return the same angle in [-pi, pi)."""
    return (angle + pi) % (2 * pi) - pi


def normalized(q: Quat) -> Quat:
    """Return q / |q|, or the identity where q has no length."""
    n = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    if n < TINY:
        return IDENTITY
    n = 1.0 / n
    return (q[0] * n, q[1] * n, q[2] * n, q[3] * n)


def conj(q: Quat) -> Quat:
    """Return the inverse of a unit quaternion."""
    return (q[0], -q[1], -q[2], -q[3])


def mul(a: Quat, b: Quat) -> Quat:
    """Return a b: the rotation by b, then by a."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def inverse_mul(a: Quat, b: Quat) -> Quat:
    """Return conj(a) b: rotation b in the frame of a."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw + ax * bx + ay * by + az * bz,
        aw * bx - ax * bw - ay * bz + az * by,
        aw * by + ax * bz - ay * bw - az * bx,
        aw * bz - ax * by + ay * bx - az * bw,
    )


def rotate(q: Quat, v: Vec) -> Vec:
    """Rotate v by q."""
    w, x, y, z = q
    vx, vy, vz = v
    tx, ty, tz = 2 * (y * vz - z * vy), 2 * (z * vx - x * vz), 2 * (x * vy - y * vx)
    return (vx + w * tx + y * tz - z * ty, vy + w * ty + z * tx - x * tz, vz + w * tz + x * ty - y * tx)


def compose(frame: JointPose, local: JointPose) -> JointPose:
    """Return the pose in the world of a pose that is ``local`` in ``frame``."""
    return add(frame[0], rotate(frame[1], local[0])), mul(frame[1], local[1])


def relative(frame: JointPose, pose: JointPose) -> JointPose:
    """Return a pose of the world in ``frame``: the inverse of ``compose``."""
    return rotate(conj(frame[1]), sub(pose[0], frame[0])), inverse_mul(frame[1], pose[1])


def about(axis: Vec, angle: float) -> Quat:
    """Return the rotation by ``angle`` (radians) about a unit axis."""
    s = sin(0.5 * angle)
    return (cos(0.5 * angle), axis[0] * s, axis[1] * s, axis[2] * s)


def yaw_quat(angle: float) -> Quat:
    """Return the rotation by ``angle`` (radians) about y (up)."""
    return (cos(0.5 * angle), 0.0, sin(0.5 * angle), 0.0)


def to_quat(v: Vec) -> Quat:
    """Convert a rotation vector (axis times angle) to a quaternion."""
    angle = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    s = sin(0.5 * angle) / angle if angle > 1e-9 else 0.5
    return (cos(0.5 * angle), v[0] * s, v[1] * s, v[2] * s)


def rotation_vector(q: Quat) -> Vec:
    """Convert a quaternion to a rotation vector of at most pi."""
    w, x, y, z = q
    if w < 0:
        w, x, y, z = -w, -x, -y, -z
    s = sqrt(x * x + y * y + z * z)
    k = 2 * atan2(s, w) / s if s > 1e-9 else 2.0
    return (x * k, y * k, z * k)


def rotation_angle(q: Quat) -> float:
    """Return the angle of the rotation, 0 to pi."""
    return 2 * atan2(sqrt(q[1] * q[1] + q[2] * q[2] + q[3] * q[3]), abs(q[0]))


def power(q: Quat, t: float) -> Quat:
    """Return the rotation about the same axis by t times the angle, the short way round."""
    return to_quat(scale(rotation_vector(q), t))


def nlerp(a: Quat, b: Quat, t: float) -> Quat:
    """Interpolate from a (t = 0) to b (t = 1) linearly, the short way round, and normalise."""
    u = 1 - t
    if a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3] < 0:
        t = -t
    return normalized((u * a[0] + t * b[0], u * a[1] + t * b[1], u * a[2] + t * b[2], u * a[3] + t * b[3]))


def slerp(a: Quat, b: Quat, t: float) -> Quat:
    """Interpolate from a to b the short way round, at constant angular speed."""
    d = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]
    sign = copysign(1.0, d)
    d = abs(d)
    if d > 0.9995:
        return nlerp(a, b, t)
    angle = acos(d)
    k = 1.0 / sin(angle)
    u, t = sin((1 - t) * angle) * k, sin(t * angle) * k * sign
    return (u * a[0] + t * b[0], u * a[1] + t * b[1], u * a[2] + t * b[2], u * a[3] + t * b[3])


def between(a: Vec, b: Vec) -> Quat:
    """Return the shortest rotation from unit vector a to b; opposite vectors: about some perpendicular axis."""
    w = 1 + a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    if w < 1e-9:
        axis = unit(cross(a, (1.0, 0.0, 0.0) if abs(a[0]) < 0.7 else (0.0, 0.0, 1.0)))
        return (0.0, *axis)
    return normalized((w, *cross(a, b)))


def swing_twist_y(q: Quat) -> float | None:
    """Return the heading of q: the angle of its twist about y. None where q turns y upside down."""
    if hypot(q[0], q[2]) < 0.17:  # the vertical axis tilted by more than 160 degrees
        return None
    return wrap(2 * atan2(q[2], q[0]))


def from_axes(x: Vec, y: Vec, z: Vec) -> Quat:
    """Return the rotation whose matrix has these orthonormal columns."""
    trace = x[0] + y[1] + z[2]
    if trace > 0:
        s = 2 * sqrt(trace + 1)
        return (0.25 * s, (y[2] - z[1]) / s, (z[0] - x[2]) / s, (x[1] - y[0]) / s)
    if x[0] > y[1] and x[0] > z[2]:
        s = 2 * sqrt(max(1 + x[0] - y[1] - z[2], TINY))
        return ((y[2] - z[1]) / s, 0.25 * s, (y[0] + x[1]) / s, (z[0] + x[2]) / s)
    if y[1] > z[2]:
        s = 2 * sqrt(max(1 + y[1] - x[0] - z[2], TINY))
        return ((z[0] - x[2]) / s, (y[0] + x[1]) / s, 0.25 * s, (z[1] + y[2]) / s)
    s = 2 * sqrt(max(1 + z[2] - x[0] - y[1], TINY))
    return ((x[1] - y[0]) / s, (z[0] + x[2]) / s, (z[1] + y[2]) / s, 0.25 * s)


def pull(a: Vec, b: Vec, t: float) -> Vec:
    """Move a by the fraction t of the way to b."""
    return (a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t, a[2] + (b[2] - a[2]) * t)
