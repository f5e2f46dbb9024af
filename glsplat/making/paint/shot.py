"""One picture of the fitted body: which points of the surface it shows, and in which colours."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from glsplat.camera import Camera
from glsplat.making.fit.fit import FittedView
from glsplat.making.paint.colour import to_linear
from glsplat.making.raster import visible_faces
from glsplat.meshes import RiggedMesh, vertex_normals

__all__ = ["Shot", "Sight", "SurfacePoints"]

F64 = NDArray[np.float64]

_COARSE = 2  # pixels of the picture to one of the depth map
_BEHIND = 0.012  # metres behind the nearest surface that still count as it
_RIM = 2  # pixels inside the outline whose colours are mixed with the room's
_PATCH, _BUSY = 7, 0.12  # pixels, and the spread of colour in them that is full of detail
_BELIEVED = 0.12, 0.42  # cosines: nothing of the colour is believed, everything is
_TURNED = -0.3, -0.1


@dataclass(frozen=True, slots=True, eq=False)
class SurfacePoints:
    """M points on the triangles of a mesh of V vertices."""

    corners: NDArray[np.intp]  # [M, 3] vertices
    weights: F64  # [M, 3] barycentric

    def at(self, values: F64) -> F64:
        """[M, C] what a value [V, C] of the vertices is there."""
        rows = np.arange(len(self.corners) + 1) * 3
        return csr_array((self.weights.ravel(), self.corners.ravel(), rows), (len(rows) - 1, len(values))) @ values

    def directions(self, values: F64) -> F64:
        """[M, 3] unit vectors between the vertices' [V, 3]."""
        mixed = self.at(values)
        return np.asarray(mixed / np.maximum(np.linalg.norm(mixed, axis=1, keepdims=True), 1e-12))


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """What a picture shows of M points."""

    linear: F64  # [M, 3] linear light
    trust: F64  # [M] 0 not seen, 1 seen squarely
    busy: F64  # [M] from 0, plain, to 1, full of detail


@dataclass(frozen=True, eq=False)
class Shot:
    """A picture with the body that was fitted to it. ``rgb`` [H, W, 3] sRGB uint8, ``mask`` [H, W], focal in pixels."""

    rgb: NDArray[np.uint8]
    mask: NDArray[np.bool_]
    focal: float
    view: FittedView
    mesh: RiggedMesh  # the dressed body; its vertices are those of ``view``

    def camera(self, pelvis: F64, figure: float) -> Camera:
        """Of the picture, made so small that the person is at most ``figure`` pixels high; in the body's axes, of which
        the pelvis joint is at ``pelvis`` [3] in the zero pose."""
        rows = np.flatnonzero(self.mask.any(axis=1))
        scale = min(1.0, figure / (rows[-1] - rows[0] + 1))
        height, width = (round(side * scale) for side in self.mask.shape)
        view = np.eye(4)
        view[:3, :3], view[:3, 3] = self.view.root, self.view.pelvis - self.view.root @ pelvis
        focal = self.focal * scale
        return Camera(view, np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]]), width, height)

    def resized(self, camera: Camera) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
        """Picture and mask as that camera has them; a pixel is the person's if all of it is."""
        size = camera.width, camera.height
        mask = cv2.resize(self.mask.astype(np.uint8) * 255, size, interpolation=cv2.INTER_AREA)
        return np.asarray(cv2.resize(self.rgb, size, interpolation=cv2.INTER_AREA), np.uint8), mask == 255

    @cached_property
    def normals(self) -> F64:
        """[V, 3] in the camera's axes."""
        return vertex_normals(self.view.vertices, self.mesh.faces)

    @cached_property
    def trust(self) -> F64:
        """[V] of the vertices themselves."""
        return self._trust(self.view.vertices, self.normals, self.view.pixels, *_BELIEVED)

    @cached_property
    def squareness(self) -> F64:
        """[V] cosine between a vertex's normal and the way to the camera, whatever hides it."""
        where = self.view.vertices
        return np.asarray(-(self.normals * where).sum(axis=1) / np.linalg.norm(where, axis=1))

    @cached_property
    def shown(self) -> F64:
        """[V] 1 where nothing hides a vertex on or before the outline, else 0."""
        return self._trust(self.view.vertices, self.normals, self.view.pixels, *_TURNED)

    def look(self, points: SurfacePoints) -> Sight:
        """What is seen of the points."""
        where = points.at(self.view.vertices)
        pixels = self.project(where)
        trust = self._trust(where, points.directions(self.normals), pixels, *_BELIEVED)
        return Sight(self.sample(pixels), trust, self.detail(pixels))

    def sample(self, pixels: F64) -> F64:
        """[M, 3] linear light at pixels [M, 2], bilinear; beyond the outline, that of the person's nearest pixel."""
        side = 256  # OpenCV's remap wants pictures, of less than 32767 pixels a side
        rows = max(1, -(-len(pixels) // side))
        flat = np.zeros((rows * side, 2), np.float32)
        flat[: len(pixels)] = pixels - 0.5
        x, y = (np.ascontiguousarray(flat[:, axis].reshape(rows, side)) for axis in (0, 1))
        parts = [
            cv2.remap(
                self._carried, x[a : a + side], y[a : a + side], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
            )
            for a in range(0, rows, side)
        ]
        return np.concatenate(parts).reshape(-1, 3)[: len(pixels)].astype(np.float64)

    def detail(self, pixels: F64) -> F64:
        """[M] how much detail the picture has around each pixel [M, 2], from 0, none, to 1."""
        at = np.floor(pixels).astype(np.intp)
        height, width = self.mask.shape
        return np.asarray(self._detail[at[:, 1].clip(0, height - 1), at[:, 0].clip(0, width - 1)], np.float64)

    @cached_property
    def _detail(self) -> NDArray[np.float32]:
        """[H, W] the local spread of colour in the person, as a share of what counts as full of detail."""
        colour = np.sqrt(self._carried)  # about as eyes see it
        variance = cv2.blur(colour**2, (_PATCH, _PATCH)) - cv2.blur(colour, (_PATCH, _PATCH)) ** 2
        return np.minimum(np.sqrt(np.maximum(variance, 0).sum(axis=2)) / _BUSY, 1)

    def project(self, where: F64) -> F64:
        """[M, 2] pixels of points [M, 3] in camera axes."""
        height, width = self.mask.shape
        return np.asarray(where[:, :2] / where[:, 2:] * self.focal + (width / 2, height / 2))

    def _trust(self, where: F64, normals: F64, pixels: F64, least: float, most: float) -> F64:
        rows, columns = self._depth.shape
        at = np.floor(pixels / _COARSE).astype(np.intp)
        inside = ((at >= 0) & (at < (columns, rows))).all(axis=1)
        nearest = self._depth[at[:, 1].clip(0, rows - 1), at[:, 0].clip(0, columns - 1)]
        facing = -(normals * where).sum(axis=1) / np.linalg.norm(where, axis=1)
        ramp = ((facing - least) / (most - least)).clip(0, 1)
        return np.where(inside & (where[:, 2] < nearest + _BEHIND), ramp * ramp * (3 - 2 * ramp), 0.0)

    @cached_property
    def _depth(self) -> F64:
        """[H / 2, W / 2] camera z of the nearest surface, infinite where there is none."""
        height, width = (side // _COARSE for side in self.mask.shape)
        focal = self.focal / _COARSE
        middle = np.array(self.mask.shape[::-1]) / (2 * _COARSE)
        camera = Camera(np.eye(4), np.array([[focal, 0, middle[0]], [0, focal, middle[1]], [0, 0, 1]]), width, height)
        ids, bary = visible_faces(self.mesh, self.view.vertices, camera)
        depth = np.full(ids.shape, np.inf)
        hit = ids >= 0
        depth[hit] = (bary[hit] * self.view.vertices[self.mesh.faces[ids[hit]], 2]).sum(axis=1)
        return depth

    @cached_property
    def _carried(self) -> NDArray[np.float32]:
        """[H, W, 3] linear light, the person's colours carried on beyond the outline."""
        kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * _RIM + 1,) * 2)
        inner = cv2.erode(self.mask.astype(np.uint8), kernel)
        if not inner.any():
            inner = self.mask.astype(np.uint8)
        _, labels = cv2.distanceTransformWithLabels(1 - inner, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
        rows, columns = np.nonzero(inner)
        source = np.zeros((labels.max() + 1, 2), np.intp)
        source[labels[rows, columns]] = np.stack([rows, columns], axis=1)
        from_row, from_column = source[labels].transpose(2, 0, 1)
        table = to_linear(np.arange(256) / 255).astype(np.float32)
        return np.asarray(table[self.rgb[from_row, from_column]])
