"""The surface that an avatar's splats lie on: normals and occlusion of the mesh that they were made of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from glsplat.avatar import Avatar
from glsplat.extras.authoring.geometry.visibility import probe_poses
from glsplat.extras.authoring.light.ambient_occlusion import ambient_occlusion
from glsplat.extras.authoring.optimize.surface_consistency import view_consistent
from glsplat.light.surface import Surface
from glsplat.meshes import RiggedMesh, vertex_normals
from glsplat.rotations import signed_axes, unit_vectors
from glsplat.skinning.pose import Pose
from glsplat.splats import Splats

__all__ = ["Nearest", "nearest_open", "open_pose", "opened", "with_surface"]

F64 = NDArray[np.float64]

_SPACING = 0.004  # metres between points on triangles, at most so many of each
_MOST = 64
_CANDIDATES = 12  # nearest points, of which one is open and faces as the splat does
_SIDEWAYS, _HIDDEN = 0.004, 0.05  # metres that facing another way is worth, and lying inside (a mouth behind a cheek)
_COVERED = 0.012  # metres that seeing nothing of the sky is worth: cloth folded over itself has an inner side
_INSIDE = 0.1  # occlusion of what lies inside
_OWN = ("teeth", "tongue")  # parts that keep their own surface, wherever they lie
_DARKEST = 0.25  # occlusion at least: teeth are hidden while the mouth is shut, and not black when it opens


class Nearest:
    """For each of N splats the corners [N, 3] of the triangle it lies nearest to, and where on it [N, 3]."""

    def __init__(self, corners: NDArray[np.intp], weights: F64) -> None:
        self.corners, self.weights = corners, weights

    def at(self, values: F64) -> F64:
        """[N, ...] of values [V, ...] of the vertices."""
        flat = values.reshape(len(values), -1)
        return np.einsum("nk,nkc->nc", self.weights, flat[self.corners]).reshape(-1, *values.shape[1:])

    def directions(self, values: F64) -> F64:
        """[N, 3] at unit length; zero where those of the corners cancel."""
        return unit_vectors(self.at(values))


def nearest_open(mesh: RiggedMesh, splats: Splats, occlusion: F64) -> Nearest:
    """Where on the mesh (in the zero pose, as the splats are) each splat lies.

    Of layers that are near, the one that is open by the vertices' ``occlusion`` [V], and parallel to the splat.
    """
    vertices = mesh.posed(Pose.zero(len(mesh.skeleton)))
    faces = mesh.faces
    corner = vertices[faces]
    across = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    area = np.linalg.norm(across, axis=1) / 2
    face_normals = across / np.maximum(2 * area, 1e-20)[:, None]
    count = np.clip(np.ceil(area / _SPACING**2), 1, _MOST).astype(np.intp)
    which = np.repeat(np.arange(len(faces)), count)
    number = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
    root = np.sqrt((number + 0.5) / count[which])
    along = (number * 0.6180339887498949) % 1  # golden ratio: even over the triangle
    weights = np.where(
        (count[which] == 1)[:, None], 1 / 3, np.stack([1 - root, root * (1 - along), root * along], axis=1)
    )
    points = np.einsum("nk,nkc->nc", weights, corner[which])
    means = np.nan_to_num(splats.means.astype(np.float64), posinf=0, neginf=0)
    apart = np.repeat([part.name in _OWN for part in mesh.parts], [len(part.faces) for part in mesh.parts])
    arriving = occlusion[faces].mean(axis=1)
    inside = (arriving < _INSIDE) & ~apart
    far, near = _nearest(points, np.arange(len(points)), means)
    outer = np.flatnonzero(~inside[which])
    if 0 < len(outer) < len(points):  # what lies inside may have none but such about it
        far, near = (
            np.concatenate(both, axis=1) for both in zip((far, near), _nearest(points, outer, means), strict=True)
        )
    facing = np.abs(np.einsum("nkc,nc->nk", face_normals[which[near]], thin_axes(splats)))
    cost = far + _SIDEWAYS * (1 - facing) + _COVERED * (1 - arriving[which[near]]) + _HIDDEN * inside[which[near]]
    chosen = np.take_along_axis(near, cost.argmin(axis=1)[:, None], axis=1)[:, 0]
    return Nearest(faces[which[chosen]].astype(np.intp), _projected(means, corner[which[chosen]]))


def _nearest(points: F64, some: NDArray[np.intp], means: F64) -> tuple[F64, NDArray[np.intp]]:
    """[N, K] how far from the means the nearest of ``some`` points are, and which."""
    tree = cKDTree(points[some], compact_nodes=False, balanced_tree=False)  # in half the time
    far, near = tree.query(means, min(_CANDIDATES, len(some)), workers=-1)
    return far.reshape(len(means), -1), some[near.reshape(len(means), -1)]


def _projected(points: F64, corner: F64) -> F64:
    """[N, 3] barycentric coordinates of points [N, 3] laid onto their triangles [N, 3, 3], drawn in to their edges."""
    u, v, w = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0], points - corner[:, 0]
    uu, uv, vv, wu, wv = (np.einsum("nc,nc->n", a, b) for a, b in ((u, u), (u, v), (v, v), (w, u), (w, v)))
    area = np.maximum(uu * vv - uv * uv, 1e-24)
    second, third = (wu * vv - wv * uv) / area, (wv * uu - wu * uv) / area
    weights = np.clip(np.stack([1 - second - third, second, third], axis=1), 0, 1)
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


def opened(occlusion: F64) -> F64:
    """Occlusion that leaves hollows some light."""
    return np.maximum(occlusion, _DARKEST)


def thin_axes(splats: Splats) -> F64:
    """[N, 3] the shortest axis of each splat, of either sign; zero where it has none."""
    axes = signed_axes(np.nan_to_num(splats.quats), np.nan_to_num(splats.scales))
    thin = np.abs(np.nan_to_num(splats.scales)).argmin(axis=1)
    return np.asarray(np.take_along_axis(axes, thin[:, None, None], axis=2)[:, :, 0])


def open_pose(names: tuple[str, ...]) -> Pose:
    """The pose in which occlusion is measured: standing, with the arms half down, or the zero pose."""
    poses = probe_poses(names)
    return poses[1] if len(poses) > 1 else poses[0]


def with_surface(avatar: Avatar, mesh: RiggedMesh) -> Avatar:
    """The avatar with normals and occlusion of the ``mesh`` that it was made of; levels too. Its colours are albedo.

    Occlusion is of one pose, arms half down. A mesh's texture is taken for albedo: where it holds light, that stays.
    """
    pose = open_pose(mesh.skeleton.names)
    occlusion = ambient_occlusion(mesh, mesh.posed(pose))
    normals = vertex_normals(mesh.posed(Pose.zero(len(mesh.skeleton))), mesh.faces)

    def surfaced(one: Avatar) -> Avatar:
        where = nearest_open(mesh, one.splats, occlusion)
        seen = view_consistent(one, where.directions(normals), opened(where.at(occlusion)))
        surface = Surface.of(seen.normals, seen.occlusion)
        return replace(one, splats=replace(one.splats, surface=surface))

    levels = tuple(replace(level, content=surfaced(level.content)) for level in avatar.levels)
    return replace(surfaced(replace(avatar, levels=())), levels=levels)
