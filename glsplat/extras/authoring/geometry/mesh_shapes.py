"""Shapes of splats from the morph targets of a mesh: each splat rides the nearest triangle, and bends as that does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import trimesh
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.extras.authoring.geometry.nearest import NearestPoints, nearest_on
from glsplat.extras.authoring.geometry.surface_points import triangle_areas
from glsplat.meshes import Morphs, RiggedMesh
from glsplat.rotations import quaternion_matrices, unit_vectors
from glsplat.skinning.shapes import Shapes, long_axes
from glsplat.splats import Splats

__all__ = ["body_morphs", "shapes_of", "unfolded", "with_shapes"]

F64 = NDArray[np.float64]

_LEAST = 1e-4  # metres; what moves a splat less is left out
_LEAST_BEND = 0.03  # of an axis of length one
_STRETCH = 6.0  # times; what is folded away at rest may grow a hundredfold, and is small all the same
_REACH = 0.03  # metres from the surface within which a splat rides it


def with_shapes(avatar: Avatar, mesh: RiggedMesh, faces: NDArray[np.integer] | None = None) -> Avatar:
    """The avatar, whose splats lie on ``mesh`` as it was bound, with the mesh's expressions; its levels too.

    A splat follows the triangle nearest to it, or that of ``faces`` [N] where it is known (lips and lids touch at
    rest, and the nearest may be the other one's); it lies before it as it did, and its axes take the triangle's
    deformation. Splats farther than 3 cm from the mesh stay. Cones are left out: they were made of a still face. The
    avatar itself where the mesh has no expressions.
    """
    if mesh.morphs is None:
        return avatar
    levels = tuple(replace(level, content=with_shapes(level.content, mesh)) for level in avatar.levels)
    splats = replace(avatar.splats, cones=None, cones_psnr=None)
    return replace(avatar, splats=splats, shapes=shapes_of(avatar.splats, mesh, mesh.morphs, faces), levels=levels)


def body_morphs(body: RiggedMesh, points: F64) -> Morphs | None:
    """The expressions of ``body`` for ``points`` [V, 3] near its surface: what the nearest point of it does."""
    if body.morphs is None:
        return None
    if points.shape == body.vertices.shape and np.abs(points - body.vertices).max() < _REACH:
        return body.morphs  # the same mesh in another shape: lips that touch are told apart
    _, distance, face, bary = nearest_on(body.vertices, body.faces, points)
    corners, near = body.faces[face], distance < 2 * _REACH
    found = {}
    for name in body.morphs.names:
        offsets = body.morphs.dense(name, len(body.vertices))
        moved = np.einsum("nk,nkc->nc", bary, offsets[corners]) * near[:, None]
        rows = np.flatnonzero(np.abs(moved).max(axis=1) > 1e-6)
        found[name] = [(rows, moved[rows])]
    return Morphs.of(found)


def unfolded(mesh: RiggedMesh) -> F64:
    """[F] how many times larger each triangle becomes in the expression that stretches it most, from 1 to 6."""
    out = np.ones(len(mesh.faces))
    if mesh.morphs is None:
        return out
    first = triangle_areas(mesh.vertices, mesh.faces)
    for name in mesh.morphs.names:
        offsets = mesh.morphs.dense(name, len(mesh.vertices))
        stirs: NDArray[np.bool_] = np.any(offsets != 0, axis=1)
        mine = np.flatnonzero(np.any(stirs[mesh.faces], axis=1))
        grown = triangle_areas(mesh.vertices + offsets, mesh.faces[mine]) / np.maximum(first[mine], 0.5e-12)
        out[mine] = np.maximum(out[mine], grown)
    return np.clip(out, 1, _STRETCH)


def shapes_of(splats: Splats, mesh: RiggedMesh, morphs: Morphs, faces: NDArray[np.integer] | None = None) -> Shapes:
    """What the ``morphs`` of ``mesh`` make of ``splats`` on it; ``faces`` as for ``with_shapes``."""
    usable = splats.finite()
    means = np.where(usable[:, None], splats.means, 0).astype(np.float64)
    at, distance, face, bary = (
        nearest_on(mesh.vertices, mesh.faces, means) if faces is None else _placed(mesh, means, faces)
    )
    rides: NDArray[np.bool_] = np.logical_and(usable, distance < _REACH)
    corners = mesh.faces[face]
    axes = quaternion_matrices(np.where(usable[:, None], splats.quats, (1, 0, 0, 0)))
    order = long_axes(splats.scales)
    long_ones = np.take_along_axis(axes, order[:, None, :2], axis=2)  # [N, 3, 2]
    rows, targets, moves, bends = [], [], [], []
    for target, name in enumerate(morphs.names):
        offsets = morphs.dense(name, len(mesh.vertices))
        stirs: NDArray[np.bool_] = np.any(offsets != 0, axis=1)
        touched = np.flatnonzero(rides & np.any(stirs[corners], axis=1))
        own = corners[touched]
        bend = _deformed(mesh.vertices[own], mesh.vertices[own] + offsets[own]) - np.eye(3)
        above = means[touched] - at[touched]
        move = np.einsum("nk,nkc->nc", bary[touched], offsets[own]) + np.einsum("nij,nj->ni", bend, above)
        turned = np.einsum("nij,njk->nki", bend, long_ones[touched])
        kept = (np.linalg.norm(move, axis=1) > _LEAST) | (np.abs(turned).max(axis=(1, 2)) > _LEAST_BEND)
        rows.append(touched[kept])
        targets.append(np.full(int(kept.sum()), target))
        moves.append(move[kept])
        bends.append(turned[kept])
    return Shapes.create(
        morphs.names,
        len(splats),
        splats=np.concatenate(rows),
        targets=np.concatenate(targets),
        moves=np.concatenate(moves),
        bends=np.concatenate(bends),
    )


def _placed(mesh: RiggedMesh, points: F64, faces: NDArray[np.integer]) -> NearestPoints:
    """As ``nearest_on``, on triangles that are known [N]."""
    corners = mesh.vertices[mesh.faces[faces]]
    at = trimesh.triangles.closest_point(corners, points)
    bary = np.nan_to_num(trimesh.triangles.points_to_barycentric(corners, at))
    return NearestPoints(at, np.linalg.norm(points - at, axis=1), faces.astype(np.intp), bary)


def _deformed(before: F64, after: F64) -> F64:
    """[N, 3, 3] what takes two edges and the unit normal of each triangle [N, 3, 3] to those it has after."""
    first, second = _frames(before), _frames(after)
    size = np.abs(np.linalg.det(first))
    usable = size > 1e-12
    out = np.tile(np.eye(3), (len(before), 1, 1))
    out[usable] = second[usable] @ np.linalg.inv(first[usable])
    return out


def _frames(corners: F64) -> F64:
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return np.stack([one, other, unit_vectors(np.cross(one, other), 1e-30)], axis=2)
