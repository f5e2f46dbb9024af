"""Transform splats by the matrix of a scene graph's node: means, shapes and the colour's directions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from glsplat.arrays import F64
from glsplat.errors import FormatError
from glsplat.rotations import matrix_quaternions, quaternion_matrices, quaternion_product, sh_rotations
from glsplat.splats import Splats, normalised


def transformed(splats: Splats, matrix: F64) -> Splats:
    """Transform splats by an affine ``matrix`` [4, 4]: Sigma = M C C^T M^T (KHR_gaussian_splatting).

    A rotation with a uniform scale keeps rotations and scales apart; any other matrix goes through a singular value
    decomposition of each M C. Spherical harmonics of degree 1 and above turn with the nearest orthogonal matrix, so
    colours keep their directions in the node's frame, also of mirrored nodes. Levels of detail are transformed too;
    their density falls with the scale. Raises FormatError when the matrix is singular or
    not finite.
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
            quats = quaternion_product(matrix_quaternions(turn), splats.quats)
            scales, cones = splats.scales * stretch.mean(), splats.cones
        else:
            quats, scales = _reshaped(splats, linear)
            cones = None  # in the old axes
        sh = splats.sh
        if splats.sh_degree:
            sh = np.einsum("kl,nlc->nkc", sh_rotations(turn, splats.sh_degree), sh.astype(np.float64))
        surface = None if splats.surface is None else splats.surface.turned(np.linalg.inv(linear).T.astype(np.float64))
        made = Splats.create(
            means, quats, scales, splats.opacities, sh,
            antialias=splats.antialias, cones=cones, cones_psnr=splats.cones_psnr, surface=surface,
        )  # fmt: skip
    if not splats.levels:
        return made
    size = 1.0 if abs(stretch[0] - 1) < 1e-9 else float(stretch[0])  # a rotation changes no density
    levels = [
        replace(one, content=transformed(one.content, matrix), density=one.density / size) for one in splats.levels
    ]
    return replace(made, levels=tuple(levels))


def _reshaped(splats: Splats, linear: F64) -> tuple[F64, F64]:
    shapes = linear @ (quaternion_matrices(normalised(splats.quats)) * splats.scales[:, None, :].astype(np.float64))
    usable = np.isfinite(np.einsum("nij->n", shapes))
    axes, scales, _ = np.linalg.svd(np.where(usable[:, None, None], shapes, np.eye(3)))
    axes[np.linalg.det(axes) < 0, :, 2] *= -1  # an axis has no sign, a rotation has
    quats = matrix_quaternions(axes)
    # splats that are not finite stay so
    return np.where(usable[:, None], quats, np.nan), np.where(usable[:, None], scales, np.nan)
