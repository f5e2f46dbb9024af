"""Where to look for a colour that no picture shows: the front of the person at the same place, seen through the body.

In the zero pose a person is flat enough from front to back that cloth, skin and shoes change at the same places on both
sides. The middle of a chest is not carried through: ties, buttons and open jackets have no counterpart on a back.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glsplat.authoring.paint.layers.segments import half_width
from glsplat.authoring.paint.shot import FittedPicture, SurfacePoints
from glsplat.authoring.raster import visible_faces
from glsplat.camera import Camera, look_at
from glsplat.meshes import RiggedMesh

__all__ = ["Sighted", "Twins", "find_twins"]

F64 = NDArray[np.float64]

_FAR = 60.0  # metres; from there a view is as good as parallel
_PIXELS = 1024
_ASIDE = 0.4  # share of the half width that the middle of a back is taken from
_SEAM = 0.015  # metres over which the two halves of a back are blended


@dataclass(frozen=True, slots=True, eq=False)
class Twins:
    """For each vertex its twin on the front, as a point of the mesh; on a back, one for each half."""

    points: tuple[SurfacePoints, SurfacePoints]  # [V] each: as seen from the person's left half and the right one
    across: F64  # [V] metres to the person's left in the zero pose

    def colours(self, shot: FittedPicture, points: SurfacePoints, pattern: NDArray[np.bool_] | None = None) -> Sighted:
        """What the twins of the points show; a ``pattern`` [M] is on a back, too, which signs and ties are not."""
        side = points.at(self.across[:, None])[:, 0]
        share = (0.5 + side / (2 * _SEAM)).clip(0, 1)[:, None]
        left, right = (_half(shot, points, twin, pattern) for twin in self.points)
        mixed = share * left + (1 - share) * right
        length = np.maximum(np.linalg.norm(mixed[:, 3:6], axis=1, keepdims=True), 1e-9)
        return Sighted(mixed[:, :3], mixed[:, 3:6] / length, mixed[:, 6], mixed[:, 7], mixed[:, 8])


@dataclass(frozen=True, slots=True, eq=False)
class Sighted:
    """What M twins show."""

    linear: F64  # [M, 3] linear light
    normals: F64  # [M, 3] in the camera's axes
    trust: F64  # [M] from 0, hidden, to 1
    busy: F64  # [M] from 0, plain, to 1, full of detail
    known: F64  # [M] 1 where that picture shows them, 0 where it was continued


def _half(shot: FittedPicture, points: SurfacePoints, twin: SurfacePoints, pattern: NDArray[np.bool_] | None) -> F64:
    """[M, 9] colours, normals, trust, detail, and whether they are known."""
    layer = shot.layers_at(points)
    own = (shot.layer[twin.corners[:, 0]] == shot.layer)[:, None]  # no back has its colours from an arm before it
    vertices = np.hstack([twin.at(shot.view.pixels), twin.directions(shot.normals), twin.at(shot.shown[:, None]) * own])
    there = points.at(vertices)
    pixels = there[:, :2]
    colours = shot.sample(pixels, layer)
    away = points.directions(shot.normals)[:, 2] > 0
    if pattern is not None:
        away &= ~pattern
    colours[away] = shot.sample(pixels[away], layer[away], behind=True)
    return np.column_stack([colours, there[:, 2:], shot.detail(pixels, layer), shot.known(pixels, layer)])


def find_twins(mesh: RiggedMesh, trunk: NDArray[np.bool_]) -> Twins:
    """The twins of all vertices of a body in the zero pose; ``trunk`` [V] marks chest, belly and hips."""
    vertices = mesh.vertices
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    middle, size = (low + high) / 2, float((high - low)[:2].max()) * 1.02
    focal = _PIXELS * _FAR / size
    camera = Camera(
        look_at(middle + [0, 0, _FAR], middle),
        np.array([[focal, 0, _PIXELS / 2], [0, focal, _PIXELS / 2], [0, 0, 1]]),
        _PIXELS,
        _PIXELS,
    )
    ids, bary = visible_faces(mesh, vertices, camera)
    half = half_width(vertices, trunk)
    sides = []
    for sign in (1.0, -1.0):
        wanted = vertices.copy()
        wanted[trunk, 0] = sign * _ASIDE * half[trunk] + (1 - _ASIDE) * vertices[trunk, 0]
        at = wanted @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
        pixel = np.floor(at[:, :2] / at[:, 2:] * focal + _PIXELS / 2).astype(np.intp).clip(0, _PIXELS - 1)
        face = ids[pixel[:, 1], pixel[:, 0]]
        itself = np.repeat(np.arange(len(vertices))[:, None], 3, axis=1)  # the nearest thing on the outline
        corners = np.where(face[:, None] >= 0, mesh.faces[np.maximum(face, 0)], itself)
        weights = np.where(face[:, None] >= 0, bary[pixel[:, 1], pixel[:, 0]], 1 / 3)
        sides.append(SurfacePoints(corners, weights))
    whole = np.where(vertices[:, 0] < 0, -1.0, 1.0)  # limbs are not taken in halves
    return Twins((sides[0], sides[1]), np.where(trunk, vertices[:, 0], whole))
