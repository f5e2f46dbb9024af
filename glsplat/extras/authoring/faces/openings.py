"""Openings of eyes: where lids end before an eyeball, found by rays from its middle."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.faces.eyeballs import Eyeball
from glsplat.meshes import RiggedMesh

__all__ = ["LidEdges", "Opening", "directions", "lid_edges", "openings"]

F64 = NDArray[np.float64]
Indices = NDArray[np.intp]

_SIDES = np.radians(np.linspace(-62, 62, 63))  # directions from the middle of the eye, to the sides ...
_HEIGHTS = np.radians(np.linspace(-50, 50, 101))  # ... and up
_HIGH = 25  # of those heights, from the middle: no opening begins beyond
_LID = 1.35  # radii of the ball, at most, from its middle to a lid's edge
_ABOUT = 0.035  # metres from the middle of an eye; lids are no farther
_RAYS = 512  # at a time
_ABOVE = 0.75  # by so much less counts what is beyond an opening above it
_ON, _THROUGH = 0.9, 1.0  # radii: lids that lie on a ball are a little within it, those that it comes through as well
_FEWEST = 8  # directions in which an eye is open that is


class LidEdges(NamedTuple):
    """Where lids end before an eyeball, K directions from nose to temple or the other way."""

    side: F64  # [K] radians to the person's left
    upper: F64  # [K] radians up
    lower: F64  # [K]
    upper_face: Indices  # [K] the mesh's triangle there
    lower_face: Indices  # [K]
    upper_at: F64  # [K, 3] metres
    lower_at: F64  # [K, 3]

    def above(self, ways: F64) -> tuple[F64, F64, F64]:
        """Radians that ways [N, 3] from the eye's middle are above the lower edge, and the upper; and beside both."""
        side = np.arctan2(ways[:, 0], ways[:, 2])
        up = np.arcsin((ways[:, 1] / np.maximum(np.linalg.norm(ways, axis=1), 1e-12)).clip(-1, 1))
        order = np.argsort(self.side)
        upper, lower = (np.interp(side, self.side[order], edge[order]) for edge in (self.upper, self.lower))
        return up - lower, up - upper, np.maximum(self.side.min() - side, side - self.side.max())

    def beyond(self, ways: F64) -> F64:
        """[N] radians that ways [N, 3] from the eye's middle are beyond the opening; 0 within.

        Above it they count less: there a lid goes on.
        """
        low, high, aside = self.above(ways)
        return np.asarray(np.maximum.reduce([_ABOVE * high, -low, aside, np.zeros(len(ways))]))


class Opening(NamedTuple):
    """An eye that is open."""

    ball: Eyeball
    edges: LidEdges


def openings(mesh: RiggedMesh, balls: Sequence[Eyeball]) -> list[Opening]:
    """Of the eyes that are open at rest, by lids that end, or by lids that the ball comes through, as fits of people
    who smile have them; an eye that is shut is left out."""
    found = []
    for ball in balls:
        for least in (_ON, _THROUGH):
            edges = lid_edges(mesh, ball, least)
            if len(edges.side) >= _FEWEST:
                found.append(Opening(ball, edges))
                break
    return found


def lid_edges(mesh: RiggedMesh, ball: Eyeball, least: float) -> LidEdges:
    """The opening between the lids, seen from the middle of the ball, at rest; what is shut at a side is left out.

    What is nearer to its middle than ``least`` radii is no lid.
    """
    faces = mesh.faces
    skin = ~np.isin(mesh.joints[faces[:, 0], 0], [mesh.skeleton.names.index(ball.joint)])
    corners = mesh.vertices[faces]
    near = (np.linalg.norm(corners - ball.centre, axis=2) < _ABOUT).all(axis=1) & skin
    mine = np.flatnonzero(near)
    side, up = np.meshgrid(_SIDES, _HEIGHTS, indexing="ij")
    hit, distance = _hits(corners[mine] - ball.centre, directions(side.ravel(), up.ravel()), least * ball.radius)
    hit, distance = hit.reshape(side.shape), distance.reshape(side.shape)
    found = []
    for index in range(len(_SIDES)):
        row = hit[index]
        middle = len(_HEIGHTS) // 2
        open_ = np.flatnonzero(row < 0)
        if not len(open_) or np.abs(open_ - middle).min() > _HIGH:  # shut, or a gap above the lid
            continue
        start = int(open_[np.abs(open_ - middle).argmin()])
        low = high = start
        while low > 0 and row[low - 1] < 0:
            low -= 1
        while high < len(row) - 1 and row[high + 1] < 0:
            high += 1
        if low == 0 or high == len(row) - 1 or high - low < 3:
            continue
        if max(distance[index, high + 1], distance[index, low - 1]) > _LID * ball.radius:
            continue  # the nose, or a brow
        found.append((index, high + 1, low - 1))
    k = np.array(found, np.intp).reshape(-1, 3)
    ways = [directions(_SIDES[k[:, 0]], _HEIGHTS[k[:, n]]) for n in (1, 2)]
    at = [ball.centre + way * distance[k[:, 0], k[:, n]][:, None] for n, way in zip((1, 2), ways, strict=True)]
    upper, lower = (mine[hit[k[:, 0], k[:, n]]] for n in (1, 2))
    return LidEdges(_SIDES[k[:, 0]], _HEIGHTS[k[:, 1]], _HEIGHTS[k[:, 2]], upper, lower, at[0], at[1])


def directions(side: F64, up: F64) -> F64:
    """[N, 3] unit ways, ``side`` [N] radians to the person's left and ``up`` radians up."""
    return np.stack([np.cos(up) * np.sin(side), np.sin(up), np.cos(up) * np.cos(side)], axis=1)


def _hits(corners: F64, ways: F64, least: float) -> tuple[Indices, F64]:
    """[N] the first triangle [F, 3, 3] beyond ``least`` that rays from the origin meet, -1 for none, and how far.

    Moeller and Trumbore 1997.
    """
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    lifted = np.cross(-corners[:, 0], first)
    normal, aside = np.cross(second, first), np.cross(second, -corners[:, 0])
    apart = (second * lifted).sum(axis=1)
    best: Indices = np.full(len(ways), -1, np.intp)
    far: F64 = np.full(len(ways), np.inf)
    if not len(corners):
        return best, far
    for begin in range(0, len(ways), _RAYS):
        some = ways[begin : begin + _RAYS]
        with np.errstate(divide="ignore", invalid="ignore"):
            size = some @ normal.T
            u, v = some @ aside.T / size, some @ lifted.T / size
            ray, face = np.nonzero((u >= 0) & (v >= 0) & (u + v <= 1))
            there = apart[face] / size[ray, face]
        met = there > least
        t: F64 = np.full(size.shape, np.inf)
        t[ray[met], face[met]] = there[met]
        nearest = t.argmin(axis=1)
        far[begin : begin + _RAYS] = t[np.arange(len(some)), nearest]
        best[begin : begin + _RAYS] = np.where(np.isfinite(far[begin : begin + _RAYS]), nearest, -1)
    return best, far
