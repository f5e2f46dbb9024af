"""One picture of the fitted body: which points of the surface it shows, and in which colours."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera
from glsplat.extras.authoring.body.open_body import open_body
from glsplat.extras.authoring.body.segments import half_width, trunk_of
from glsplat.extras.authoring.compute.threads import found_once
from glsplat.extras.authoring.fit.body_fit import FittedView
from glsplat.extras.authoring.geometry.surface_points import SurfacePoints
from glsplat.extras.authoring.paint.picture_layers.fill import continued, disc, only_in_the_middle
from glsplat.extras.authoring.paint.picture_layers.layers import COARSE, RIM, ShownLayers, drawn
from glsplat.extras.authoring.paint.pixels import bilinear, grown
from glsplat.meshes import RiggedMesh, vertex_normals
from glsplat.rotations import component_sums, lengths

__all__ = ["FittedPicture", "Sight"]

F64 = NDArray[np.float64]

_BEHIND = 0.012  # metres behind the nearest surface that still count as it
_BELIEVED = 0.12, 0.42  # cosines: nothing of the colour is believed, everything is
_TURNED = -0.3, -0.1
_MIDDLE = 300  # pixels of the height that are looked at for prints
_CARRIED = 0.04  # of the height: farther no colour is carried


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

    @found_once
    def parts(self) -> ShownLayers:
        """What it shows of each layer of the body."""
        return ShownLayers(self.rgb, self.mask, self.focal, self.view, self.mesh, self.segment, self.bones)

    @property
    def layer(self) -> NDArray[np.intp]:
        """[V] of the vertices; 0 where the body has one layer only."""
        return self.parts.layer

    def layers_at(self, points: SurfacePoints) -> NDArray[np.intp]:
        """[M] the layers of points."""
        return self.layer[points.corners[:, 0]]

    def without_view_of(self, mesh: RiggedMesh, view: FittedView) -> FittedPicture:
        """The same picture of a ``mesh`` that differs only where this one does not show it."""
        other = replace(self, mesh=mesh, view=view)
        kept = ("trust", "normals", "shown", "parts")
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
        mask = cv2.resize(self.parts.agreed.astype(np.uint8) * 255, size, interpolation=cv2.INTER_AREA)
        return np.asarray(cv2.resize(self.rgb, size, interpolation=cv2.INTER_AREA), np.uint8), mask == 255

    @found_once
    def normals(self) -> F64:
        """[V, 3] in the camera's axes."""
        return vertex_normals(self.view.vertices, self.mesh.faces)

    @found_once
    def trust(self) -> F64:
        """[V] of the vertices themselves."""
        return self.known(self.view.pixels, self.layer) * self._facing(
            self.view.vertices, self.normals, self.view.pixels, self.layer, *_BELIEVED
        )

    @found_once
    def squareness(self) -> F64:
        """[V] cosine between a vertex's normal and the way to the camera, whatever hides it."""
        where = self.view.vertices
        return np.asarray(-component_sums(self.normals * where) / lengths(where))

    @found_once
    def shown(self) -> F64:
        """[V] 1 where nothing of its layer hides a vertex on or before the outline and its colour is near, else 0."""
        shown = self._facing(self.view.vertices, self.normals, self.view.pixels, self.layer, *_TURNED)
        far = self._at([seen.far for seen in self.parts.layers], self.view.pixels, self.layer) / self.parts.height
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
        for number, seen in enumerate(self.parts.layers):
            mine = slice(None) if layer is None else np.flatnonzero(layer == number)
            if (layer is None and number) or not len(pixels[mine]):
                continue
            out[mine] = bilinear(self._behind if behind and not number else seen.picture, pixels[mine])
        return out

    def detail(self, pixels: F64, layer: NDArray[np.intp] | None = None) -> F64:
        """[M] how much detail the picture has around each pixel [M, 2], from 0, none, to 1."""
        return np.asarray(self._at(self.parts.details, pixels, layer), np.float64)

    def room(self, pixels: F64) -> F64:
        """[M, 3] linear colours of the room nearest to pixels [M, 2]."""
        return np.asarray(self.parts.room[1][self._small(pixels, self.parts.room[0])], np.float64)

    def shallow(self, pixels: F64, layer: NDArray[np.intp]) -> F64:
        """[M] how far pixels [M, 2] lie from the outline of what shows their layer, in heights of the person."""
        out = np.zeros(len(pixels))
        scale, deep = self.parts.deep
        for number, distance in enumerate(deep):
            mine = np.flatnonzero(layer == number)
            out[mine] = distance[self._small(pixels[mine], scale)]
        return out

    def over_trunk(self, pixels: F64) -> NDArray[np.bool_]:
        """[M] whether the fit has the trunk, the head or legs at pixels [M, 2], whatever is before them; False where
        nothing of the body hides anything else of it."""
        if self.segment is None:
            return np.zeros(len(pixels), bool)
        return np.isfinite(self._at([self.parts.layers[0].depth], pixels, None, COARSE))

    def _small(self, pixels: F64, scale: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Rows and columns of pixels in a picture of another scale."""
        height, width = (max(1, int(side * scale)) for side in self.mask.shape)
        at = np.floor(pixels * scale).astype(np.intp)
        return at[:, 1].clip(0, height - 1), at[:, 0].clip(0, width - 1)

    def known(self, pixels: F64, layer: NDArray[np.intp]) -> F64:
        """[M] 1 where a pixel shows the layer, else 0."""
        return np.asarray(self._at([seen.known for seen in self.parts.layers], pixels, layer), np.float64)

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
        inside = ((pixels >= 0) & (pixels < (width // COARSE * COARSE, height // COARSE * COARSE))).all(axis=1)
        nearest = self._at([seen.depth for seen in self.parts.layers], pixels, layer, COARSE)
        facing = -component_sums(normals * where) / lengths(where)
        ramp = ((facing - least) / (most - least)).clip(0, 1)
        return np.where(inside & (where[:, 2] < nearest + _BEHIND), ramp * ramp * (3 - 2 * ramp), 0.0)

    @found_once
    def _behind(self) -> NDArray[np.float32]:
        """[H, W, 3] the trunk's picture without what the sides do not show."""
        front = self.parts.layers[0]
        if self.segment is None:
            return front.picture
        body = open_body()
        trunk = trunk_of(body)
        rest = self.mesh.vertices
        faces = self.mesh.faces[trunk[self.mesh.faces].all(axis=1)]
        scale = min(1.0, _MIDDLE / self.parts.height)
        ids, bary = drawn(self.mesh, self.view.vertices, self.focal, self.mask.shape, faces, scale)
        place = np.stack([rest[:, 0] / np.maximum(half_width(rest, trunk), 1e-3), rest[:, 1]], axis=1)
        at = np.full((*ids.shape, 2), np.nan)
        at[ids >= 0] = np.einsum("nk,nkc->nc", bary[ids >= 0], place[faces[ids[ids >= 0]]])
        size = ids.shape[::-1]
        small = cv2.resize(front.picture, size, interpolation=cv2.INTER_AREA)
        own = cv2.resize(np.asarray(front.known, np.float32), size, interpolation=cv2.INTER_AREA)
        own = cv2.erode((own > 0.9).astype(np.uint8), disc(RIM)) > 0
        prints = grown(only_in_the_middle(small, at, own).astype(np.intp), self.mask.shape) > 0
        return continued(front.picture, self.mask & (self.parts.label == 0) & ~prints, prints, self.parts.height)
