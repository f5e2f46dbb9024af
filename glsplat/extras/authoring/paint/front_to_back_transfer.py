"""Transfer colours from the front of a person to unseen surface at the same place, straight through the body.

In the zero pose a person is flat enough from front to back that cloth, skin and shoes change at the same places on both
sides. The middle of a chest is left out: ties, buttons and open jackets have no counterpart on a back. A pattern keeps
its width and direction; only a narrow strip with the buttons is left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera, look_at
from glsplat.extras.authoring.body.segments import trunk_half_width
from glsplat.extras.authoring.geometry.raster import visible_faces
from glsplat.extras.authoring.geometry.surface_points import SurfacePoints
from glsplat.extras.authoring.paint.ramps import ramp
from glsplat.extras.authoring.paint.view_sample import FittedPicture
from glsplat.meshes import RiggedMesh
from glsplat.rotations import lengths
from glsplat.skinning.smplx import JOINT_NAMES

__all__ = ["Front", "FrontMatches", "TransferredColours", "match_to_front"]

F64 = NDArray[np.float64]

_CAMERA_DISTANCE_M = 60.0  # nearly parallel rays
_VIEW_SIZE_PX = 1024
# half of the strip left out of the middle of a chest, over the half width; a wide one would stretch stripes
_SKIPPED_FRACTION = 0.4
_SKIPPED_PATTERN_FRACTION = 0.12
_COLLAR_M = -0.03, 0.06  # above the shoulder joints: the pattern's strip widens to the usual one
_SEAM_M = 0.015  # over which the two halves of a back are blended


@dataclass(frozen=True, slots=True, eq=False)
class FrontMatches:
    """For each vertex its match on the front, as a point of the mesh; on a back, one for each half."""

    points: tuple[SurfacePoints, SurfacePoints]  # [V] each: from the person's left and right half
    straight: tuple[SurfacePoints, SurfacePoints]  # [V] the same for cloth with a pattern
    across: F64  # [V] metres to the person's left in the zero pose

    def colours(
        self, shot: FittedPicture, points: SurfacePoints, pattern: NDArray[np.bool_] | None = None
    ) -> TransferredColours:
        """Return the front's colours for the points; where ``pattern`` [M], the chest's print is taken, too."""
        share = (0.5 + points.at(self.across[:, None]) / (2 * _SEAM_M)).clip(0, 1)
        striped = np.zeros(len(share), bool) if pattern is None else pattern
        mixed = np.zeros((len(share), 9))
        for matches, chosen in ((self.points, ~striped), (self.straight, striped)):
            for match, weight in zip(matches, (share, 1 - share), strict=True):
                some = np.flatnonzero(chosen & (weight[:, 0] > 0))  # few are between the halves
                if not len(some):
                    continue
                part = points.take(some)
                mixed[some] += weight[some] * _sample_matches(shot, part, match, matches is self.straight)
        length = np.maximum(lengths(mixed[:, 3:6])[:, None], 1e-9)
        return TransferredColours(mixed[:, :3], mixed[:, 3:6] / length, mixed[:, 6], mixed[:, 7], mixed[:, 8])


@dataclass(frozen=True, slots=True, eq=False)
class TransferredColours:
    """Colours of the front at the matches of M points."""

    linear: F64  # [M, 3] linear light
    normals: F64  # [M, 3] in the camera's axes
    visibility: F64  # [M] from 0, hidden, to 1
    detail: F64  # [M] from 0, plain, to 1, full of detail
    known: F64  # [M] 1 where the picture shows the match, 0 where it was filled in


def _sample_matches(shot: FittedPicture, points: SurfacePoints, match: SurfacePoints, striped: bool) -> F64:
    """Return [M, 9] colours, normals, visibility, detail, and whether the picture shows them."""
    layer = shot.layers_at(points)
    own = (shot.layer[match.corners[:, 0]] == shot.layer)[:, None]  # arms in front of a trunk do not colour its back
    visible = match.at(shot.visible[:, None]) * own
    there = points.at(np.hstack([match.at(shot.view.pixels), match.directions(shot.normals), visible]))
    pixels = there[:, :2]
    colours = shot.sample(pixels, layer)
    if not striped:
        away = points.directions(shot.normals)[:, 2] > 0
        colours[away] = shot.sample(pixels[away], layer[away], without_prints=True)
    return np.column_stack([colours, there[:, 2:], shot.detail(pixels, layer), shot.shows_layer(pixels, layer)])


class Front:
    """The front of a body in the zero pose, from a distant camera."""

    def __init__(self, mesh: RiggedMesh) -> None:
        vertices = mesh.vertices
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        middle, size = (low + high) / 2, float((high - low)[:2].max()) * 1.02
        self._mesh, self._focal = mesh, _VIEW_SIZE_PX * _CAMERA_DISTANCE_M / size
        view = np.array([[self._focal, 0, _VIEW_SIZE_PX / 2], [0, self._focal, _VIEW_SIZE_PX / 2], [0, 0, 1]])
        self._camera = Camera(look_at(middle + [0, 0, _CAMERA_DISTANCE_M], middle), view, _VIEW_SIZE_PX, _VIEW_SIZE_PX)
        self._ids, self._bary = visible_faces(mesh, vertices, self._camera)

    def points(self, places: F64) -> SurfacePoints:
        """Return [V] the visible surface at places [V, 3], one for each vertex; the vertex itself where none is."""
        at = places @ self._camera.viewmat[:3, :3].T + self._camera.viewmat[:3, 3]
        pixel = np.floor(at[:, :2] / at[:, 2:] * self._focal + _VIEW_SIZE_PX / 2).astype(np.intp)
        pixel = pixel.clip(0, _VIEW_SIZE_PX - 1)
        face = self._ids[pixel[:, 1], pixel[:, 0]]
        own_vertex = np.repeat(np.arange(len(places))[:, None], 3, axis=1)
        corners = np.where(face[:, None] >= 0, self._mesh.faces[np.maximum(face, 0)], own_vertex)
        return SurfacePoints(corners, np.where(face[:, None] >= 0, self._bary[pixel[:, 1], pixel[:, 0]], 1 / 3))


def match_to_front(mesh: RiggedMesh, trunk: NDArray[np.bool_], front: Front | None = None) -> FrontMatches:
    """Return the matches of all vertices of a body in the zero pose; ``trunk`` [V] is chest, belly and hips."""
    vertices, front = mesh.vertices, front or Front(mesh)
    half = trunk_half_width(vertices, trunk)
    # one width for all heights, so that straight stripes stay straight on the back
    even = np.full(len(half), np.median(half[trunk]) if trunk.any() else 0.0)
    sides = []
    for skipped, width in ((_SKIPPED_FRACTION, half), (_skipped_fraction(mesh), even)):
        for sign in (1.0, -1.0):
            places = vertices.copy()
            across = np.clip(sign * skipped * width + (1 - skipped) * vertices[:, 0], -half, half)
            places[trunk, 0] = across[trunk]
            sides.append(front.points(places))
    limb_side = np.where(vertices[:, 0] < 0, -1.0, 1.0)  # limbs are not split in halves
    return FrontMatches((sides[0], sides[1]), (sides[2], sides[3]), np.where(trunk, vertices[:, 0], limb_side))


def _skipped_fraction(mesh: RiggedMesh) -> F64:
    """Return [V] the fraction of the half width left out of a pattern at each vertex's height."""
    shoulders = [JOINT_NAMES.index(f"{side}_shoulder") for side in ("left", "right")]
    above = mesh.vertices[:, 1] - mesh.skeleton.joints[shoulders, 1].mean()
    return np.asarray(
        _SKIPPED_PATTERN_FRACTION + ramp(above, *_COLLAR_M) * (_SKIPPED_FRACTION - _SKIPPED_PATTERN_FRACTION)
    )
