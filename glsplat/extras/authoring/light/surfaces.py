"""Give an avatar's splats the surface they lie on: normals and ambient occlusion of the mesh they were made from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from glsplat.arrays import F64
from glsplat.avatar import Avatar
from glsplat.camera import Camera, look_at
from glsplat.extras.authoring.compute.threads import map_threads
from glsplat.extras.authoring.geometry.raster import depth_range
from glsplat.extras.authoring.geometry.surface_points import SurfacePoints
from glsplat.extras.authoring.geometry.visibility import probe_poses, sphere
from glsplat.extras.authoring.optimize.surface_consistency import view_consistent
from glsplat.light.surface import Surface
from glsplat.meshes import RiggedMesh, vertex_normals
from glsplat.rotations import signed_axes
from glsplat.skinning.pose import Pose
from glsplat.splats import Splats

Bools = NDArray[np.bool_]

_DIRECTIONS = 48
_CAMERA_DISTANCE_M = 60.0  # nearly parallel rays
_DEPTH_MAP_PX = 320
_SMOOTHING_ROUNDS = 5
_NORMAL_BIAS_M = 0.012  # moves a point off its own surface
_DEPTH_TOLERANCE_M = 0.004  # behind the nearest surface
_MARGIN_M = 0.05  # around the mesh in a depth map
_POINT_SPACING_M, _MAX_POINTS = 0.004, 64  # on triangles; points of one triangle
_CANDIDATES = 12  # nearest points, of which the open and parallel ones are preferred
# metres of distance that count as much: facing another way, and lying inside (a mouth behind a cheek)
_SIDEWAYS_COST_M, _INSIDE_COST_M = 0.004, 0.05
_OCCLUDED_COST_M = 0.012  # fully occluded: cloth folded over itself has an inner side
_MAX_INSIDE_OCCLUSION = 0.1
_OWN_SURFACE_PARTS = ("teeth", "tongue")
_MIN_OCCLUSION = 0.25  # teeth are hidden in a shut mouth, and must not be black when it opens


def ambient_occlusion(mesh: RiggedMesh, vertices: F64, directions: int = _DIRECTIONS) -> F64:
    """Return [V] from 0, hidden, to 1, open, for a mesh whose ``vertices`` [V, 3] are posed; deterministic.

    Two opposite directions, of a Fibonacci lattice over the upper half, share one depth map; a vertex is tested
    slightly off its surface.
    """
    normals = vertex_normals(vertices, mesh.faces)
    arriving, whole = np.zeros(len(vertices)), np.zeros(len(vertices))
    sky = sphere(directions)[: directions // 2]
    for direction, both in zip(sky, map_threads(lambda way: _lit_from(mesh, vertices, way, normals), sky), strict=True):
        for way, lit in zip((direction, -direction), both, strict=True):
            cosine = np.maximum(normals @ way, 0)
            arriving += cosine * lit
            whole += cosine
    return _smoothed(mesh, np.asarray(arriving / np.maximum(whole, 1e-9)))


def _smoothed(mesh: RiggedMesh, values: F64) -> F64:
    """Return ``values`` [V] averaged over the surface: depth maps are coarser than a triangle."""
    faces = mesh.faces
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    ends = np.concatenate([ends, ends[:, ::-1]])
    near = csr_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(len(values),) * 2)
    degree = np.maximum(np.asarray(near.sum(axis=1)).ravel(), 1)
    for _ in range(_SMOOTHING_ROUNDS):
        values = 0.5 * values + 0.5 * (near @ values) / degree
    return values


def _lit_from(mesh: RiggedMesh, vertices: F64, direction: F64, normals: F64) -> tuple[Bools, Bools]:
    """Return [V] whether distant light from the unit ``direction`` [3], or the opposite one, reaches each vertex."""
    size, middle = _DEPTH_MAP_PX, (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    radius = float(np.linalg.norm(vertices - middle, axis=1).max()) + _MARGIN_M
    focal = size / 2 * _CAMERA_DISTANCE_M / radius
    K = np.array([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1]])
    camera = Camera(look_at(middle + _CAMERA_DISTANCE_M * direction, middle), K, size, size)
    nearest, farthest = depth_range(mesh, vertices, camera)
    where = (vertices + _NORMAL_BIAS_M * normals) @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
    column, row = np.floor(focal * where[:, :2] / where[:, 2:] + size / 2).astype(np.intp).clip(0, size - 1).T
    depth = where[:, 2]
    return nearest[row, column] > depth - _DEPTH_TOLERANCE_M, farthest[row, column] < depth + _DEPTH_TOLERANCE_M


def locate_splats(mesh: RiggedMesh, splats: Splats, occlusion: F64) -> SurfacePoints:
    """Return the place of each splat on its nearest triangle of the mesh in the zero pose.

    Among near layers it prefers those that are open, by the vertices' ``occlusion`` [V], and parallel to the splat.
    """
    vertices = mesh.posed(Pose.zero(len(mesh.skeleton)))
    faces = mesh.faces
    corner = vertices[faces]
    across = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    area = np.linalg.norm(across, axis=1) / 2
    face_normals = across / np.maximum(2 * area, 1e-20)[:, None]
    count = np.clip(np.ceil(area / _POINT_SPACING_M**2), 1, _MAX_POINTS).astype(np.intp)
    triangle = np.repeat(np.arange(len(faces)), count)
    number = np.arange(len(triangle)) - np.repeat(np.cumsum(count) - count, count)
    root = np.sqrt((number + 0.5) / count[triangle])
    along = (number * 0.6180339887498949) % 1  # golden ratio: even over the triangle
    weights = np.where(
        (count[triangle] == 1)[:, None], 1 / 3, np.stack([1 - root, root * (1 - along), root * along], axis=1)
    )
    points = np.einsum("nk,nkc->nc", weights, corner[triangle])
    means = np.nan_to_num(splats.means.astype(np.float64), posinf=0, neginf=0)
    own = [part.name in _OWN_SURFACE_PARTS for part in mesh.parts]
    apart = np.repeat(own, [len(part.faces) for part in mesh.parts])
    openness = occlusion[faces].mean(axis=1)
    inside = (openness < _MAX_INSIDE_OCCLUSION) & ~apart
    distance, near = _nearest_points(points, np.arange(len(points)), means)
    outer = np.flatnonzero(~inside[triangle])
    if 0 < len(outer) < len(points):  # splats inside may have only inner points near
        more = _nearest_points(points, outer, means)
        distance, near = (np.concatenate(both, axis=1) for both in zip((distance, near), more, strict=True))
    facing = np.abs(np.einsum("nkc,nc->nk", face_normals[triangle[near]], _thin_axes(splats)))
    cost = (
        distance
        + _SIDEWAYS_COST_M * (1 - facing)
        + _OCCLUDED_COST_M * (1 - openness[triangle[near]])
        + _INSIDE_COST_M * inside[triangle[near]]
    )
    chosen = np.take_along_axis(near, cost.argmin(axis=1)[:, None], axis=1)[:, 0]
    return SurfacePoints(faces[triangle[chosen]].astype(np.intp), _project(means, corner[triangle[chosen]]))


def _nearest_points(points: F64, some: NDArray[np.intp], means: F64) -> tuple[F64, NDArray[np.intp]]:
    """Return [N, K] distances from the means to the nearest of ``some`` points, and their indices."""
    tree = cKDTree(points[some], compact_nodes=False, balanced_tree=False)  # twice as fast
    distance, near = tree.query(means, min(_CANDIDATES, len(some)), workers=-1)
    return distance.reshape(len(means), -1), some[near.reshape(len(means), -1)]


def _project(points: F64, corner: F64) -> F64:
    """Return [N, 3] barycentric coordinates of points [N, 3] projected to triangles [N, 3, 3], clipped to them."""
    u, v, w = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0], points - corner[:, 0]
    uu, uv, vv, wu, wv = (np.einsum("nc,nc->n", a, b) for a, b in ((u, u), (u, v), (v, v), (w, u), (w, v)))
    area = np.maximum(uu * vv - uv * uv, 1e-24)
    second, third = (wu * vv - wv * uv) / area, (wv * uu - wu * uv) / area
    weights = np.clip(np.stack([1 - second - third, second, third], axis=1), 0, 1)
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


def open_occlusion(occlusion: F64) -> F64:
    """Return the occlusion with a lower limit, so that hollows keep some light."""
    return np.maximum(occlusion, _MIN_OCCLUSION)


def _thin_axes(splats: Splats) -> F64:
    """Return [N, 3] the shortest axis of each splat, of either sign; zero where it has none."""
    axes = signed_axes(np.nan_to_num(splats.quats), np.nan_to_num(splats.scales))
    thin = np.abs(np.nan_to_num(splats.scales)).argmin(axis=1)
    return np.asarray(np.take_along_axis(axes, thin[:, None, None], axis=2)[:, :, 0])


def with_surface(avatar: Avatar, mesh: RiggedMesh) -> Avatar:
    """Return the avatar and its levels with normals and occlusion of the ``mesh`` they were made from.

    Occlusion is of one pose, with the arms half down. A mesh's texture counts as albedo: light in it stays.
    """
    pose = probe_poses(mesh.skeleton.names)[:2][-1]  # standing, if it is a person
    occlusion = ambient_occlusion(mesh, mesh.posed(pose))
    normals = vertex_normals(mesh.posed(Pose.zero(len(mesh.skeleton))), mesh.faces)

    def with_normals(one: Avatar) -> Avatar:
        locations = locate_splats(mesh, one.splats, occlusion)
        visible = view_consistent(one, locations.directions(normals), open_occlusion(locations.at(occlusion)))
        surface = Surface.of(visible.normals, visible.occlusion)
        return replace(one, splats=replace(one.splats, surface=surface))

    levels = tuple(replace(level, content=with_normals(level.content)) for level in avatar.levels)
    return replace(with_normals(replace(avatar, levels=())), levels=levels)
