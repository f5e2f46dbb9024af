"""What the matrix of a scene graph's node does to splats: means, shapes and the colour's directions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError
from glsplat.splats import Splats, normalised

__all__ = ["transformed"]

F64 = NDArray[np.float64]


def transformed(splats: Splats, matrix: F64) -> Splats:
    """``splats`` under an affine ``matrix`` [4, 4]: Sigma = M C C^T M^T (KHR_gaussian_splatting, Splat Reconstruction).

    A rotation with a uniform scale keeps rotations and scales apart; any other matrix goes through a singular value
    decomposition of each M C. Spherical harmonics of degree 1 and above turn with the nearest orthogonal matrix, so
    a splat shows each of its colours in the direction it had in the node's frame, mirrored nodes included. Raises
    FormatError when the matrix is singular or not finite.
    """
    linear = matrix[:3, :3]
    left, stretch, right = np.linalg.svd(linear) if np.isfinite(matrix).all() else (linear, np.zeros(3), linear)
    if not stretch[2] > 1e-12 * stretch[0]:
        raise FormatError("a node with splats needs a finite transform that can be inverted (a zero scale?)")
    if np.array_equal(matrix, np.eye(4)):
        return splats
    with np.errstate(all="ignore"):
        means = splats.means @ linear.T + matrix[:3, 3]
        turn: F64 = left @ right
        if np.linalg.det(turn) > 0 and stretch[0] - stretch[2] < 1e-6 * stretch[0]:
            quats = _product(_quaternion(turn), splats.quats.astype(np.float64))
            scales, cones = splats.scales * stretch.mean(), splats.cones
        else:
            quats, scales = _reshaped(splats, linear)
            cones = None  # said in the old axes
        sh = splats.sh
        if splats.sh_degree:
            sh = np.einsum("kl,nlc->nkc", _sh_rotation(turn, splats.sh_degree), sh.astype(np.float64))
        return Splats.create(means, quats, scales, splats.opacities, sh, antialias=splats.antialias, cones=cones)


def _reshaped(splats: Splats, linear: F64) -> tuple[F64, F64]:
    shapes = linear @ (_matrices(splats.quats.astype(np.float64)) * splats.scales[:, None, :].astype(np.float64))
    usable = np.isfinite(np.einsum("nij->n", shapes))
    axes, scales, _ = np.linalg.svd(np.where(usable[:, None, None], shapes, np.eye(3)))
    axes[np.linalg.det(axes) < 0, :, 2] *= -1  # an axis has no sign, a rotation has
    quats = _quaternions(axes)
    # what is not finite stays recognisable as such
    return np.where(usable[:, None], quats, np.nan), np.where(usable[:, None], scales, np.nan)


def _matrices(quats: F64) -> F64:
    """[N, 4] wxyz to [N, 3, 3]; a zero quaternion gives the identity, as in the renderer."""
    w, x, y, z = normalised(quats.astype(np.float32)).T.astype(np.float64)
    return np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], axis=-1),
            np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], axis=-1),
            np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=-1),
        ],
        axis=-2,
    )


def _quaternions(r: F64) -> F64:
    """[N, 3, 3] rotations to [N, 4] wxyz: the row of 4 q q^T with the largest diagonal, so nothing cancels."""
    m00, m11, m22 = r[:, 0, 0], r[:, 1, 1], r[:, 2, 2]
    x, y, z = r[:, 2, 1] - r[:, 1, 2], r[:, 0, 2] - r[:, 2, 0], r[:, 1, 0] - r[:, 0, 1]
    xy, xz, yz = r[:, 0, 1] + r[:, 1, 0], r[:, 0, 2] + r[:, 2, 0], r[:, 1, 2] + r[:, 2, 1]
    outer = np.stack(
        [
            np.stack([1 + m00 + m11 + m22, x, y, z], axis=-1),
            np.stack([x, 1 + m00 - m11 - m22, xy, xz], axis=-1),
            np.stack([y, xy, 1 - m00 + m11 - m22, yz], axis=-1),
            np.stack([z, xz, yz, 1 - m00 - m11 + m22], axis=-1),
        ],
        axis=-2,
    )
    best = np.argmax(np.diagonal(outer, axis1=1, axis2=2), axis=1)
    rows = outer[np.arange(len(r)), best]
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


def _quaternion(rotation: F64) -> F64:
    return _quaternions(rotation[None])[0]


def _product(p: F64, q: F64) -> F64:
    """Hamilton product p q of one wxyz quaternion with [N, 4]; a zero quaternion stays zero."""
    w, x, y, z = p
    left = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    return q @ left.T


def _sh_rotation(turn: F64, degree: int) -> F64:
    """[K, K] D with basis(d) . (D c) = basis(turn^T d) . c for every direction d, by least squares over directions.

    Each degree spans a space that rotations and mirrors map to itself, so the fit is exact up to rounding.
    """
    directions = np.random.default_rng(0).normal(size=(64, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return np.linalg.lstsq(_basis(directions, degree), _basis(directions @ turn, degree), rcond=None)[0].astype(
        np.float64
    )


def _basis(d: F64, degree: int) -> F64:
    """[N, K] real spherical harmonics of unit directions with the constants and signs of 3DGS."""
    x, y, z = d.T
    xx, yy, zz = x * x, y * y, z * z
    columns = [np.full_like(x, 0.28209479177387814)]
    columns += [c * 0.4886025119029199 for c in (-y, z, -x)]
    columns += [1.0925484305920792 * x * y, -1.0925484305920792 * y * z, 0.31539156525252005 * (2 * zz - xx - yy)]
    columns += [-1.0925484305920792 * x * z, 0.5462742152960396 * (xx - yy)]
    columns += [-0.5900435899266435 * y * (3 * xx - yy), 2.890611442640554 * x * y * z]
    columns += [-0.4570457994644658 * y * (4 * zz - xx - yy), 0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy)]
    columns += [-0.4570457994644658 * x * (4 * zz - xx - yy), 1.445305721320277 * z * (xx - yy)]
    columns += [-0.5900435899266435 * x * (xx - 3 * yy)]
    return np.stack(columns[: (degree + 1) ** 2], axis=-1)
