"""Transfer colours from the front of a person to unseen surface at the same place, straight through the body.

In the zero pose a person is flat enough from front to back that cloth, skin and shoes change at the same places on both
sides. On a trunk's flanks the front goes on as in a mirror. A narrow strip in the middle of the front, with buttons,
is left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera, look_at
from glsplat.extras.authoring.geometry.raster import visible_faces
from glsplat.extras.authoring.geometry.surface_points import SurfacePoints
from glsplat.extras.authoring.paint.picture_layers.fill import nearest_known
from glsplat.extras.authoring.paint.ramps import ramp
from glsplat.extras.authoring.paint.view_sample import FittedPicture
from glsplat.meshes import RiggedMesh
from glsplat.rotations import lengths
from glsplat.skinning.smplx import JOINT_NAMES

F64 = NDArray[np.float64]

_CAMERA_DISTANCE_M = 60.0  # nearly parallel rays
_VIEW_SIZE_PX = 1024
# half of the strip left out of the middle of a chest and of a collar, over the half width; wide ones stretch stripes
_SKIPPED_FRACTION, _SKIPPED_COLLAR_FRACTION = 0.12, 0.4
_LAST_RAD = np.radians(60)  # around the trunk from the middle of the front: seen well up to here
_ROW_M = 0.03
# above the shoulder joints: more is left out; from the shoulders to the armpits
_COLLAR_M, _ARMPIT_M = (-0.03, 0.06), (-0.06, -0.12)
_SEAM_M = 0.015  # over which the two halves of a back are blended


@dataclass(frozen=True, slots=True, eq=False)
class FrontMatches:
    """For each vertex its match on the front, as a point of the mesh; on a back, one for each half."""

    points: tuple[SurfacePoints, SurfacePoints]  # [V] each: from the person's left and right half
    across: F64  # [V] metres to the person's left in the zero pose

    def colours(self, shot: FittedPicture, points: SurfacePoints) -> TransferredColours:
        """Return the front's colours for the points."""
        share = (0.5 + points.at(self.across[:, None]) / (2 * _SEAM_M)).clip(0, 1)
        mixed = np.zeros((len(share), 10))
        for match, weight in zip(self.points, (share, 1 - share), strict=True):
            some = np.flatnonzero(weight[:, 0] > 0)  # few are between the halves
            if len(some):
                mixed[some] += weight[some] * _sample_matches(shot, points.take(some), match)
        length = np.maximum(lengths(mixed[:, 3:6])[:, None], 1e-9)
        return TransferredColours(mixed[:, :3], mixed[:, 3:6] / length, *mixed[:, 6:].T)


@dataclass(frozen=True, slots=True, eq=False)
class TransferredColours:
    """Colours of the front at the matches of M points."""

    linear: F64  # [M, 3] linear light
    normals: F64  # [M, 3] in the camera's axes
    visibility: F64  # [M] from 0, hidden, to 1
    detail: F64  # [M] from 0, plain, to 1, full of detail
    known: F64  # [M] 1 where the picture shows the match, 0 where it was filled in
    relief: F64  # [M] ``relief_of`` the match


def _sample_matches(shot: FittedPicture, points: SurfacePoints, match: SurfacePoints) -> F64:
    """Return [M, 10] the fields of ``TransferredColours``."""
    layer = shot.layers_at(points)
    own = (shot.layer[match.corners[:, 0]] == shot.layer)[:, None]  # arms in front of a trunk do not colour its back
    visible = match.at(shot.visible[:, None]) * own
    there = points.at(np.hstack([match.at(shot.view.pixels), match.directions(shot.normals), visible]))
    pixels = there[:, :2]
    fine = shot.detail(pixels, layer), shot.shows_layer(pixels, layer), shot.relief(pixels, layer)
    return np.column_stack([shot.sample(pixels, layer), there[:, 2:], *fine])


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
        self._nearest = nearest_known(self._ids >= 0)

    def points(self, places: F64) -> SurfacePoints:
        """Return [V] the visible surface at places [V, 3], or the nearest one."""
        at = places @ self._camera.viewmat[:3, :3].T + self._camera.viewmat[:3, 3]
        pixel = np.floor(at[:, :2] / at[:, 2:] * self._focal + _VIEW_SIZE_PX / 2).astype(np.intp)
        pixel = pixel.clip(0, _VIEW_SIZE_PX - 1)
        row, column = (each[pixel[:, 1], pixel[:, 0]] for each in self._nearest)
        return SurfacePoints(self._mesh.faces[self._ids[row, column]].astype(np.intp), self._bary[row, column])


def match_to_front(mesh: RiggedMesh, trunk: NDArray[np.bool_], front: Front | None = None) -> FrontMatches:
    """Return the matches of all vertices of a body in the zero pose; ``trunk`` [V] is chest, belly and hips."""
    vertices, front = mesh.vertices, front or Front(mesh)
    angle, away, half = _around(vertices, trunk)
    # the front's flank goes on as in a mirror, and back again to where the front is straight through the body
    turned = np.where(angle > np.pi - _LAST_RAD, np.pi - angle, 2 * _LAST_RAD - np.pi / 2 + np.abs(angle - np.pi / 2))
    above = _above_shoulders(mesh)
    skipped = _SKIPPED_FRACTION + ramp(above, *_COLLAR_M) * (_SKIPPED_COLLAR_FRACTION - _SKIPPED_FRACTION)
    # shoulders are flat
    round_share, straight = ramp(above, *_ARMPIT_M), np.abs(vertices[:, 0])
    across = skipped * half + (1 - skipped) * (straight + round_share * (away * np.sin(turned) - straight))
    hidden, sides = trunk & (angle > _LAST_RAD), []
    for sign in (1.0, -1.0):
        places = vertices.copy()
        places[hidden, 0] = sign * across[hidden]
        sides.append(front.points(places))
    limb_side = np.where(vertices[:, 0] < 0, -1.0, 1.0)  # limbs are not split in halves
    return FrontMatches((sides[0], sides[1]), np.where(trunk, vertices[:, 0], limb_side))


def _around(vertices: F64, trunk: NDArray[np.bool_]) -> tuple[F64, F64, F64]:
    """Return [V] angles around the ``trunk``, 0 in front to pi, distances from its middle, and half widths, metres.

    The trunk counts as round: depths are stretched to its width.
    """
    if not trunk.any():
        return (np.zeros(len(vertices)),) * 3
    row = np.round(vertices[trunk, 1] / _ROW_M).astype(np.intp)
    low = row.min()
    ends = []
    for size in (np.abs(vertices[trunk, 0]), vertices[trunk, 2], -vertices[trunk, 2]):
        most = np.full(int(row.max() - low) + 1, -np.inf)
        np.maximum.at(most, row - low, size)
        known = np.flatnonzero(np.isfinite(most))
        ends.append(np.interp(vertices[:, 1] / _ROW_M - low, known, most[known]))
    half, before, behind = ends
    depth = vertices[:, 2] - (before - behind) / 2
    across, depth = np.abs(vertices[:, 0]), depth * half / np.maximum((before + behind) / 2, 1e-3)
    return np.arctan2(across, depth), np.hypot(across, depth), half


def _above_shoulders(mesh: RiggedMesh) -> F64:
    """Return [V] metres above the shoulder joints."""
    shoulders = [JOINT_NAMES.index(f"{side}_shoulder") for side in ("left", "right")]
    return np.asarray(mesh.vertices[:, 1] - mesh.skeleton.joints[shoulders, 1].mean())
