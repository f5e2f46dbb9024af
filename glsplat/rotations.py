"""Rotations and directions in float64: quaternions (wxyz), matrices, axis-angle, spherical harmonics, axis flips.

tracking/solve/quat.py has scalar quaternions for a single tracked body.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "FLIP_X",
    "FLIP_YZ",
    "FLIP_Z",
    "SH_FACTORS",
    "component_sums",
    "is_rigid",
    "lengths",
    "matrix_quaternions",
    "nearest_rotations",
    "quaternion_matrices",
    "quaternion_of",
    "quaternion_product",
    "quaternion_vectors",
    "rodrigues_parameters",
    "rotation_between",
    "rotation_matrices",
    "sh_basis",
    "sh_rotations",
    "signed_axes",
    "slerp",
    "turn_between",
    "unit_vectors",
    "vector_quaternions",
]

F64 = NDArray[np.float64]

FLIP_X = np.diag([-1.0, 1.0, 1.0, 1.0])
"""Mirror x; with FLIP_Z, from Unity's left-handed frames (docs/conventions.md)."""

FLIP_YZ = np.diag([1.0, -1.0, -1.0, 1.0])
"""Half a turn about x: camera axes of OpenGL and OpenXR to those of OpenCV, and back."""

FLIP_Z = np.diag([1.0, 1.0, -1.0, 1.0])
"""Mirror z."""

SH_FACTORS = np.array(
    [
        0.28209479177387814,
        *(-0.4886025119029199, 0.4886025119029199, -0.4886025119029199),
        *(1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396),
        *(-0.5900435899266435, 2.890611442640554, -0.4570457994644658, 0.3731763325901154),
        *(-0.4570457994644658, 1.445305721320277, -0.5900435899266435),
    ]
)
"""Factors [16] of the polynomials of spherical harmonics (``sh_basis``), with the signs of 3DGS (sh.glsl)."""

_DIRECTIONS = 64


def unit_vectors(vectors: ArrayLike, least: float = 1e-12) -> F64:
    """Return vectors [..., N] divided by their length, or by ``least`` if they are shorter: zero stays zero."""
    v = np.asarray(vectors, np.float64)
    return np.asarray(v / np.maximum(lengths(v)[..., None], least))


def component_sums(values: NDArray[Any]) -> NDArray[Any]:
    """Return ``values.sum(axis=-1)`` of [..., N] floats, bit-identical and much faster for N = 3."""
    if values.shape[-1] != 3:
        return np.asarray(values.sum(axis=-1))
    return np.asarray(values[..., 0] + values[..., 1] + values[..., 2])


def lengths(vectors: NDArray[Any]) -> NDArray[Any]:
    """Return ``np.linalg.norm(vectors, axis=-1)``, bit-identical and faster."""
    return np.asarray(np.sqrt(component_sums(vectors * vectors)))


def quaternion_matrices(quats: NDArray[np.floating]) -> F64:
    """Return the matrices [..., 3, 3] of unit quaternions wxyz [..., 4] (covariance.glsl)."""
    w, x, y, z = np.moveaxis(np.asarray(quats, np.float64), -1, 0)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, -1) for row in rows], -2)


def signed_axes(quats: NDArray[np.floating], scales: NDArray[np.floating]) -> F64:
    """Return the renderer's principal axes of splats, the columns of [N, 3, 3]: a negative scale flips its axis.

    ``quats`` [N, 4] wxyz, unit. An axis of scale zero has the sign of the product of the other two.
    """
    signs = np.where(scales < 0, -1.0, 1.0)
    others = np.stack([signs[:, 1] * signs[:, 2], signs[:, 2] * signs[:, 0], signs[:, 0] * signs[:, 1]], axis=1)
    return quaternion_matrices(quats) * np.where(scales == 0, others, signs)[:, None, :]


def matrix_quaternions(matrices: F64) -> F64:
    """Return unit quaternions wxyz [..., 4] of rotations [..., 3, 3].

    Takes the row of 4 q q^T with the largest diagonal, which avoids cancellation.
    """
    m = np.asarray(matrices, np.float64)
    diagonal = m[..., [0, 1, 2], [0, 1, 2]]
    trace = diagonal.sum(-1)
    # 4 w^2, 4 x^2, 4 y^2, 4 z^2
    squares = np.stack([1 + trace, *(1 - trace + 2 * diagonal[..., i] for i in range(3))], -1)
    wx, wy, wz = m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]
    xy, xz, yz = m[..., 1, 0] + m[..., 0, 1], m[..., 2, 0] + m[..., 0, 2], m[..., 2, 1] + m[..., 1, 2]
    rows = np.stack(
        [
            np.stack([squares[..., 0], wx, wy, wz], -1),
            np.stack([wx, squares[..., 1], xy, xz], -1),
            np.stack([wy, xy, squares[..., 2], yz], -1),
            np.stack([wz, xz, yz, squares[..., 3]], -1),
        ],
        -2,
    )
    best = squares.argmax(-1)
    quats: F64 = np.take_along_axis(rows, best[..., None, None], -2)[..., 0, :]
    return quats / np.linalg.norm(quats, axis=-1, keepdims=True)


def quaternion_of(rotation: F64) -> F64:
    """Return the quaternion wxyz [4], w >= 0, of a rotation matrix [3, 3]."""
    quat = matrix_quaternions(rotation)
    return -quat if quat[0] < 0 else quat


def quaternion_product(p: NDArray[np.floating], q: NDArray[np.floating]) -> F64:
    """Return the Hamilton product p q (first q, then p) of wxyz [..., 4]; a zero quaternion stays zero."""
    pw, px, py, pz = np.moveaxis(np.asarray(p, np.float64), -1, 0)
    qw, qx, qy, qz = np.moveaxis(np.asarray(q, np.float64), -1, 0)
    return np.stack(
        [
            pw * qw - px * qx - py * qy - pz * qz,
            pw * qx + px * qw + py * qz - pz * qy,
            pw * qy - px * qz + py * qw + pz * qx,
            pw * qz + px * qy - py * qx + pz * qw,
        ],
        -1,
    )


def rotation_matrices(axis_angle: ArrayLike) -> NDArray[np.float64]:
    """Return the matrices [..., 3, 3] of axis-angle [..., 3], radians: Rodrigues, exact at zero and always finite."""
    v = np.asarray(axis_angle, np.float64)
    angle2 = np.einsum("...i,...i->...", v, v)
    angle = np.sqrt(angle2)
    # sin(a)/a and (1 - cos a)/a^2 through sinc: no division by zero and no cancellation at small angles
    a = np.sinc(angle / np.pi)
    b = 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    out = np.empty((*v.shape[:-1], 3, 3))
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    bx, by, bz = b * x, b * y, b * z
    ax, ay, az = a * x, a * y, a * z
    cos = 1 - b * angle2
    out[..., 0, 0] = cos + bx * x
    out[..., 1, 1] = cos + by * y
    out[..., 2, 2] = cos + bz * z
    out[..., 0, 1] = bx * y - az
    out[..., 1, 0] = bx * y + az
    out[..., 0, 2] = bx * z + ay
    out[..., 2, 0] = bx * z - ay
    out[..., 1, 2] = by * z - ax
    out[..., 2, 1] = by * z + ax
    return out


def rotation_between(first: ArrayLike, second: ArrayLike) -> F64:
    """Return the smallest rotation [3, 3] from one direction [3] to another; opposite ones: any axis."""
    a, b = (np.asarray(v, np.float64) for v in (first, second))
    a, b = (v / max(float(np.linalg.norm(v)), 1e-12) for v in (a, b))
    axis, cos = np.cross(a, b), float(a @ b)
    sin = float(np.linalg.norm(axis))
    if sin < 1e-9:
        if cos > -0.5 or not np.isfinite(cos):  # parallel, or no direction
            return np.eye(3)
        axis = np.cross(a, np.eye(3)[np.abs(a).argmin()])
        return rotation_matrices(axis / np.linalg.norm(axis) * np.pi)
    return rotation_matrices(axis / sin * np.arctan2(sin, cos))


def vector_quaternions(vectors: ArrayLike) -> F64:
    """Return unit quaternions wxyz [..., 4] of axis-angle [..., 3], radians; w may be negative beyond half a turn."""
    v = np.asarray(vectors, np.float64)
    angle = np.linalg.norm(v, axis=-1, keepdims=True)
    return np.concatenate([np.cos(angle / 2), v * 0.5 * np.sinc(angle / (2 * np.pi))], -1)


def quaternion_vectors(quats: F64) -> F64:
    """Return axis-angle [..., 3], at most pi long, of unit quaternions wxyz [..., 4]."""
    q = np.where(quats[..., :1] < 0, -quats, quats)
    s = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(s, q[..., :1])
    return q[..., 1:] * np.where(s > 1e-12, angle / np.maximum(s, 1e-12), 2.0)


def slerp(first: F64, second: F64, part: ArrayLike) -> F64:
    """Return axis-angle [..., 3] interpolated the short way at ``part`` (broadcast over ...); above 1 extrapolates."""
    turn = turn_between(first, second) * np.asarray(part)[..., None]
    return quaternion_vectors(quaternion_product(vector_quaternions(first), vector_quaternions(turn)))


def turn_between(first: F64, second: F64) -> F64:
    """Return the shortest rotation from ``first`` to ``second``, axis-angle [..., 3] in the frame of the first."""
    back = vector_quaternions(first) * (1, -1, -1, -1)
    return quaternion_vectors(quaternion_product(back, vector_quaternions(second)))


def nearest_rotations(matrices: F64) -> F64:
    """Return the nearest rotation (polar factor) of each [N, 3, 3]; it jumps where two are equally near.

    ``reference.blended_rotations`` is continuous there.
    """
    u, _, vt = np.linalg.svd(matrices)
    u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
    return np.asarray(u @ vt, np.float64)


def rodrigues_parameters(rotation: F64) -> F64:
    """Return the modified Rodrigues parameters [3] of a rotation [3, 3]: tan(angle / 4) axis, at most 1 long."""
    quat = quaternion_of(rotation)
    return quat[1:] / (1 + quat[0])


def is_rigid(bones: F64) -> bool:
    """Return whether every bone's 3x3 of [J, 3, 4] is a rotation within 1e-4."""
    gram = np.einsum("jki,jkl->jil", bones[:, :, :3], bones[:, :, :3])
    return bool(np.abs(gram - np.eye(3)).max() < 1e-4 and (np.linalg.det(bones[:, :, :3]) > 0).all())


def sh_basis(directions: F64, degree: int) -> F64:
    """Return real spherical harmonics [N, K] of unit directions [N, 3], constants and signs of 3DGS (sh.glsl)."""
    x, y, z = directions.T
    basis = [np.ones_like(x)]
    if degree > 0:
        basis += [y, z, x]
    if degree > 1:
        basis += [x * y, y * z, 2 * z * z - x * x - y * y, x * z, x * x - y * y]
    if degree > 2:
        basis += [
            y * (3 * x * x - y * y),
            x * y * z,
            y * (4 * z * z - x * x - y * y),
            z * (2 * z * z - 3 * x * x - 3 * y * y),
            x * (4 * z * z - x * x - y * y),
            z * (x * x - y * y),
            x * (x * x - 3 * y * y),
        ]
    return np.asarray(np.stack(basis, axis=-1) * SH_FACTORS[: len(basis)])


def sh_rotations(turns: F64, degree: int) -> F64:
    """Return D [..., K, K] with basis(d) . (D c) = basis(turn^T d) . c for all d; ``turns`` [..., 3, 3] or mirrors.

    Rotations and mirrors map the space of each degree to itself, so a fit over random directions is exact up to
    rounding.
    """
    directions = np.random.default_rng(0).normal(size=(_DIRECTIONS, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    seen = directions @ turns
    basis = sh_basis(seen.reshape(-1, 3), degree).reshape(*seen.shape[:-1], -1)
    return np.asarray(np.linalg.pinv(sh_basis(directions, degree)) @ basis, np.float64)
