"""Find eyeballs and the openings of their lids, and make blinks that end where the lids meet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F64
from glsplat.extras.authoring.body.open_body import open_body
from glsplat.extras.authoring.fit.eyes import fitted_sphere
from glsplat.extras.authoring.geometry.visibility import EYES
from glsplat.meshes import RiggedMesh
from glsplat.skinning.smplx import JOINT_NAMES

Indices = NDArray[np.intp]
_SIDES_RAD = np.radians(np.linspace(-62, 62, 63))  # ray directions, to the left ...
_HEIGHTS_RAD = np.radians(np.linspace(-50, 50, 101))  # ... and up
_MAX_START_STEPS = 25  # of height from the middle, at most, to the start of an opening
_MIN_OPENING_STEPS = 3  # of height
_MAX_LID_RADII = 1.35  # of the eyeball, from its middle to a lid's edge
_SEARCH_RADIUS_M = 0.035  # around the middle of an eye
_RAYS_AT_ONCE = 512
_ABOVE_WEIGHT = 0.75  # of angles above an opening: there a lid continues
# radii of the eyeball, at least, of lids that lie on it, and of those that it pokes through
_MIN_LID_RADII, _MIN_POKED_LID_RADII = 0.9, 1.0
_MIN_SIDES = 8  # directions in which an open eye is open
BLINK_SHAPES = ("eyeBlinkLeft", "eyeBlinkRight")
EYEBALL_RETREAT_M = np.array([0.0, 0.0, -0.003])
"""Movement of eyeballs as lids close, as real eyes have (Evinger, Shaw, Peck, Manning and Baker 1984)."""
_CLOSED_QUANTILE = 0.8  # of the opening's width that must be closed; lashes cover the corners
_PRESSURE = 0.02  # added to the shape's weight: lids press


@dataclass(frozen=True, slots=True)
class Eyeball:
    """The sphere of an eyeball."""

    joint: str
    centre: F64  # [3] metres
    radius: float  # metres


def fit_eyeballs(mesh: RiggedMesh) -> list[Eyeball]:
    """Return spheres fitted to both eyes of a mesh whose first vertices are the open body's."""
    return [Eyeball(joint, *fitted_sphere(mesh.vertices[_ball_vertices(joint)])) for joint in EYES]


def _ball_vertices(joint: str) -> Indices:
    """Return the open body's vertices of the eyeball that turns about ``joint``."""
    body = open_body()
    return np.flatnonzero(~body.skin & (body.part == JOINT_NAMES.index(joint)))


class LidEdges(NamedTuple):
    """Edges of the lids before an eyeball, in K directions from nose to temple or the other way."""

    side: F64  # [K] radians to the person's left
    upper: F64  # [K] radians up
    lower: F64  # [K]
    upper_face: Indices  # [K] the mesh's triangle there
    lower_face: Indices  # [K]
    upper_at: F64  # [K, 3] metres
    lower_at: F64  # [K, 3]

    def above(self, rays: F64) -> tuple[F64, F64, F64]:
        """Return radians of ``rays`` [N, 3] above the lower edge, above the upper one, and beside both.

        ``rays`` start at the eye's middle.
        """
        side = np.arctan2(rays[:, 0], rays[:, 2])
        up = np.arcsin((rays[:, 1] / np.maximum(np.linalg.norm(rays, axis=1), 1e-12)).clip(-1, 1))
        order = np.argsort(self.side)
        upper, lower = (np.interp(side, self.side[order], edge[order]) for edge in (self.upper, self.lower))
        return up - lower, up - upper, np.maximum(self.side.min() - side, side - self.side.max())

    def beyond(self, rays: F64) -> F64:
        """Return [N] radians of ``rays`` [N, 3] from the eye's middle beyond the opening; 0 within.

        Above it they count less: there a lid continues.
        """
        low, high, aside = self.above(rays)
        return np.asarray(np.maximum.reduce([_ABOVE_WEIGHT * high, -low, aside, np.zeros(len(rays))]))


class Opening(NamedTuple):
    """An eye that is open."""

    ball: Eyeball
    edges: LidEdges


def find_openings(mesh: RiggedMesh, balls: Sequence[Eyeball]) -> list[Opening]:
    """Return the openings of eyes that are open at rest; closed eyes are left out.

    An opening is bounded by lids that end, or by lids that the eyeball pokes through, as in fits of people who smile.
    """
    found = []
    for ball in balls:
        for min_radii in (_MIN_LID_RADII, _MIN_POKED_LID_RADII):
            edges = lid_edges(mesh, ball, min_radii)
            if len(edges.side) >= _MIN_SIDES:
                found.append(Opening(ball, edges))
                break
    return found


def lid_edges(mesh: RiggedMesh, ball: Eyeball, min_radii: float) -> LidEdges:
    """Return the opening between the lids at rest, seen from the middle of the ball, without sides that are closed.

    Surface nearer to the middle than ``min_radii`` radii is no lid.
    """
    faces = mesh.faces
    skin = ~np.isin(mesh.joints[faces[:, 0], 0], [mesh.skeleton.names.index(ball.joint)])
    corners = mesh.vertices[faces]
    near = (np.linalg.norm(corners - ball.centre, axis=2) < _SEARCH_RADIUS_M).all(axis=1) & skin
    mine = np.flatnonzero(near)
    side, up = np.meshgrid(_SIDES_RAD, _HEIGHTS_RAD, indexing="ij")
    rays = directions(side.ravel(), up.ravel())
    hit, distance = _first_hits(corners[mine] - ball.centre, rays, min_radii * ball.radius)
    hit, distance = hit.reshape(side.shape), distance.reshape(side.shape)
    found = []
    for index in range(len(_SIDES_RAD)):
        row = hit[index]
        middle = len(_HEIGHTS_RAD) // 2
        open_rows = np.flatnonzero(row < 0)
        if not len(open_rows) or np.abs(open_rows - middle).min() > _MAX_START_STEPS:  # closed, or a gap above the lid
            continue
        start = int(open_rows[np.abs(open_rows - middle).argmin()])
        low = high = start
        while low > 0 and row[low - 1] < 0:
            low -= 1
        while high < len(row) - 1 and row[high + 1] < 0:
            high += 1
        if low == 0 or high == len(row) - 1 or high - low < _MIN_OPENING_STEPS:
            continue
        if max(distance[index, high + 1], distance[index, low - 1]) > _MAX_LID_RADII * ball.radius:
            continue  # the nose, or a brow
        found.append((index, high + 1, low - 1))
    k = np.array(found, np.intp).reshape(-1, 3)
    ends = [directions(_SIDES_RAD[k[:, 0]], _HEIGHTS_RAD[k[:, n]]) for n in (1, 2)]
    at = [ball.centre + way * distance[k[:, 0], k[:, n]][:, None] for n, way in zip((1, 2), ends, strict=True)]
    upper, lower = (mine[hit[k[:, 0], k[:, n]]] for n in (1, 2))
    return LidEdges(_SIDES_RAD[k[:, 0]], _HEIGHTS_RAD[k[:, 1]], _HEIGHTS_RAD[k[:, 2]], upper, lower, at[0], at[1])


def directions(side: F64, up: F64) -> F64:
    """Return [N, 3] unit vectors, ``side`` [N] radians to the person's left and ``up`` radians up."""
    return np.stack([np.cos(up) * np.sin(side), np.sin(up), np.cos(up) * np.cos(side)], axis=1)


def _first_hits(corners: F64, rays: F64, min_distance: float) -> tuple[Indices, F64]:
    """[N] the first triangle [F, 3, 3] beyond ``least`` that rays from the origin meet, -1 for none, and how far.

    Moeller and Trumbore 1997.
    """
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    tangent = np.cross(-corners[:, 0], first)
    normal, aside = np.cross(second, first), np.cross(second, -corners[:, 0])
    apart = (second * tangent).sum(axis=1)
    best: Indices = np.full(len(rays), -1, np.intp)
    far: F64 = np.full(len(rays), np.inf)
    if not len(corners):
        return best, far
    for begin in range(0, len(rays), _RAYS_AT_ONCE):
        some = rays[begin : begin + _RAYS_AT_ONCE]
        with np.errstate(divide="ignore", invalid="ignore"):
            size = some @ normal.T
            u, v = some @ aside.T / size, some @ tangent.T / size
            ray, face = np.nonzero((u >= 0) & (v >= 0) & (u + v <= 1))
            there = apart[face] / size[ray, face]
        met = there > min_distance
        t: F64 = np.full(size.shape, np.inf)
        t[ray[met], face[met]] = there[met]
        nearest = t.argmin(axis=1)
        far[begin : begin + _RAYS_AT_ONCE] = t[np.arange(len(some)), nearest]
        best[begin : begin + _RAYS_AT_ONCE] = np.where(np.isfinite(far[begin : begin + _RAYS_AT_ONCE]), nearest, -1)
    return best, far


def blink_shape_of(ball: Eyeball) -> str:
    """Return the expression that closes an eye."""
    return BLINK_SHAPES[EYES.index(ball.joint)]


def closing_weight(mesh: RiggedMesh, eye: Opening) -> float:
    """Return the weight of eyeBlink at which the upper lid of an eye of the mesh meets the lower one.

    The open body's blink fits its own eyes; in narrower ones the upper lid would move on over the cheek.
    """
    assert mesh.morphs is not None
    edges, moves = eye.edges, mesh.morphs.dense(blink_shape_of(eye.ball), len(mesh.vertices))
    upper, lower = (moves[mesh.faces[face], 1].mean(axis=1) for face in (edges.upper_face, edges.lower_face))
    opening = edges.upper_at[:, 1] - edges.lower_at[:, 1]
    return min(float(np.quantile(opening / np.maximum(lower - upper, 1e-4), _CLOSED_QUANTILE)) + _PRESSURE, 1.0)


def with_blink(mesh: RiggedMesh, shares: Mapping[str, float]) -> RiggedMesh:
    """Return the mesh with blinks scaled by ``shares``, and eyeballs that retreat from closing lids.

    Shapes are linear: half-way down, a lid passes the front of the eyeball.
    """
    morphs = mesh.morphs
    assert morphs is not None
    weights = [shares.get(name, 1.0) for name in morphs.names]
    scaled_morphs = replace(morphs, offsets=morphs.offsets * np.repeat(weights, np.diff(morphs.starts))[:, None])
    balls = {}
    for eye, name in zip(EYES, BLINK_SHAPES, strict=True):
        ball = _ball_vertices(eye)
        balls[name] = ball, np.tile(EYEBALL_RETREAT_M, (len(ball), 1))
    return replace(mesh, morphs=scaled_morphs.plus(balls))
