"""One picture of the fitted body: which points of the surface it shows, and in which colours."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from glsplat.authoring.cells import between
from glsplat.authoring.fit.body import open_body
from glsplat.authoring.fit.fit import FittedView
from glsplat.authoring.paint.layers.fill import continued, disc, nearest_known, only_in_the_middle
from glsplat.authoring.paint.layers.labels import labels_of
from glsplat.authoring.paint.layers.patches import woven
from glsplat.authoring.paint.layers.segments import HANDS, LAYERS, half_width, layer_of, trunk_of
from glsplat.authoring.raster import visible_faces
from glsplat.authoring.threads import abreast
from glsplat.camera import Camera
from glsplat.meshes import MeshPart, RiggedMesh, vertex_normals
from glsplat.pictures import to_linear
from glsplat.rotations import unit_vectors
from glsplat.skinning.skin import strongest_joint
from glsplat.skinning.smplx import JOINT_NAMES

__all__ = ["FittedPicture", "Sight", "SurfacePoints"]

F64 = NDArray[np.float64]

_COARSE = 2  # pixels of the picture to one of the depth map
_BEHIND = 0.012  # metres behind the nearest surface that still count as it
_RIM = 2  # pixels inside the outline whose colours are mixed with the room's
_PATCH, _BUSY = 7, 0.12  # pixels, and the spread of colour in them that is full of detail
_BELIEVED = 0.12, 0.42  # cosines: nothing of the colour is believed, everything is
_TURNED = -0.3, -0.1
_MIDDLE = 300  # pixels of the height that are looked at for prints
_LABELLED = 480  # pixels of the person's height that are labelled
_MIXED = 0.006, 0.002  # of the height: about arms the trunk's colours are mixed with theirs, and theirs at their edge
_SOFT = 1.0  # pixels over which what is known ends
_CARRIED = 0.04  # of the height: farther no colour is carried
_FEWEST = 20  # pixels of a layer that is seen at all


@dataclass(frozen=True, slots=True, eq=False)
class SurfacePoints:
    """M points on the triangles of a mesh of V vertices."""

    corners: NDArray[np.intp]  # [M, 3] vertices
    weights: F64  # [M, 3] barycentric

    def take(self, some: NDArray[np.intp] | slice) -> SurfacePoints:
        """N of the points."""
        return SurfacePoints(self.corners[some], self.weights[some])

    def at(self, values: F64) -> F64:
        """[M, C] what a value [V, C] of the vertices is there."""
        return self.matrix(len(values)) @ values

    def matrix(self, count: int) -> csr_array:
        """[M, V] the weights, of ``count`` vertices."""
        return between(self.corners, self.weights, count)

    def directions(self, values: F64) -> F64:
        """[M, 3] unit vectors between the vertices' [V, 3]."""
        return unit_vectors(self.at(values))


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """What a picture shows of M points."""

    linear: F64  # [M, 3] linear light
    trust: F64  # [M] 0 not seen, 1 seen squarely
    busy: F64  # [M] from 0, plain, to 1, full of detail


@dataclass(frozen=True, eq=False)
class FittedPicture:
    """A picture with the body that was fitted to it. ``rgb`` [H, W, 3] sRGB uint8, ``mask`` [H, W], focal in pixels."""

    rgb: NDArray[np.uint8]
    mask: NDArray[np.bool_]
    focal: float
    view: FittedView
    mesh: RiggedMesh  # the dressed body; its vertices are those of ``view``
    segment: NDArray[np.intp] | None = None  # [V] of segments.py; None: nothing of the body hides anything else of it

    bones: F64 | None = (
        None  # [2, 24, 2] pixels of shoulders, elbows, wrists, hands as networks saw them; NaN where they did not
    )

    @cached_property
    def layer(self) -> NDArray[np.intp]:
        """[V] of the vertices; 0 where the body has one layer only."""
        return np.zeros(len(self.mesh.vertices), np.intp) if self.segment is None else layer_of(self.segment)

    def layers_at(self, points: SurfacePoints) -> NDArray[np.intp]:
        """[M] the layers of points."""
        return self.layer[points.corners[:, 0]]

    def without_view_of(self, mesh: RiggedMesh, view: FittedView) -> FittedPicture:
        """The same picture of a ``mesh`` that differs only where this one does not show it."""
        other = replace(self, mesh=mesh, view=view)
        kept = ("trust", "normals", "shown", "_layers", "_details", "_labelled", "_label", "_agreed", "_room", "_deep")
        vars(other).update({name: vars(self)[name] for name in kept if name in vars(self)})
        return other

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
        """Picture and mask as that camera has them; a pixel is in the mask if all of it shows the layer of the body
        that the fit has there."""
        size = camera.width, camera.height
        mask = cv2.resize(self._agreed.astype(np.uint8) * 255, size, interpolation=cv2.INTER_AREA)
        return np.asarray(cv2.resize(self.rgb, size, interpolation=cv2.INTER_AREA), np.uint8), mask == 255

    @cached_property
    def normals(self) -> F64:
        """[V, 3] in the camera's axes."""
        return vertex_normals(self.view.vertices, self.mesh.faces)

    @cached_property
    def trust(self) -> F64:
        """[V] of the vertices themselves."""
        return self.known(self.view.pixels, self.layer) * self._facing(
            self.view.vertices, self.normals, self.view.pixels, self.layer, *_BELIEVED
        )

    @cached_property
    def squareness(self) -> F64:
        """[V] cosine between a vertex's normal and the way to the camera, whatever hides it."""
        where = self.view.vertices
        return np.asarray(-(self.normals * where).sum(axis=1) / np.linalg.norm(where, axis=1))

    @cached_property
    def shown(self) -> F64:
        """[V] 1 where nothing of its layer hides a vertex on or before the outline and its colour is near, else 0."""
        shown = self._facing(self.view.vertices, self.normals, self.view.pixels, self.layer, *_TURNED)
        far = self._at([seen.far for seen in self._layers], self.view.pixels, self.layer) / self._height
        return np.asarray(shown * (1 - (far - _CARRIED) / _CARRIED).clip(0, 1))

    def look(self, points: SurfacePoints) -> Sight:
        """What is seen of the points."""
        where = points.at(self.view.vertices)
        pixels = self.project(where)
        layer = self.layers_at(points)
        trust = self._facing(where, points.directions(self.normals), pixels, layer, *_BELIEVED)
        return Sight(self.sample(pixels, layer), trust * self.known(pixels, layer), self.detail(pixels, layer))

    def sample(self, pixels: F64, layer: NDArray[np.intp] | None = None, behind: bool = False) -> F64:
        """[M, 3] linear light at pixels [M, 2], bilinear; beyond a layer's outline, that of its nearest pixel.

        ``layer`` [M], none for the trunk's. ``behind``: as cloth is that no front's middle is printed on.
        """
        out = np.zeros((len(pixels), 3))
        for number, seen in enumerate(self._layers):
            mine = slice(None) if layer is None else np.flatnonzero(layer == number)
            if (layer is None and number) or not len(pixels[mine]):
                continue
            out[mine] = _bilinear(self._behind if behind and not number else seen.picture, pixels[mine])
        return out

    def detail(self, pixels: F64, layer: NDArray[np.intp] | None = None) -> F64:
        """[M] how much detail the picture has around each pixel [M, 2], from 0, none, to 1."""
        return np.asarray(self._at(self._details, pixels, layer), np.float64)

    def room(self, pixels: F64) -> F64:
        """[M, 3] linear colours of the room nearest to pixels [M, 2]."""
        return np.asarray(self._room[1][self._small(pixels, self._room[0])], np.float64)

    def shallow(self, pixels: F64, layer: NDArray[np.intp]) -> F64:
        """[M] how far pixels [M, 2] lie from the outline of what shows their layer, in heights of the person."""
        out = np.zeros(len(pixels))
        scale, deep = self._deep
        for number, distance in enumerate(deep):
            mine = np.flatnonzero(layer == number)
            out[mine] = distance[self._small(pixels[mine], scale)]
        return out

    def _small(self, pixels: F64, scale: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Rows and columns of pixels in a picture of another scale."""
        height, width = (max(1, int(side * scale)) for side in self.mask.shape)
        at = np.floor(pixels * scale).astype(np.intp)
        return at[:, 1].clip(0, height - 1), at[:, 0].clip(0, width - 1)

    @cached_property
    def _room(self) -> tuple[float, NDArray[np.float32]]:
        """Of a smaller picture its scale, and the room's colours carried on into the person."""
        scale = min(1.0, _LABELLED / self._height)
        size = tuple(max(1, int(side * scale)) for side in self.mask.shape[::-1])
        mask = cv2.dilate(cv2.resize(self.mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST), disc(_RIM))
        row, column = nearest_known(mask == 0)
        small = cv2.resize(self.rgb, size, interpolation=cv2.INTER_AREA)
        return scale, to_linear(small[row, column] / 255).astype(np.float32)

    @cached_property
    def _deep(self) -> tuple[float, list[NDArray[np.float32]]]:
        """The same scale, and for each layer how deep in it its pixels lie, in heights of the person."""
        scale = min(1.0, _LABELLED / self._height)
        size = tuple(max(1, int(side * scale)) for side in self.mask.shape[::-1])
        label = np.where(self.mask, 0 if self.segment is None else self._label, -1).astype(np.int16)
        small = cv2.resize(label, size, interpolation=cv2.INTER_NEAREST)
        shown = [(small == number).astype(np.uint8) for number in range(1 if self.segment is None else LAYERS)]
        return scale, [
            np.asarray(cv2.distanceTransform(some, cv2.DIST_L2, 3) / (scale * self._height), np.float32)
            for some in shown
        ]

    def known(self, pixels: F64, layer: NDArray[np.intp]) -> F64:
        """[M] 1 where a pixel shows the layer, else 0."""
        return np.asarray(self._at([seen.known for seen in self._layers], pixels, layer), np.float64)

    def _at(
        self, pictures: list[NDArray[np.float32]], pixels: F64, layer: NDArray[np.intp] | None, coarse: int = 1
    ) -> NDArray[np.float32]:
        """[M] the nearest pixel's value in the picture of each one's layer; of the edge's for those outside."""
        rows, columns = pictures[0].shape
        at = np.floor(pixels / coarse).astype(np.intp)
        column, row = at[:, 0].clip(0, columns - 1), at[:, 1].clip(0, rows - 1)
        if layer is None or len(pictures) == 1:
            return np.asarray(pictures[0][row, column])
        return np.asarray(np.stack([picture[row, column] for picture in pictures])[layer, np.arange(len(pixels))])

    def project(self, where: F64) -> F64:
        """[M, 2] pixels of points [M, 3] in camera axes."""
        height, width = self.mask.shape
        return np.asarray(where[:, :2] / where[:, 2:] * self.focal + (width / 2, height / 2))

    def _facing(self, where: F64, normals: F64, pixels: F64, layer: NDArray[np.intp], least: float, most: float) -> F64:
        """[M] from 0, turned away or hidden by its own layer, to 1."""
        height, width = self.mask.shape
        inside = ((pixels >= 0) & (pixels < (width // _COARSE * _COARSE, height // _COARSE * _COARSE))).all(axis=1)
        nearest = self._at([seen.depth for seen in self._layers], pixels, layer, _COARSE)
        facing = -(normals * where).sum(axis=1) / np.linalg.norm(where, axis=1)
        ramp = ((facing - least) / (most - least)).clip(0, 1)
        return np.where(inside & (where[:, 2] < nearest + _BEHIND), ramp * ramp * (3 - 2 * ramp), 0.0)

    @cached_property
    def _layers(self) -> list[_Layer]:
        inner = cv2.erode(self.mask.astype(np.uint8), disc(_RIM)) > 0
        if not inner.any():
            inner = self.mask
        if self.segment is None:
            return [self._layer_of(inner, np.ones(self.mask.shape, np.float32), self.mesh.faces)]

        def cut(number: int) -> _Layer:
            other = self.mask & (self._label != number) if number == 0 else self._label != number
            near = disc(max(1, round(_MIXED[min(number, 1)] * self._height)))
            own = inner & ~(cv2.dilate(other.astype(np.uint8), near) > 0)
            known = cv2.GaussianBlur(own.astype(np.float32), (0, 0), _SOFT)
            mine = (self.layer[self.mesh.faces] == number).all(axis=1)
            seen = self._layer_of(own if own.sum() > _FEWEST else inner, known, self.mesh.faces[mine])
            if number == 0:
                hole = self._label != 0
                filled = continued(seen.picture, inner & ~hole & (seen.known > 0.9), hole, self._height)
                seen = replace(seen, picture=filled, far=np.zeros_like(seen.far))
            there = cv2.resize(seen.depth, inner.shape[::-1], interpolation=cv2.INTER_NEAREST)
            picture = woven(seen.picture, inner & (seen.known > 0.9), np.isfinite(there), self._label, number)
            carried = np.where((picture == seen.picture).all(axis=2), seen.far, np.float32(0))
            return replace(seen, picture=picture, far=carried)

        _ = self._label, self.layer  # found once, before threads ask for them
        return abreast(cut, range(LAYERS))

    @cached_property
    def _details(self) -> list[NDArray[np.float32]]:
        """[H, W] of each layer the local spread of colour, as a share of what counts as full of detail."""
        return abreast(lambda seen: _busy(seen.picture), self._layers)

    def _layer_of(self, own: NDArray[np.bool_], known: NDArray[np.float32], faces: NDArray[np.int32]) -> _Layer:
        table = to_linear(np.arange(256) / 255).astype(np.float32)
        row, column = nearest_known(own)
        picture = table[self.rgb[row, column]]
        there = np.indices(own.shape, np.int32)
        far = np.hypot(row - there[0], column - there[1]).astype(np.float32)
        ids, bary = self._drawn(faces, 1 / _COARSE)
        depth = np.full(ids.shape, np.inf, np.float32)
        hit = ids >= 0
        depth[hit] = (bary[hit] * self.view.vertices[faces[ids[hit]], 2]).sum(axis=1)
        return _Layer(picture, depth, known, far)

    @cached_property
    def _label(self) -> NDArray[np.intp]:
        """[H, W] the layer that each pixel shows, below zero none."""
        return _grown(self._labelled[0], self.mask.shape)

    @cached_property
    def _agreed(self) -> NDArray[np.bool_]:
        """[H, W] where the picture shows what the fitted body shows."""
        if self.segment is None:
            return self.mask
        segment = self._labelled[1]
        there = _grown(layer_of(segment), self.mask.shape)
        return np.asarray(self.mask & ((self._label == there) | ((there < 0) & (self._label >= 0))))

    @cached_property
    def _labelled(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """What the picture shows, and the body's segments, both smaller than the picture."""
        assert self.segment is not None
        scale = min(1.0, _LABELLED / self._height)
        ids, _ = self._drawn(self.mesh.faces, scale)
        corner = np.where(ids >= 0, self.mesh.faces[ids.clip(0), 0], 0)
        segment = np.where(ids >= 0, self.segment[corner], -1)
        part = strongest_joint(self.mesh.joints, self.mesh.weights)[corner]
        size = ids.shape[::-1]
        rgb = cv2.resize(self.rgb, size, interpolation=cv2.INTER_AREA)
        mask = cv2.resize(self.mask.astype(np.uint8) * 255, size, interpolation=cv2.INTER_AREA) > 127
        hand = (ids >= 0) & np.isin(part, _joints(*HANDS))
        head = (ids >= 0) & np.isin(part, _joints("neck", "head", "jaw"))
        bones = None if self.bones is None else self.bones * (np.array(size) / self.mask.shape[::-1])
        return labels_of(np.asarray(rgb, np.uint8), mask, segment, hand, head, bones), segment

    @cached_property
    def _height(self) -> float:
        """Pixels of the person."""
        rows = np.flatnonzero(self.mask.any(axis=1))
        return float(rows[-1] - rows[0] + 1)

    def _drawn(self, faces: NDArray[np.int32], scale: float) -> tuple[NDArray[np.int64], F64]:
        """Which of the faces a smaller picture shows, and where on them; see ``visible_faces``."""
        height, width = (int(side * scale) for side in self.mask.shape)
        focal = self.focal * scale
        middle = np.array(self.mask.shape[::-1]) * scale / 2
        camera = Camera(np.eye(4), np.array([[focal, 0, middle[0]], [0, focal, middle[1]], [0, 0, 1]]), width, height)
        white = np.full((1, 1, 4), 255, np.uint8)
        some = replace(self.mesh, parts=(MeshPart("", faces, np.zeros((*faces.shape, 2)), white),))
        return visible_faces(some, self.view.vertices, camera)

    @cached_property
    def _behind(self) -> NDArray[np.float32]:
        """[H, W, 3] the trunk's picture without what the sides do not show."""
        front = self._layers[0]
        if self.segment is None:
            return front.picture
        body = open_body()
        trunk = trunk_of(body)
        rest = self.mesh.vertices
        faces = self.mesh.faces[trunk[self.mesh.faces].all(axis=1)]
        scale = min(1.0, _MIDDLE / self._height)
        ids, bary = self._drawn(faces, scale)
        place = np.stack([rest[:, 0] / np.maximum(half_width(rest, trunk), 1e-3), rest[:, 1]], axis=1)
        at = np.full((*ids.shape, 2), np.nan)
        at[ids >= 0] = np.einsum("nk,nkc->nc", bary[ids >= 0], place[faces[ids[ids >= 0]]])
        size = ids.shape[::-1]
        small = cv2.resize(front.picture, size, interpolation=cv2.INTER_AREA)
        own = cv2.resize(np.asarray(front.known, np.float32), size, interpolation=cv2.INTER_AREA)
        own = cv2.erode((own > 0.9).astype(np.uint8), disc(_RIM)) > 0
        prints = _grown(only_in_the_middle(small, at, own).astype(np.intp), self.mask.shape) > 0
        return continued(front.picture, self.mask & (self._label == 0) & ~prints, prints, self._height)


@dataclass(frozen=True, slots=True, eq=False)
class _Layer:
    """What a picture shows of one layer of the body."""

    picture: NDArray[np.float32]  # [H, W, 3] linear light, carried on beyond what is its own
    depth: NDArray[np.float32]  # [H / 2, W / 2] camera z of its nearest surface, infinite where there is none
    known: NDArray[np.float32]  # [H, W] 1 where a pixel shows it
    far: NDArray[np.float32]  # [H, W] pixels that the colour was carried


def _busy(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    colour = np.sqrt(picture)  # about as eyes see it
    variance = cv2.blur(colour**2, (_PATCH, _PATCH)) - cv2.blur(colour, (_PATCH, _PATCH)) ** 2
    return np.minimum(np.sqrt(np.maximum(variance, 0).sum(axis=2)) / _BUSY, 1)


def _bilinear(picture: NDArray[np.float32], pixels: F64) -> F64:
    side = 256  # OpenCV's remap wants pictures, of less than 32767 pixels a side
    rows = max(1, -(-len(pixels) // side))
    flat = np.zeros((rows * side, 2), np.float32)
    flat[: len(pixels)] = pixels - 0.5
    x, y = (np.ascontiguousarray(flat[:, axis].reshape(rows, side)) for axis in (0, 1))
    parts = [
        cv2.remap(picture, x[a : a + side], y[a : a + side], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        for a in range(0, rows, side)
    ]
    return np.concatenate(parts).reshape(-1, 3)[: len(pixels)].astype(np.float64)


def _grown(small: NDArray[np.intp], shape: tuple[int, ...]) -> NDArray[np.intp]:
    """Labels at the size of the picture."""
    return cv2.resize(small.astype(np.int16), shape[::-1], interpolation=cv2.INTER_NEAREST).astype(np.intp)


def _joints(*names: str) -> list[int]:
    return [index for index, joint in enumerate(JOINT_NAMES) if any(name in joint for name in names)]
