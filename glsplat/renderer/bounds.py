"""Bounds: a box of the pixels that an item's splats or mesh can cover, from its bones alone.

Where the GPU sorts, the host does not know which pixels splats touch. The extents of all groups of splats are measured
once; a frame poses and projects some thousand corners instead of the splats.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F64
from glsplat.camera import Camera
from glsplat.config import RenderConfig
from glsplat.renderer.stats import Box
from glsplat.rotations import is_rigid, quaternion_matrices
from glsplat.skinning.shapes import BEND, Shapes
from glsplat.skinning.skin import Skin, strongest_joint
from glsplat.splats import Splats

_DIRECTIONS = np.array(list(product((-1.0, 0.0, 1.0), repeat=3)))  # [27, 3]; the middle one is no direction
_SLIVER = 1e-7  # of a weight; smaller shares move no splat by a pixel
_ROUNDING = 1e-6  # of a distance from the origin: float32 on the GPU


@dataclass(frozen=True, slots=True, eq=False)
class PosedBounds:
    """Hulls of an item's groups in the scene; metres."""

    corners: NDArray[np.float32]  # [3, C, G] of the hulls at rest
    moved: F64  # [G, 3, 4] scene from rest
    slack: F64  # [G] by which splats may stick out
    radius: F64  # [G] largest reach of a splat from its mean
    connected: bool  # triangles connect the groups


class Bounds:
    """Hulls of the splats (or vertices) of an item at rest, by groups that move alike.

    A blend of joints is written as a mix of halves: a splat with weights 0.7 and 0.3 of joints a and b moves as 0.4
    times a alone and 0.6 times half a, half b. So it is inside the convex hull of its places in both groups. Groups of
    single joints alone would be a tenth larger in either direction.
    """

    def __init__(
        self,
        points: F64,  # [N, 3] means or vertices, metres
        support: Callable[[F64], F64],  # reach [N] of each splat from its mean in a direction [3]; 0 for vertices
        radius: F64,  # [N] largest reach
        skin: Skin | None,  # None: one group
        joints: int = 1,
        shapes: Shapes | None = None,
        connected: bool = False,  # triangles connect the groups
    ) -> None:
        count = len(points)
        ids = np.zeros((count, 1), np.intp) if skin is None else skin.joints.astype(np.intp)
        weights = np.ones((count, 1)) if skin is None else skin.weights.astype(np.float64)
        order = np.argsort(ids, axis=1, kind="stable")  # the same for all splats, so that neighbours share groups
        ids, weights = np.take_along_axis(ids, order, axis=1), np.take_along_axis(weights, order, axis=1)
        pairs = list(_halves(ids, weights))
        keys, groups = np.unique(np.concatenate([a * joints + b for a, b in pairs]), return_inverse=True)
        self.pairs: NDArray[np.intp] = np.stack([keys // joints, keys % joints], axis=1)  # [G, 2] joints of a group
        self.connected = connected
        member = groups.reshape(len(pairs), count)  # [K, N]
        rows = np.argsort(member, axis=None, kind="stable") % max(count, 1)
        starts = np.searchsorted(np.sort(member, axis=None), np.arange(len(keys)))

        def most(values: F64) -> F64:
            return np.maximum.reduceat(values[rows], starts) if count else np.empty(0)

        reach = {tuple(d): most(points @ d + support(d)) for d in _DIRECTIONS if d.any()}
        self.corners: NDArray[np.float32] = _corners(reach, len(keys)).astype(np.float32)  # [3, C, G]
        self.radius: F64 = most(radius)
        # [G, J] largest reach of splats that follow joint j most
        self.blended: F64 = np.zeros((len(keys), joints))
        strongest = strongest_joint(ids, weights)
        for group in member:
            np.maximum.at(self.blended, (group, strongest), radius)
        self.growth: F64 | None = None  # [T, G] metres by which a shape at weight 1 moves and stretches splats
        if shapes is not None:
            moved = np.linalg.norm(shapes.metres, axis=1)
            moved = moved + BEND * np.linalg.norm(shapes.bends.reshape(-1, 6), axis=1) * radius[shapes.rows]
            self.growth = np.zeros((len(shapes), len(keys)))
            for group in member:
                np.maximum.at(self.growth, (shapes.targets, group[shapes.rows]), moved)

    @classmethod
    def of_splats(
        cls, splats: Splats, max_sigma: float, skin: Skin | None = None, joints: int = 1, shapes: Shapes | None = None
    ) -> Bounds:
        """Measure splats to where they end: where alpha falls below 1/255, at most ``max_sigma``."""
        rows = np.flatnonzero(splats.finite() & (splats.opacities >= 1 / 255))
        some = splats.take(rows)
        sigmas = np.minimum(max_sigma, np.sqrt(2 * np.log(255.0 * np.minimum(some.opacities, 1.0).astype(np.float64))))
        sizes = np.abs(some.scales.astype(np.float64)) * sigmas[:, None]
        radius = sizes.max(axis=1, initial=0)
        axes = quaternion_matrices(some.quats) * sizes[:, None, :] if skin is not None else np.empty(0)

        def support(direction: F64) -> F64:
            if skin is None:  # static scenes may be too large for matrices
                return radius * float(np.linalg.norm(direction))
            return np.asarray(np.linalg.norm(direction @ axes, axis=1))

        means = some.means.astype(np.float64)
        kept = None if shapes is None else shapes.take(rows)
        return cls(means, support, radius, None if skin is None else skin.take(rows), joints, kept)

    @classmethod
    def of_mesh(cls, vertices: F64, skin: Skin, joints: int) -> Bounds:
        """Measure the vertices [N, 3] of a mesh."""
        nothing = np.zeros(len(vertices))
        return cls(vertices, lambda _: nothing, nothing, skin, joints, connected=True)

    def posed(
        self,
        transform: F64,  # [4, 4] scene from item
        bones: F64 | None = None,  # [J, 3, 4] skinning matrices; None: no skeleton
        weights: F64 | None = None,  # [T] of the shapes
    ) -> PosedBounds:
        """Return the hulls in the scene."""
        size, slack, scale = float(np.cbrt(np.linalg.det(transform[:3, :3]))), np.zeros(len(self.pairs)), 1.0
        if bones is None:
            moved = np.broadcast_to(np.eye(4)[:3], (len(self.pairs), 3, 4))
        else:
            moved = bones[self.pairs].mean(axis=1)
            turns = bones[:, :, :3].reshape(-1, 9)
            if is_rigid(bones):
                # a splat turns by the rotation nearest to its blended matrix, which differs by the square of angles
                apart = 0.5 * (1.5 - 0.5 * turns @ turns.T)[self.pairs].sum(axis=1)  # mean 1 - cos
                apart += np.maximum(apart - 0.5, 0)  # blends that collapse turn with their anchor (rotation.glsl)
                slack = (self.blended * apart).max(axis=1, initial=0)
            else:
                slack, scale = self.radius, max(1.0, float(np.linalg.norm(turns, axis=1).max()))
        if weights is not None and self.growth is not None:
            slack = slack + scale * (np.abs(weights) @ self.growth)
        moved = transform[:3, :3] @ moved
        moved[:, :, 3] += transform[:3, 3]
        return PosedBounds(self.corners, moved, size * slack, size * scale * self.radius, self.connected)


def covered_pixels(views: Sequence[Camera], bounds: Iterable[PosedBounds], config: RenderConfig) -> Box:
    """Return the box, with a rim of one pixel, that holds all pixels that something covers in any view; or no pixels.

    A splat's footprint is that of its linearised projection (project.glsl), which is larger than the true one.
    """
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    blur = config.max_sigma * np.sqrt(config.debug.eps2d) + 0.5  # px
    for one in bounds if views else ():
        if not one.corners.size:
            continue
        for view in views:
            first, last = _projected(view, one, blur)
            low, high = np.minimum(low, first), np.maximum(high, last)
    size = (views[0].width, views[0].height)
    x, y = (int(v) for v in np.clip(np.floor(low) - 1, 0, size))
    right, bottom = (int(v) for v in np.clip(np.ceil(high) + 1, 0, size))
    return (x, y, right - x, bottom - y) if right > x and bottom > y else (0, 0, 0, 0)


def _projected(view: Camera, bounds: PosedBounds, blur: float) -> tuple[F64, F64]:
    """Return the lowest and highest x, y [2] in pixels that ``bounds`` reach; infinite where they are out of view."""
    size, focal, centre = np.array([[view.width], [view.height]]), view.K[[0, 1], [0, 1], None], view.K[:2, 2, None]
    rows = view.viewmat[:3, :3] @ bounds.moved
    rows[:, :, 3] += view.viewmat[:3, 3]
    x, y, z = (
        a * bounds.corners[0] + b * bounds.corners[1] + c * bounds.corners[2] + d
        for a, b, c, d in rows.transpose(1, 2, 0).astype(np.float32)
    )  # [C, G]
    near, far = z.min(axis=0), z.max(axis=0)  # [G]
    slack = bounds.slack + _ROUNDING * np.maximum(np.abs(rows[:, :, 3]).max(axis=1), far)
    nearest, radius = near - slack, bounds.radius + slack
    shown, ahead = (far + slack > view.near) & (nearest < view.far), nearest > view.near
    if not shown.any():
        return np.full(2, np.inf), np.full(2, -np.inf)
    if ahead.all():
        x /= z
        y /= z
    elif bounds.connected:
        return np.zeros(2), size[:, 0].astype(np.float64)
    else:  # the near plane cuts through hulls: their x and y occur at any z in front of it
        x /= np.where(ahead, z, 1)
        y /= np.where(ahead, z, 1)
        nearest = np.maximum(nearest, view.near)
    least, most = np.stack([x.min(axis=0), y.min(axis=0)]), np.stack([x.max(axis=0), y.max(axis=0)])  # slopes [2, G]
    if not ahead.all():
        farthest = np.maximum(far, nearest)
        least = np.where(ahead, least, np.minimum(least / nearest, least / farthest))
        most = np.where(ahead, most, np.maximum(most / nearest, most / farthest))
    stretch = np.sqrt(1 + np.maximum(np.abs(least), np.abs(most)) ** 2)
    # a footprint is the reach along (1, 0, -slope of the mean), not of the hull's tangent; slopes end 15 % outside
    limits = (-centre - 0.15 * size) / focal, (1.15 * size - centre) / focal
    first, last = np.clip(least, *limits), np.clip(most, *limits)
    turn = np.maximum(np.maximum(most, last) - first, last - np.minimum(least, first))
    turn = np.where(ahead, turn, np.maximum(turn, np.maximum(np.abs(first), np.abs(last))))
    # a mean that is further inside turns more, but reaches less far
    turn = np.where((first == least) & (last == most), np.minimum(turn, radius * stretch / nearest), turn)
    extra = (slack * stretch + radius * turn) / nearest
    low, high = focal * (least - extra) + centre - blur, focal * (most + extra) + centre + blur
    if not bounds.connected:
        shown &= (high > 0).all(axis=0) & (low < size).all(axis=0)
    low, high = np.where(shown, low, np.inf), np.where(shown, high, -np.inf)
    return low.min(axis=1), high.max(axis=1)


def _halves(ids: NDArray[np.intp], weights: F64) -> Iterator[tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Yield pairs of joints [N]: row by row, ``weights`` [N, K] of joints ``ids`` are a mix of halves of these pairs.

    With the joints laid one after the other on a line of length 2, as long as their weights, a pair are the joints at t
    and t + 1. The mix is that of all t from 0 to 1.
    """
    ends = 2 * np.cumsum(weights, axis=1)
    ends[:, -1] = np.inf
    rows = np.arange(len(ids))
    for k in range(ids.shape[1]):
        t = (np.zeros(len(ids)) if k == 0 else ends[:, k - 1] % 1) + _SLIVER
        first, second = ((ends <= at[:, None]).sum(axis=1) for at in (t, t + 1))
        yield ids[rows, first], ids[rows, second]


def _corners(reach: dict[tuple[float, ...], F64], count: int) -> F64:
    """Return corners [3, 48, count] around convex bodies with these reaches [count] in 26 directions.

    A direction is a sum of an axis, a diagonal of a face and one of the cube, with weights that are not negative. The
    reach in it is at most the same sum of reaches, which is that of the corner where the three planes meet.
    """
    corners = np.empty((3, 48, count))
    for number, (signs, order) in enumerate(product(product((-1.0, 1.0), repeat=3), permutations(range(3)))):
        direction, before = np.zeros(3), np.zeros(count)
        for axis in order:
            direction[axis] = signs[axis]
            here = reach[tuple(direction)]
            corners[axis, number] = signs[axis] * (here - before)
            before = here
    return corners
