"""Shapes and surfaces of splats: from the morph targets of a mesh, or from those of other splats.

A splat moves and bends with its nearest triangle. Merged splats, and splats that a fit has moved, take over shapes and
surfaces of those before.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from glsplat.arrays import F64
from glsplat.avatar import Avatar
from glsplat.extras.authoring.geometry.surface_points import NearestPoints, nearest_on, triangle_areas
from glsplat.light.surface import Surface
from glsplat.meshes import Morphs, RiggedMesh
from glsplat.rotations import quaternion_matrices, unit_vectors
from glsplat.skinning.shapes import BEND, Shapes, long_axes
from glsplat.splats import Splats

_MIN_MOVE_M = 1e-4  # entries that move less are dropped, unless they bend
_MIN_BEND = 0.03  # change of a unit axis
_MAX_AREA_FACTOR = 6.0  # skin folded away at rest grows a hundredfold, and stays small
_MAX_DISTANCE_M = 0.03  # of a splat from the triangle that moves it
_MAX_SOURCES = 4  # finer splats averaged into a coarser one's surface


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


def merged_shapes(shapes: Shapes, splats: Splats, label: NDArray[np.intp], weight: F64, made: Splats) -> Shapes:
    """Return the shapes of merged splats ``made``: means over the ``splats`` [N] of each ``label`` [N].

    The means are weighted by ``weight`` [N]. Bends are averaged as deformation gradients and applied to the axes of
    ``made``.
    """
    rows, count = shapes.rows, len(shapes)
    total = np.bincount(label, weight, len(made))
    keys, place = np.unique(label[rows] * count + shapes.targets, return_inverse=True)
    share = weight[rows] / total[label[rows]]
    values = np.concatenate([shapes.metres, _bend_gradients(shapes, splats).reshape(-1, 9)], axis=1) * share[:, None]
    summed: F64 = np.zeros((len(keys), 12))
    np.add.at(summed, place, values)
    of = keys // count
    bends = _bends(summed[:, 3:].reshape(-1, 3, 3), made, of)
    return Shapes.create(
        shapes.names, len(made), splats=of, targets=keys % count, moves=summed[:, :3], bends=bends, limits=shapes.limits
    )


def transferred_shapes(shapes: Shapes, before: Splats, after: Splats) -> Shapes:
    """Return ``shapes`` for ``after``: the splats ``before`` in the same order, moved a little, turned and scaled."""
    rows, gradients = shapes.rows, _bend_gradients(shapes, before)
    shift = after.means.astype(np.float64) - before.means
    moves = shapes.metres + np.einsum("eij,ej->ei", gradients, np.where(np.isfinite(shift), shift, 0)[rows])
    return Shapes.create(
        shapes.names,
        len(after),
        splats=rows,
        targets=shapes.targets,
        moves=moves,
        bends=_bends(gradients, after, rows),
        limits=shapes.limits,
    )


def expression_maps(shapes: Shapes, splats: Splats, weights: F64) -> tuple[F64, F64]:
    """Return the affine map x -> B x + t of an expression at each splat: B [N, 3, 3] and t [N, 3] in metres.

    ``weights`` [T] are those of the targets.
    """
    rows, share = shapes.rows, weights[shapes.targets]
    active = np.flatnonzero(share)
    bend = np.tile(np.eye(3), (len(splats), 1, 1))
    move = np.zeros((len(splats), 3))
    np.add.at(bend, rows[active], _bend_gradients(shapes, splats)[active] * share[active, None, None])
    np.add.at(move, rows[active], shapes.metres[active].astype(np.float64) * share[active, None])
    means = np.where(np.isfinite(splats.means), splats.means, 0).astype(np.float64)
    return bend, move - np.einsum("nij,nj->ni", bend - np.eye(3), means)


def transferred_surface(surface: Surface | None, before: Splats, after: Splats) -> Surface | None:
    """Return the surface of ``after``: for each splat the mean over the nearest splats of ``before``.

    The mean is over len(before) / len(after) splats, 1 to 4. None without a surface or without a finite splat.
    """
    usable = np.flatnonzero(before.finite())
    if surface is None or not len(usable):
        return None
    k = int(np.clip(round(len(before) / max(len(after), 1)), 1, min(_MAX_SOURCES, len(usable))))
    means = np.nan_to_num(after.means.astype(np.float64), posinf=0, neginf=0)
    near = usable[cKDTree(before.means[usable].astype(np.float64)).query(means, k)[1].reshape(len(means), k)]
    normals = unit_vectors(surface.units[near].sum(axis=1))
    shade = None if surface.shade is None else np.exp2(np.log2(surface.shades[near]).mean(axis=1))
    return Surface.of(normals, surface.ao[near].mean(axis=1), shade)


def _bend_gradients(shapes: Shapes, splats: Splats) -> F64:
    """Return the deformation gradients less the identity [E, 3, 3]; the normal stays perpendicular to both axes."""
    axes = sorted_axes(splats)[shapes.rows]
    one, other, normal = axes[:, :, 0], axes[:, :, 1], axes[:, :, 2]
    first, second = (shapes.bends[:, k] * BEND for k in (0, 1))
    lean = -np.einsum("ei,ei->e", first, normal)[:, None] * one - np.einsum("ei,ei->e", second, normal)[:, None] * other
    return np.asarray(np.einsum("kei,kej->eij", np.stack([first, second, lean]), np.stack([one, other, normal])))


def _bends(gradients: F64, splats: Splats, rows: NDArray[np.integer]) -> F64:
    return np.asarray(np.einsum("eij,ejk->eki", gradients, sorted_axes(splats)[rows][:, :, :2]))


def sorted_axes(splats: Splats) -> F64:
    """Return the two long axes and the thin one, as columns [N, 3, 3]."""
    finite = np.asarray(np.isfinite(splats.quats).all(axis=1))[:, None]
    axes = quaternion_matrices(np.where(finite, splats.quats, (1, 0, 0, 0)))
    return np.take_along_axis(axes, long_axes(splats.scales)[:, None, :], axis=2)
