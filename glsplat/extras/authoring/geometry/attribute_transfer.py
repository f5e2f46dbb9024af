"""Transfer shapes and surfaces to other splats: to merged splats, and to splats that a fit has moved."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from glsplat.arrays import F64
from glsplat.light.surface import Surface
from glsplat.rotations import quaternion_matrices, unit_vectors
from glsplat.skinning.shapes import BEND, Shapes, long_axes
from glsplat.splats import Splats

_MAX_SOURCES = 4  # finer splats averaged into a coarser one's surface


def merged_shapes(shapes: Shapes, splats: Splats, label: NDArray[np.intp], weight: F64, made: Splats) -> Shapes:
    """Return the shapes of merged splats ``made``: means over the ``splats`` [N] of each ``label`` [N].

    The means are weighted by ``weight`` [N]. Bends are averaged as deformation gradients and applied to the axes of
    ``made``.
    """
    rows, count = shapes.rows, len(shapes)
    total = np.bincount(label, weight, len(made))
    keys, place = np.unique(label[rows] * count + shapes.targets, return_inverse=True)
    share = weight[rows] / total[label[rows]]
    values = np.concatenate([shapes.metres, _gradients(shapes, splats).reshape(-1, 9)], axis=1) * share[:, None]
    summed: F64 = np.zeros((len(keys), 12))
    np.add.at(summed, place, values)
    of = keys // count
    bends = _bends(summed[:, 3:].reshape(-1, 3, 3), made, of)
    return Shapes.create(
        shapes.names, len(made), splats=of, targets=keys % count, moves=summed[:, :3], bends=bends, limits=shapes.limits
    )


def transferred_shapes(shapes: Shapes, before: Splats, after: Splats) -> Shapes:
    """Return ``shapes`` for ``after``: the splats ``before`` in the same order, moved a little, turned and scaled."""
    rows, gradients = shapes.rows, _gradients(shapes, before)
    shift = after.means.astype(np.float64) - before.means
    moves = shapes.metres + np.einsum("eij,ej->ei", gradients, np.where(np.isfinite(shift), shift, 0)[rows])
    return Shapes.create(
        shapes.names,
        len(after),
        splats=rows,
        targets=shapes.targets,
        moves=moves,
        bends=_bends(gradients, after, rows),
        limits=shapes.limits,
    )


def expression_maps(shapes: Shapes, splats: Splats, weights: F64) -> tuple[F64, F64]:
    """Return the affine map x -> B x + t of an expression at each splat: B [N, 3, 3] and t [N, 3] in metres.

    ``weights`` [T] are those of the targets.
    """
    rows, share = shapes.rows, weights[shapes.targets]
    active = np.flatnonzero(share)
    bend = np.tile(np.eye(3), (len(splats), 1, 1))
    move = np.zeros((len(splats), 3))
    np.add.at(bend, rows[active], _gradients(shapes, splats)[active] * share[active, None, None])
    np.add.at(move, rows[active], shapes.metres[active].astype(np.float64) * share[active, None])
    means = np.where(np.isfinite(splats.means), splats.means, 0).astype(np.float64)
    return bend, move - np.einsum("nij,nj->ni", bend - np.eye(3), means)


def transferred_surface(surface: Surface | None, before: Splats, after: Splats) -> Surface | None:
    """Return the surface of ``after``: for each splat the mean over the nearest splats of ``before``.

    The mean is over len(before) / len(after) splats, 1 to 4. None without a surface or without a finite splat.
    """
    usable = np.flatnonzero(before.finite())
    if surface is None or not len(usable):
        return None
    k = int(np.clip(round(len(before) / max(len(after), 1)), 1, min(_MAX_SOURCES, len(usable))))
    means = np.nan_to_num(after.means.astype(np.float64), posinf=0, neginf=0)
    near = usable[cKDTree(before.means[usable].astype(np.float64)).query(means, k)[1].reshape(len(means), k)]
    normals = unit_vectors(surface.units[near].sum(axis=1))
    shade = None if surface.shade is None else np.exp2(np.log2(surface.shades[near]).mean(axis=1))
    return Surface.of(normals, surface.ao[near].mean(axis=1), shade)


def _gradients(shapes: Shapes, splats: Splats) -> F64:
    """Return the deformation gradients less the identity [E, 3, 3]; the normal stays perpendicular to both axes."""
    axes = sorted_axes(splats)[shapes.rows]
    one, other, normal = axes[:, :, 0], axes[:, :, 1], axes[:, :, 2]
    first, second = (shapes.bends[:, k] * BEND for k in (0, 1))
    lean = -np.einsum("ei,ei->e", first, normal)[:, None] * one - np.einsum("ei,ei->e", second, normal)[:, None] * other
    return np.asarray(np.einsum("kei,kej->eij", np.stack([first, second, lean]), np.stack([one, other, normal])))


def _bends(gradients: F64, splats: Splats, rows: NDArray[np.integer]) -> F64:
    return np.asarray(np.einsum("eij,ejk->eki", gradients, sorted_axes(splats)[rows][:, :, :2]))


def sorted_axes(splats: Splats) -> F64:
    """Return the two long axes and the thin one, as columns [N, 3, 3]."""
    finite = np.asarray(np.isfinite(splats.quats).all(axis=1))[:, None]
    axes = quaternion_matrices(np.where(finite, splats.quats, (1, 0, 0, 0)))
    return np.take_along_axis(axes, long_axes(splats.scales)[:, None, :], axis=2)
