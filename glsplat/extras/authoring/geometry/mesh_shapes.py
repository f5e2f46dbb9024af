"""Shapes of splats from the morph targets of a mesh: each splat moves and bends with its nearest triangle."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import trimesh
from numpy.typing import NDArray

from glsplat.arrays import F64
from glsplat.avatar import Avatar
from glsplat.extras.authoring.geometry.attribute_transfer import sorted_axes
from glsplat.extras.authoring.geometry.surface_points import NearestPoints, nearest_on, triangle_areas
from glsplat.meshes import Morphs, RiggedMesh
from glsplat.rotations import unit_vectors
from glsplat.skinning.shapes import Shapes
from glsplat.splats import Splats

_MIN_MOVE_M = 1e-4  # entries that move less are dropped, unless they bend
_MIN_BEND = 0.03  # change of a unit axis
_MAX_AREA_FACTOR = 6.0  # skin folded away at rest grows a hundredfold, and stays small
_MAX_DISTANCE_M = 0.03  # of a splat from the triangle that moves it


def with_shapes(avatar: Avatar, mesh: RiggedMesh, faces: NDArray[np.integer] | None = None) -> Avatar:
    """Return the avatar, and its levels, with the expressions of ``mesh``, on whose bind pose its splats lie.

    A splat follows its nearest triangle, or that of ``faces`` [N] where known: lips and lids touch at rest, so the
    nearest may be the wrong one. It keeps its offset from the triangle; its axes take the triangle's deformation.
    Splats farther than 3 cm from the mesh stay. Cones are dropped: they were made of a still face. Returns ``avatar``
    where the mesh has no expressions.
    """
    if mesh.morphs is None:
        return avatar
    levels = tuple(replace(level, content=with_shapes(level.content, mesh)) for level in avatar.levels)
    splats = replace(avatar.splats, cones=None, cones_psnr=None)
    return replace(avatar, splats=splats, shapes=shapes_of(avatar.splats, mesh, mesh.morphs, faces), levels=levels)


def body_morphs(body: RiggedMesh, points: F64) -> Morphs | None:
    """Return the expressions of ``body`` for ``points`` [V, 3]: those of the nearest surface point within 6 cm."""
    if body.morphs is None:
        return None
    if points.shape == body.vertices.shape and np.abs(points - body.vertices).max() < _MAX_DISTANCE_M:
        return body.morphs  # the same mesh in another shape: lips that touch stay apart
    _, distance, face, bary = nearest_on(body.vertices, body.faces, points)
    corners, near = body.faces[face], distance < 2 * _MAX_DISTANCE_M
    found = {}
    for name in body.morphs.names:
        offsets = body.morphs.dense(name, len(body.vertices))
        moved = np.einsum("nk,nkc->nc", bary, offsets[corners]) * near[:, None]
        rows = np.flatnonzero(np.abs(moved).max(axis=1) > 1e-6)
        found[name] = [(rows, moved[rows])]
    return Morphs.of(found)


def area_factors(mesh: RiggedMesh) -> F64:
    """Return each triangle's largest area over all expressions by its area at rest [F], clipped to 1 to 6."""
    out = np.ones(len(mesh.faces))
    if mesh.morphs is None:
        return out
    first = triangle_areas(mesh.vertices, mesh.faces)
    for name in mesh.morphs.names:
        offsets = mesh.morphs.dense(name, len(mesh.vertices))
        moves_vertex: NDArray[np.bool_] = np.any(offsets != 0, axis=1)
        mine = np.flatnonzero(np.any(moves_vertex[mesh.faces], axis=1))
        grown = triangle_areas(mesh.vertices + offsets, mesh.faces[mine]) / np.maximum(first[mine], 0.5e-12)
        out[mine] = np.maximum(out[mine], grown)
    return np.clip(out, 1, _MAX_AREA_FACTOR)


def shapes_of(splats: Splats, mesh: RiggedMesh, morphs: Morphs, faces: NDArray[np.integer] | None = None) -> Shapes:
    """Return the shapes that the ``morphs`` of ``mesh`` give ``splats`` on it; ``faces`` as for ``with_shapes``."""
    usable = splats.finite()
    means = np.where(usable[:, None], splats.means, 0).astype(np.float64)
    at, distance, face, bary = (
        nearest_on(mesh.vertices, mesh.faces, means) if faces is None else _on_faces(mesh, means, faces)
    )
    attached: NDArray[np.bool_] = np.logical_and(usable, distance < _MAX_DISTANCE_M)
    corners = mesh.faces[face]
    long_columns = sorted_axes(splats)[:, :, :2]
    rows, targets, moves, bends = [], [], [], []
    for target, name in enumerate(morphs.names):
        offsets = morphs.dense(name, len(mesh.vertices))
        moves_vertex: NDArray[np.bool_] = np.any(offsets != 0, axis=1)
        touched = np.flatnonzero(attached & np.any(moves_vertex[corners], axis=1))
        own = corners[touched]
        bend = _gradients(mesh.vertices[own], mesh.vertices[own] + offsets[own]) - np.eye(3)
        above = means[touched] - at[touched]
        move = np.einsum("nk,nkc->nc", bary[touched], offsets[own]) + np.einsum("nij,nj->ni", bend, above)
        turned = np.einsum("nij,njk->nki", bend, long_columns[touched])
        kept = (np.linalg.norm(move, axis=1) > _MIN_MOVE_M) | (np.abs(turned).max(axis=(1, 2)) > _MIN_BEND)
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


def _on_faces(mesh: RiggedMesh, points: F64, faces: NDArray[np.integer]) -> NearestPoints:
    """Return the nearest places on the triangles ``faces`` [N], one for each point."""
    corners = mesh.vertices[mesh.faces[faces]]
    at = trimesh.triangles.closest_point(corners, points)
    bary = np.nan_to_num(trimesh.triangles.points_to_barycentric(corners, at))
    return NearestPoints(at, np.linalg.norm(points - at, axis=1), faces.astype(np.intp), bary)


def _gradients(before: F64, after: F64) -> F64:
    """Return the maps [N, 3, 3] of two edges and the unit normal of triangles [N, 3, 3] to those they have after."""
    first, second = _frames(before), _frames(after)
    size = np.abs(np.linalg.det(first))
    usable = size > 1e-12
    out = np.tile(np.eye(3), (len(before), 1, 1))
    out[usable] = second[usable] @ np.linalg.inv(first[usable])
    return out


def _frames(corners: F64) -> F64:
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return np.stack([one, other, unit_vectors(np.cross(one, other), 1e-30)], axis=2)
