"""Merge splats in pairs of neighbours, the cheapest first, by their moments.

The cost of a pair is the error of merging it: Ward's criterion on positions, colours, orientations and joint weights.
So uniform surfaces are merged far; edges, thin sheets and parts that move apart stay. A merged splat takes the mean,
the covariance and the mean colour of its sources, weighted by the area that they cover.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from glsplat.arrays import F32, F64
from glsplat.avatar import Avatar, splats_of
from glsplat.errors import GlsplatError
from glsplat.extras.authoring.geometry.attribute_transfer import merged_shapes, transferred_surface
from glsplat.rotations import quaternion_matrices
from glsplat.skinning.skin import Skin
from glsplat.splats import SH_C0, Splats

Scene = TypeVar("Scene", bound=Splats | Avatar)
Report = Callable[[str, float], None]

_CHUNK_SIZE = 1 << 17  # pairs or splats, to bound the memory
_TWO_PASS_SPLATS = 200_000  # from here on rounds are expensive, and each pairs twice
# Costs of a pair are in its own sizes; tuned on the default avatar and a captured plant.
_NEIGHBOURS = 5  # candidates of each splat
_ROUND_FRACTION = 0.35  # of all splats, merged before neighbours are searched again
_COLOUR_COST = 2.0  # of a difference of one
_NORMAL_COST = 1.2  # of a right angle
_SHEET_FACTOR = 3.0  # of distances along the normal
_MASS_POWER = 0.5  # of the pair's area


@dataclass(frozen=True, slots=True, kw_only=True)
class Cover:
    """Opacity and growth of merged splats, so that they cover the area of their sources."""

    gain: float = 1.0  # of the opacity; where splats hide each other, fewer hide less
    grow: float = 0.7  # power of the opacity above ``most`` by which a splat grows
    most: float = 0.97  # opacity


def merged(scene: Scene, count: int, progress: Report | None = None) -> Scene:
    """Return the scene merged to ``count`` splats, without levels; unchanged if it has no more. Deterministic.

    Splats that are not finite or transparent are dropped. Merged splats of an avatar take the mean of their weights
    and shapes. Raises GlsplatError for a count below 1 or a scene without a splat that can be drawn.
    """
    if count >= len(splats_of(scene)):
        return scene
    (found,) = merged_levels(scene, [count], progress)
    return covered(found, Cover())


def merged_levels(
    scene: Scene,
    counts: Sequence[int],  # falling
    progress: Report | None = None,
) -> list[Scene]:
    """Return the scene merged to each of several counts, each from the one before; pass them to ``covered``.

    Their opacities keep the covered area, and may be far above 1. Raises as ``merged``.
    """
    report = progress or (lambda stage, done: None)
    if not counts or min(counts) < 1 or any(a <= b for a, b in pairwise(counts)):
        raise GlsplatError(
            f"levels need falling numbers of splats above 0, not {', '.join(map(str, counts)) or 'none'}"
        )
    splats = splats_of(scene)
    usable = np.flatnonzero(splats.finite() & (splats.opacities > 0) & (np.abs(splats.quats).max(-1, initial=0) > 0))
    if not len(usable):
        raise GlsplatError("levels of detail need at least one finite splat that is not transparent")
    work = _Clusters(splats.take(usable), _dense(scene, usable))
    first = len(usable)
    out: list[Scene] = []
    for count in counts:
        while work.count > count:
            done = np.log(first / work.count) / max(np.log(first / counts[-1]), 1e-9)
            report("merging splats", float(min(done, 1.0)))
            work.merge(count)
        out.append(_merged_scene(scene, usable, work))
    return out


def covered(scene: Scene, cover: Cover) -> Scene:
    """Return a scene of ``merged_levels`` with valid opacities: excess opacity enlarges a splat in its plane."""
    bare: Any = scene
    splats: Any = splats_of(bare)
    opacity = cover.gain * splats.opacities.astype(np.float64)
    over = np.maximum(opacity / cover.most, 1) ** (cover.grow / 2)
    scales = splats.scales * over[:, None]
    thin = splats.scales.argmin(axis=1)[:, None]
    np.put_along_axis(scales, thin, np.take_along_axis(splats.scales, thin, axis=1), axis=1)
    done = replace(splats, scales=scales, opacities=np.minimum(opacity, cover.most))
    return cast("Scene", replace(bare, splats=done) if isinstance(bare, Avatar) else done)


class _Clusters:
    """The state of a merge: clusters and their moments."""

    def __init__(self, splats: Splats, weights: F32 | None) -> None:
        self.label = np.arange(len(splats))  # the cluster of each splat
        scales = np.abs(splats.scales.astype(np.float64))
        self.mass: F64 = np.minimum(splats.opacities, 1).astype(np.float64) * area_of(scales)
        self.mass = np.maximum(self.mass, self.mass.max() * 1e-12 + 1e-300)
        self._means = splats.means.astype(np.float64)
        self._rgb = splats.sh[:, 0].astype(np.float64) * SH_C0
        thin = scales.argmin(axis=1)
        axes = np.empty((len(splats), 3))
        for at in range(0, len(splats), _CHUNK_SIZE):
            part = slice(at, at + _CHUNK_SIZE)
            axes[part] = np.take_along_axis(
                quaternion_matrices(splats.quats[part].astype(np.float64)), thin[part, None, None], axis=2
            )[:, :, 0]
        ordered = np.sort(scales, axis=1)
        flat = 1 - ordered[:, 0] / np.maximum(ordered[:, 1], 1e-300)
        self._normals = axes * flat[:, None]  # of length 0 for round splats, 1 for flat ones
        self._weights = weights
        self._passes = 2 if self.count > _TWO_PASS_SPLATS else 1

    @property
    def count(self) -> int:
        return len(self.mass)

    def merge(self, least: int) -> None:
        """Merge the cheapest pairs in which each splat is the other's cheapest neighbour, down to ``least`` splats."""
        target, cost = self._pairs()
        most = max(1, min(self.count - least, int(_ROUND_FRACTION * self.count)))
        chosen = np.flatnonzero(target >= 0)
        if len(chosen) > most:
            chosen = chosen[np.argpartition(cost[chosen], most - 1)[:most]]
        root = np.arange(self.count)
        root[chosen] = target[chosen]
        stays = np.ones(self.count, bool)
        stays[chosen] = False
        number = (np.cumsum(stays) - 1)[root]
        flip = np.where(np.einsum("ni,ni->n", self._normals, self._normals[root]) < 0, -1.0, 1.0)
        parts = csr_array((self.mass, (number, np.arange(self.count))), shape=(int(stays.sum()), self.count))
        mass = np.bincount(number, self.mass).astype(np.float64)
        self._means, self._rgb = (parts @ one / mass[:, None] for one in (self._means, self._rgb))
        self._normals = parts @ (self._normals * flip[:, None]) / mass[:, None]
        if self._weights is not None:
            self._weights = (parts @ self._weights / mass[:, None]).astype(np.float32)
        self.mass, self.label = mass, number[self.label]
        self._passes = 2 if self.count > _TWO_PASS_SPLATS else 1

    def _pairs(self) -> tuple[NDArray[np.intp], F32]:
        """Return the cluster that each is merged into [N], -1 where it stays, and the cost [N]; at least one merges.

        A pair merges where it is the cheapest for both; in a second pass, unpaired splats try the rest.
        """
        k = min(_NEIGHBOURS + 1, self.count)
        tree = cKDTree(self._means)
        near, costs = np.empty((self.count, k), np.int32), np.empty((self.count, k), np.float32)
        for at in range(0, self.count, _CHUNK_SIZE):
            rows = np.arange(at, min(at + _CHUNK_SIZE, self.count))
            near[rows] = tree.query(self._means[rows], k)[1].reshape(len(rows), k)
            costs[rows] = self._costs(rows, near[rows])
        own = np.arange(self.count)
        costs[near == own[:, None]] = np.inf
        target, paid = np.full(self.count, -1), np.full(self.count, np.inf, np.float32)
        free = np.ones(self.count, bool)  # not in a pair
        for _ in range(self._passes):
            rows = np.flatnonzero(free)
            free_costs = np.where(free[near[rows]], costs[rows], np.inf)
            choice = free_costs.argmin(axis=1)[:, None]
            best = np.full(self.count, -1)
            best[rows] = np.take_along_axis(near[rows], choice, axis=1)[:, 0]
            price = np.take_along_axis(free_costs, choice, axis=1)[:, 0]
            rows, price = rows[np.isfinite(price)], price[np.isfinite(price)]
            # an edge that is the cheapest of both its ends, in whichever list of neighbours it is
            order = np.argsort(price, kind="stable")
            one, other, price = rows[order], best[rows[order]], price[order]
            first = np.full(self.count, len(order))
            np.minimum.at(first, one, np.arange(len(order)))
            np.minimum.at(first, other, np.arange(len(order)))
            merges = (first[one] == np.arange(len(order))) & (first[other] == np.arange(len(order)))
            target[one[merges]], paid[one[merges]] = other[merges], price[merges]
            free[one[merges]] = free[other[merges]] = False
        return target, paid

    def _costs(self, rows: NDArray[np.intp], near: NDArray[np.int32]) -> F64:
        """Return the cost [R, k] of merging each of ``rows`` with each of its neighbours."""
        a, b = self.mass[rows][:, None], self.mass[near]
        apart = self._means[near] - self._means[rows][:, None]
        one, other = self._normals[rows][:, None], self._normals[near]
        along = np.maximum(np.abs((one * apart).sum(axis=2)), np.abs((other * apart).sum(axis=2)))
        place = (apart * apart).sum(axis=2) + (_SHEET_FACTOR**2 - 1) * along * along
        colour = ((self._rgb[near] - self._rgb[rows][:, None]) ** 2).sum(axis=2)
        size = a + b  # the product of two deviations: a squared length
        square = colour * _COLOUR_COST**2
        lengths = np.sqrt((one * one).sum(axis=2) * (other * other).sum(axis=2))
        square += _NORMAL_COST**2 * 2 * np.maximum(lengths - np.abs((one * other).sum(axis=2)), 0)
        if self._weights is not None:
            turn = self._weights[near] - self._weights[rows][:, None]
            square += np.einsum("rkj,rkj->rk", turn, turn)
        return np.asarray(a * b / size * size ** (_MASS_POWER - 1) * (place + 4 * size * square))


def _dense(scene: Splats | Avatar, usable: NDArray[np.intp]) -> F32 | None:
    """Return the weights [N, J] of the joints that move any splat; None for static splats."""
    if not isinstance(scene, Avatar):
        return None
    joints, weights = scene.skin.joints[usable].astype(np.intp), scene.skin.weights[usable]
    used, columns = np.unique(joints, return_inverse=True)
    out = np.zeros((len(usable), len(used)), np.float32)
    np.add.at(out, (np.arange(len(usable))[:, None], columns.reshape(joints.shape)), weights)
    return out


def _merged_scene(scene: Any, usable: NDArray[np.intp], work: _Clusters) -> Any:
    """Return the scene of the clusters, from the moments of their splats."""
    splats: Any = splats_of(scene)
    used = splats.take(usable)
    count, label = work.count, work.label
    scales = np.abs(used.scales.astype(np.float64))
    weight = np.maximum(np.minimum(used.opacities, 1).astype(np.float64) * area_of(scales), work.mass.max() * 1e-15)
    rows = csr_array((weight, (label, np.arange(len(used)))), shape=(count, len(used)))
    total = np.asarray(rows.sum(axis=1)).reshape(-1, 1)
    centre: F64 = (rows @ used.means.astype(np.float64)) / total
    spread = np.zeros((count, 9))
    for part, chosen in _chunks(rows):
        shapes = quaternion_matrices(used.quats[part].astype(np.float64)) * scales[part, None, :]
        apart = used.means[part] - centre[label[part]]
        spread += chosen @ (shapes @ shapes.transpose(0, 2, 1) + apart[:, :, None] * apart[:, None, :]).reshape(-1, 9)
    values, vectors = np.linalg.eigh((spread / total[:, :, None].reshape(-1, 1)).reshape(-1, 3, 3))
    vectors[:, :, 0] *= np.sign(np.linalg.det(vectors))[:, None]
    deviations = np.sqrt(np.maximum(values, 1e-18))
    opacity = total[:, 0] / area_of(deviations)
    sh = (rows @ used.sh.reshape(len(used), -1)) / total
    quats = Rotation.from_matrix(vectors).as_quat()[:, [3, 0, 1, 2]]
    made = Splats.create(centre, quats, deviations, opacity, sh.reshape(count, -1, 3), antialias=splats.antialias)
    made = replace(made, surface=transferred_surface(used.surface, used, made))
    if not isinstance(scene, Avatar):
        return made
    joints = len(scene.skeleton)
    k = scene.skin.influences
    each = csr_array(
        (scene.skin.weights[usable].ravel(), (np.repeat(np.arange(len(usable)), k), scene.skin.joints[usable].ravel())),
        shape=(len(usable), joints),
    )
    weights = (rows @ each).toarray() / total
    skin = Skin.create(np.broadcast_to(np.arange(joints), weights.shape), weights, joints, scene.skin.influences)
    shapes = None if scene.shapes is None else merged_shapes(scene.shapes.take(usable), used, label, weight, made)
    return Avatar(made, scene.skeleton, skin, scene.meta, shapes=shapes)


def _chunks(rows: csr_array) -> Iterator[tuple[slice, csr_array]]:
    columns = rows.tocsc()
    for at in range(0, rows.shape[1], _CHUNK_SIZE):
        part = slice(at, min(at + _CHUNK_SIZE, rows.shape[1]))
        yield part, columns[:, part]


def area_of(deviations: F64) -> F64:
    """Return the mean projected area over pi [N] of ellipsoids with semi-axes ``deviations`` [N, 3] (Thomsen 2004)."""
    a, b, c = deviations.T
    power = 1.6075  # off by 1 % at most
    return np.asarray((((a * b) ** power + (b * c) ** power + (c * a) ** power) / 3) ** (1 / power))
