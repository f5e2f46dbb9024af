"""A small software rasterizer in numpy: the visible triangle of each pixel, and the textured picture of a mesh.

It needs no OpenGL context: hidden-surface tests and target pictures for making avatars use it.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F64
from glsplat.camera import Camera
from glsplat.meshes import RiggedMesh
from glsplat.rotations import component_sums


def visible_faces(mesh: RiggedMesh, vertices: F64, camera: Camera) -> tuple[NDArray[np.int64], F64]:
    """Return the face visible at each pixel centre [H, W] (-1: none) and barycentric coordinates [H, W, 3] in it.

    Both sides of a triangle are drawn; texels with alpha below one half are holes; triangles that cross the near
    plane are skipped. Barycentric coordinates are perspective-correct.
    """
    found = _fragments(mesh, vertices, camera)
    order = np.argsort(found.nearness, kind="stable")  # the nearest is written last
    pixel = found.pixel[order]
    ids = np.full(camera.width * camera.height, -1, np.int64)
    ids[pixel] = found.face[order]
    weights = np.zeros((camera.width * camera.height, 3))
    weights[pixel] = found.bary[order]
    return ids.reshape(camera.height, camera.width), weights.reshape(camera.height, camera.width, 3)


def depth_range(mesh: RiggedMesh, vertices: F64, camera: Camera) -> tuple[F64, F64]:
    """Return the camera z [H, W] of the nearest and of the farthest surface at each pixel centre, metres.

    Infinite and minus infinite where there is none; the surface is that of ``visible_faces``.
    """
    found = _fragments(mesh, vertices, camera)
    order = np.argsort(found.nearness, kind="stable")
    pixel, depth = found.pixel[order], 1 / found.nearness[order]
    nearest, farthest = (np.full((camera.height, camera.width), end) for end in (np.inf, -np.inf))
    nearest.ravel()[pixel] = depth
    farthest.ravel()[pixel[::-1]] = depth[::-1]
    return nearest, farthest


class _Fragments(NamedTuple):
    """The places where triangles cover pixel centres."""

    face: NDArray[np.int64]  # [N]
    pixel: NDArray[np.int64]  # [N] row by row
    bary: F64  # [N, 3]
    nearness: F64  # [N] 1 / camera z


def _fragments(mesh: RiggedMesh, vertices: F64, camera: Camera) -> _Fragments:
    faces = mesh.faces
    view = vertices @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
    depth = view[:, 2]
    safe = np.where(depth > camera.near, depth, 1.0)
    x = view[:, 0] / safe * camera.K[0, 0] + camera.K[0, 2]
    y = view[:, 1] / safe * camera.K[1, 1] + camera.K[1, 2]
    fz = depth[faces]
    ax, bx, cx = (x[corner] for corner in faces.T)
    ay, by, cy = (y[corner] for corner in faces.T)

    low_x, wide = pixel_span(ax, bx, cx, camera.width)
    low_y, high = pixel_span(ay, by, cy, camera.height)
    before = np.minimum(np.minimum(fz[:, 0], fz[:, 1]), fz[:, 2]) > camera.near
    face, column, row = box_pixels(low_x, low_y, np.where(before, wide, 0), high)

    # barycentric coordinates on the screen, then divided by depth
    area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = np.where(np.abs(area) > 1e-12, 1 / area, 0.0)
    px, py = column + 0.5 - ax[face], row + 0.5 - ay[face]
    inverse = inverse[face]
    wb = (px * (cy - ay)[face] - (cx - ax)[face] * py) * inverse
    wc = ((bx - ax)[face] * py - px * (by - ay)[face]) * inverse
    hit = np.flatnonzero((wb >= 0) & (wc >= 0) & (wb + wc <= 1) & (inverse != 0))
    face, column, row, wb, wc = face[hit], column[hit], row[hit], wb[hit], wc[hit]
    bary = np.stack([1 - wb - wc, wb, wc], axis=1) / fz[face]
    nearness = component_sums(bary)
    bary /= nearness[:, None]

    keep, first = None, 0
    for part in mesh.parts:
        if part.cutout:
            keep = np.ones(len(face), bool) if keep is None else keep
            mine = np.flatnonzero((face >= first) & (face < first + len(part.faces)))
            uv = np.einsum("nk,nkc->nc", bary[mine], part.uv[face[mine] - first])
            keep[mine] = part.sample(uv)[:, 3] >= 0.5
        first += len(part.faces)
    if keep is not None:
        face, column, row, bary, nearness = face[keep], column[keep], row[keep], bary[keep], nearness[keep]

    return _Fragments(face, row * camera.width + column, bary, nearness)


def pixel_span(first: F64, second: F64, third: F64, size: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return, along one axis, the first pixel [F] whose centre may lie between three corners, and the count [F]."""
    low, high = np.minimum(np.minimum(first, second), third), np.maximum(np.maximum(first, second), third)
    begin = np.ceil(low - 0.5).clip(0, size).astype(np.int64)
    return begin, np.maximum(np.floor(high - 0.5).clip(-1, size - 1).astype(np.int64) - begin + 1, 0)


def box_pixels(
    left: NDArray[np.int64], top: NDArray[np.int64], wide: NDArray[np.int64], high: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return the box, column and row of every pixel of F boxes: box after box, row by row."""
    lines = np.where(wide > 0, high, 0)
    line = np.repeat(np.arange(len(left)), lines)
    row = np.arange(len(line)) - np.repeat(np.cumsum(lines) - lines - top, lines)
    count = wide[line]
    pixel = np.repeat(np.arange(len(line)), count)
    column = np.arange(len(pixel)) - np.repeat(np.cumsum(count) - count - left[line], count)
    return line[pixel], column, row[pixel]


def mesh_picture(mesh: RiggedMesh, vertices: F64, camera: Camera, supersample: int = 3) -> F64:
    """Return the unlit textured mesh: premultiplied RGBA [H, W, 4], box-filtered from ``supersample``^2 samples."""
    return mesh_picture_and_depth(mesh, vertices, camera, supersample)[0]


def mesh_picture_and_depth(mesh: RiggedMesh, vertices: F64, camera: Camera, supersample: int = 3) -> tuple[F64, F64]:
    """Return ``mesh_picture`` and the farthest camera z [H, W] among a pixel's samples, metres (empty: infinite)."""
    large = camera.resized(camera.width * supersample, camera.height * supersample)
    ids, bary = visible_faces(mesh, vertices, large)
    picture = np.zeros((*ids.shape, 4))
    first = 0
    for part in mesh.parts:
        mine = (ids >= first) & (ids < first + len(part.faces))
        uv = np.einsum("nk,nkc->nc", bary[mine], part.uv[ids[mine] - first])
        picture[mine, :3] = part.sample(uv)[:, :3]
        picture[mine, 3] = 1.0
        first += len(part.faces)
    depth = np.full(ids.shape, np.inf)
    hit = ids >= 0
    corner = (vertices @ camera.viewmat[2, :3] + camera.viewmat[2, 3])[mesh.faces[ids[hit]]]
    depth[hit] = (bary[hit] * corner).sum(axis=1)
    blocks = depth.reshape(camera.height, supersample, camera.width, supersample)
    small = cv2.resize(picture, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    return small, blocks.max(axis=(1, 3))
