"""Where to look for a colour that no picture shows: the front of the person at the same place, seen through the body.

In the zero pose a person is flat enough from front to back that cloth, skin and shoes change at the same places on both
sides. The middle of a chest is not carried through: ties, buttons and open jackets have no counterpart on a back. A
pattern is carried through as straight and as wide as it is, but for a narrow strip that has the buttons.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera, look_at
from glsplat.extras.authoring.body.segments import trunk_half_width
from glsplat.extras.authoring.geometry.raster import visible_faces
from glsplat.extras.authoring.geometry.surface_points import SurfacePoints
from glsplat.extras.authoring.paint.view_sample import FittedPicture
from glsplat.meshes import RiggedMesh
from glsplat.rotations import lengths
from glsplat.skinning.smplx import JOINT_NAMES

__all__ = ["Front", "Sighted", "Twins", "find_twins"]

F64 = NDArray[np.float64]

_FAR = 60.0  # metres; from there a view is as good as parallel
_PIXELS = 1024
_ASIDE = 0.4  # share of the half width that the middle of a back is taken from
_STRIP = 0.12  # the same of a pattern, whose stripes would become as much wider
_COLLAR = -0.03, 0.06  # metres from the shoulder joints' height: between them a strip becomes as wide as it usually is
_SEAM = 0.015  # metres over which the two halves of a back are blended


@dataclass(frozen=True, slots=True, eq=False)
class Twins:
    """For each vertex its twin on the front, as a point of the mesh; on a back, one for each half."""

    points: tuple[SurfacePoints, SurfacePoints]  # [V] each: as seen from the person's left half and the right one
    straight: tuple[SurfacePoints, SurfacePoints]  # [V] the same of cloth with a pattern
    across: F64  # [V] metres to the person's left in the zero pose

    def colours(self, shot: FittedPicture, points: SurfacePoints, pattern: NDArray[np.bool_] | None = None) -> Sighted:
        """What the twins of the points show; a ``pattern`` [M] is on a back, too, which signs and ties are not."""
        share = (0.5 + points.at(self.across[:, None]) / (2 * _SEAM)).clip(0, 1)
        striped = np.zeros(len(share), bool) if pattern is None else pattern
        mixed = np.zeros((len(share), 9))
        for twins, cloth in ((self.points, ~striped), (self.straight, striped)):
            for twin, much in zip(twins, (share, 1 - share), strict=True):
                some = np.flatnonzero(cloth & (much[:, 0] > 0))  # few are between the halves
                if not len(some):
                    continue
                part = points.take(some)
                mixed[some] += much[some] * _half(shot, part, twin, twins is self.straight)
        length = np.maximum(lengths(mixed[:, 3:6])[:, None], 1e-9)
        return Sighted(mixed[:, :3], mixed[:, 3:6] / length, mixed[:, 6], mixed[:, 7], mixed[:, 8])


@dataclass(frozen=True, slots=True, eq=False)
class Sighted:
    """What M twins show."""

    linear: F64  # [M, 3] linear light
    normals: F64  # [M, 3] in the camera's axes
    trust: F64  # [M] from 0, hidden, to 1
    busy: F64  # [M] from 0, plain, to 1, full of detail
    known: F64  # [M] 1 where that picture shows them, 0 where it was continued


def _half(shot: FittedPicture, points: SurfacePoints, twin: SurfacePoints, striped: bool) -> F64:
    """[M, 9] colours, normals, trust, detail, and whether they are known."""
    layer = shot.layers_at(points)
    own = (shot.layer[twin.corners[:, 0]] == shot.layer)[:, None]  # no back has its colours from an arm before it
    vertices = np.hstack([twin.at(shot.view.pixels), twin.directions(shot.normals), twin.at(shot.shown[:, None]) * own])
    there = points.at(vertices)
    pixels = there[:, :2]
    colours = shot.sample(pixels, layer)
    if not striped:
        away = points.directions(shot.normals)[:, 2] > 0
        colours[away] = shot.sample(pixels[away], layer[away], behind=True)
    return np.column_stack([colours, there[:, 2:], shot.detail(pixels, layer), shot.known(pixels, layer)])


class Front:
    """The front of a body in the zero pose, as seen from far away."""

    def __init__(self, mesh: RiggedMesh) -> None:
        vertices = mesh.vertices
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        middle, size = (low + high) / 2, float((high - low)[:2].max()) * 1.02
        self._mesh, self._focal = mesh, _PIXELS * _FAR / size
        view = np.array([[self._focal, 0, _PIXELS / 2], [0, self._focal, _PIXELS / 2], [0, 0, 1]])
        self._camera = Camera(look_at(middle + [0, 0, _FAR], middle), view, _PIXELS, _PIXELS)
        self._ids, self._bary = visible_faces(mesh, vertices, self._camera)

    def points(self, wanted: F64) -> SurfacePoints:
        """[V] what is seen at places [V, 3], one a vertex; where nothing is, the vertex itself."""
        at = wanted @ self._camera.viewmat[:3, :3].T + self._camera.viewmat[:3, 3]
        pixel = np.floor(at[:, :2] / at[:, 2:] * self._focal + _PIXELS / 2).astype(np.intp).clip(0, _PIXELS - 1)
        face = self._ids[pixel[:, 1], pixel[:, 0]]
        itself = np.repeat(np.arange(len(wanted))[:, None], 3, axis=1)
        corners = np.where(face[:, None] >= 0, self._mesh.faces[np.maximum(face, 0)], itself)
        return SurfacePoints(corners, np.where(face[:, None] >= 0, self._bary[pixel[:, 1], pixel[:, 0]], 1 / 3))


def find_twins(mesh: RiggedMesh, trunk: NDArray[np.bool_], front: Front | None = None) -> Twins:
    """The twins of all vertices of a body in the zero pose; ``trunk`` [V] marks chest, belly and hips."""
    vertices, front = mesh.vertices, front or Front(mesh)
    half = trunk_half_width(vertices, trunk)
    even = np.full(len(half), np.median(half[trunk]) if trunk.any() else 0.0)  # straight stripes are straight behind
    sides = []
    for aside, width in ((_ASIDE, half), (_strip(mesh), even)):
        for sign in (1.0, -1.0):
            wanted = vertices.copy()
            across = np.clip(sign * aside * width + (1 - aside) * vertices[:, 0], -half, half)
            wanted[trunk, 0] = across[trunk]
            sides.append(front.points(wanted))
    whole = np.where(vertices[:, 0] < 0, -1.0, 1.0)  # limbs are not taken in halves
    return Twins((sides[0], sides[1]), (sides[2], sides[3]), np.where(trunk, vertices[:, 0], whole))


def _strip(mesh: RiggedMesh) -> F64:
    """[V] share of the half width that is left out of a pattern at a vertex's height."""
    shoulders = [JOINT_NAMES.index(f"{side}_shoulder") for side in ("left", "right")]
    above = mesh.vertices[:, 1] - mesh.skeleton.joints[shoulders, 1].mean()
    share = ((above - _COLLAR[0]) / (_COLLAR[1] - _COLLAR[0])).clip(0, 1)
    return np.asarray(_STRIP + share * (_ASIDE - _STRIP))
