"""Sample one picture of the fitted body: the visible points of the surface, and their colours."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera
from glsplat.extras.authoring.body.open_body import Body, open_body
from glsplat.extras.authoring.body.segments import HANDS, joint_weights, mirror_vertices
from glsplat.extras.authoring.compute.threads import locked_cached_property
from glsplat.extras.authoring.fit.body_fit import FittedView
from glsplat.extras.authoring.fit.eyes import EYE_SIDES, eyeball
from glsplat.extras.authoring.fit.outline import projected_mask
from glsplat.extras.authoring.geometry.surface_points import SurfacePoints
from glsplat.extras.authoring.paint.picture_layers.layers import COARSE, PictureLayers
from glsplat.extras.authoring.paint.pixels import bilinear
from glsplat.extras.authoring.paint.ramps import ramp, smoothstep
from glsplat.meshes import RiggedMesh, vertex_normals
from glsplat.rotations import component_sums, lengths
from glsplat.skinning.smplx import JOINT_NAMES

F64 = NDArray[np.float64]

_DEPTH_TOLERANCE_M = 0.012  # behind the nearest surface
_VISIBILITY_COSINES = 0.12, 0.42  # of surface to line of sight: invisible, fully visible
_BACKFACE_COSINES = -0.3, -0.1  # the same for surface on the outline
_FAR_CHEEK_COSINES = 0.1, 0.25  # less than its mirror image: full use of a face's pixels, and none
_CHEEK_MIN_Z_M = 0.05  # in the zero pose: before the ears
_WRIST = 0.5, 0.75  # skinning weights of the hand's joints: hands begin softly above the cut of the arm's rows
_MAX_COLOUR_REACH_FRACTION = 0.04  # of the height: colours extended farther fade out


def hand_shares(body: Body) -> F64:
    """Return [2, V] 0 on arms, 1 on the left and on the right hand."""
    return np.stack([ramp(joint_weights(body, side, *HANDS) * body.skin, *_WRIST) for side in ("left", "right")])


@dataclass(frozen=True, slots=True, eq=False)
class ViewSample:
    """A picture's colours of M points."""

    linear: F64  # [M, 3] linear light
    visibility: F64  # [M] 0 hidden, 1 seen squarely
    detail: F64  # [M] from 0, plain, to 1, full of detail


@dataclass(frozen=True, eq=False)
class FittedPicture:
    """A picture with the body that was fitted to it.

    ``rgb`` [H, W, 3] is sRGB uint8, ``mask`` [H, W], ``focal`` in pixels.
    """

    rgb: NDArray[np.uint8]
    mask: NDArray[np.bool_]
    focal: float
    view: FittedView
    mesh: RiggedMesh  # the dressed body; its vertices are those of ``view``
    segment: NDArray[np.intp] | None = None  # [V] see segments.py; None: the body does not occlude itself

    # [2, 24, 2] detected pixels of shoulders, elbows, wrists and hands; NaN where they were not detected
    bones: F64 | None = None
    face: bool = True  # the network found it, so that the head's turn is known

    @locked_cached_property
    def picture_layers(self) -> PictureLayers:
        """Split the picture by the body's layers."""
        return PictureLayers(self.rgb, self.mask, self.focal, self.view, self.mesh, self.segment, self.bones)

    @property
    def layer(self) -> NDArray[np.intp]:
        """[V] layer of each vertex; 0 where the body has one layer only."""
        return self.picture_layers.layer

    def layers_at(self, points: SurfacePoints) -> NDArray[np.intp]:
        """Return [M] the layers of points."""
        return self.layer[points.corners[:, 0]]

    def without_view_of(self, mesh: RiggedMesh, view: FittedView) -> FittedPicture:
        """Return this picture with a ``mesh`` that differs only where the picture does not show it."""
        other = replace(self, mesh=mesh, view=view)
        kept = ("visibility", "facing", "normals", "visible", "picture_layers")
        vars(other).update({name: vars(self)[name] for name in kept if name in vars(self)})
        return other

    def camera(self, pelvis: F64, figure: float) -> Camera:
        """Return the picture's camera in the body's axes, with the person at most ``figure`` pixels high.

        The pelvis joint is at ``pelvis`` [3] in the zero pose.
        """
        rows = np.flatnonzero(self.mask.any(axis=1))
        scale = min(1.0, figure / (rows[-1] - rows[0] + 1))
        height, width = (round(side * scale) for side in self.mask.shape)
        view = np.eye(4)
        view[:3, :3], view[:3, 3] = self.view.root, self.view.pelvis - self.view.root @ pelvis
        focal = self.focal * scale
        return Camera(view, np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]]), width, height)

    def resized(self, camera: Camera) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
        """Return picture and mask at the size of ``camera``.

        A pixel is in the mask if all of it shows the layer of the body that the fit has there.
        """
        size = camera.width, camera.height
        mask = cv2.resize(self.picture_layers.agreed.astype(np.uint8) * 255, size, interpolation=cv2.INTER_AREA)
        return np.asarray(cv2.resize(self.rgb, size, interpolation=cv2.INTER_AREA), np.uint8), mask == 255

    def unused_pixels(self, camera: Camera) -> NDArray[np.bool_]:
        """Return the mask [h, w] of ``unused`` surface at the size of ``camera``."""
        faces = self.mesh.faces[(self.unused[self.mesh.faces] > 0.5).any(axis=1)]
        scale = camera.width / self.mask.shape[1], camera.height / self.mask.shape[0]
        return projected_mask(self.view.pixels * scale, faces, (camera.height, camera.width))

    @locked_cached_property
    def normals(self) -> F64:
        """[V, 3] in the camera's axes."""
        return vertex_normals(self.view.vertices, self.mesh.faces)

    @locked_cached_property
    def visibility(self) -> F64:
        """[V] visibility of the vertices."""
        return self.shows_layer(self.view.pixels, self.layer) * self.facing

    @locked_cached_property
    def facing(self) -> F64:
        """[V] from 0, turned away or hidden by its own layer, to 1; known without the picture's own layers."""
        return self._facing(self.view.vertices, self.normals, self.view.pixels, self.layer, *_VISIBILITY_COSINES)

    @locked_cached_property
    def unused(self) -> F64:
        """[V] from 0 to 1: hands and the farther cheek of a turned face take no pixels.

        A fit that is some pixels off would show other things there.
        """
        body, across = open_body(), mirror_vertices()
        _, height, ahead = body.vertices.T
        cheeks = self.face & (ahead > _CHEEK_MIN_Z_M) & (height < eyeball(body, EYE_SIDES[0]).centre[1])
        cheeks &= np.isin(body.part, [JOINT_NAMES.index(name) for name in ("head", "jaw")])
        away = (self.squareness[across] - self.squareness) * cheeks
        return np.maximum(ramp(away, *_FAR_CHEEK_COSINES) * self.visibility[across], hand_shares(body).sum(axis=0))

    @locked_cached_property
    def squareness(self) -> F64:
        """[V] cosine between a vertex's normal and the way to the camera, hidden or not."""
        where = self.view.vertices
        return np.asarray(-component_sums(self.normals * where) / lengths(where))

    @locked_cached_property
    def visible(self) -> F64:
        """[V] 1 on or before the outline where no surface of its layer hides a vertex and its colour is near."""
        visible = self._facing(self.view.vertices, self.normals, self.view.pixels, self.layer, *_BACKFACE_COSINES)
        reaches = [each.far for each in self.picture_layers.layers]
        reach = self._nearest_pixel(reaches, self.view.pixels, self.layer) / self.picture_layers.height
        return np.asarray(visible * (1 - ramp(reach, _MAX_COLOUR_REACH_FRACTION, 2 * _MAX_COLOUR_REACH_FRACTION)))

    def sample_surface(self, points: SurfacePoints) -> ViewSample:
        """Return the colours of the points."""
        where = points.at(self.view.vertices)
        pixels = self.project(where)
        layer = self.layers_at(points)
        visibility = self._facing(where, points.directions(self.normals), pixels, layer, *_VISIBILITY_COSINES)
        visibility *= self.shows_layer(pixels, layer) * (1 - points.at(self.unused[:, None])[:, 0])
        return ViewSample(self.sample(pixels, layer), visibility, self.detail(pixels, layer))

    def sample(self, pixels: F64, layer: NDArray[np.intp] | None = None) -> F64:
        """Return [M, 3] linear light at pixels [M, 2], bilinear; outside a layer, that of its nearest pixel.

        ``layer`` [M]; None for the trunk's.
        """
        out = np.zeros((len(pixels), 3))
        for number, each in enumerate(self.picture_layers.layers):
            mine = slice(None) if layer is None else np.flatnonzero(layer == number)
            if (layer is None and number) or not len(pixels[mine]):
                continue
            out[mine] = bilinear(each.picture, pixels[mine])
        return out

    def detail(self, pixels: F64, layer: NDArray[np.intp] | None = None) -> F64:
        """Return [M] the picture's detail around each pixel [M, 2], from 0, plain, to 1."""
        return np.asarray(self._nearest_pixel(self.picture_layers.details, pixels, layer), np.float64)

    def relief(self, pixels: F64, layer: NDArray[np.intp] | None = None) -> F64:
        """Return [M] the ``relief_of`` each pixel [M, 2]."""
        return np.asarray(self._nearest_pixel(self.picture_layers.reliefs, pixels, layer), np.float64)

    def background(self, pixels: F64) -> F64:
        """Return [M, 3] linear colours of the background nearest to pixels [M, 2]."""
        scale, colours = self.picture_layers.background
        return np.asarray(colours[self._scaled_pixels(pixels, scale)], np.float64)

    def outline_distance(self, pixels: F64, layer: NDArray[np.intp]) -> F64:
        """Return [M] distances of pixels [M, 2] to their layer's outline, over the person's height."""
        out = np.zeros(len(pixels))
        scale, distances = self.picture_layers.outline_distances
        for number, distance in enumerate(distances):
            mine = np.flatnonzero(layer == number)
            out[mine] = distance[self._scaled_pixels(pixels[mine], scale)]
        return out

    def over_trunk(self, pixels: F64) -> NDArray[np.bool_]:
        """Return [M] whether the fit has trunk, head or legs at pixels [M, 2], occluded or not.

        False where the body does not occlude itself.
        """
        if self.segment is None:
            return np.zeros(len(pixels), bool)
        return np.isfinite(self._nearest_pixel([self.picture_layers.depths[0]], pixels, None, COARSE))

    def _scaled_pixels(self, pixels: F64, scale: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return rows and columns of pixels in a picture scaled by ``scale``."""
        height, width = (max(1, int(side * scale)) for side in self.mask.shape)
        at = np.floor(pixels * scale).astype(np.intp)
        return at[:, 1].clip(0, height - 1), at[:, 0].clip(0, width - 1)

    def shows_layer(self, pixels: F64, layer: NDArray[np.intp]) -> F64:
        """Return [M] 1 where a pixel shows the layer, else 0."""
        known = [each.known for each in self.picture_layers.layers]
        return np.asarray(self._nearest_pixel(known, pixels, layer), np.float64)

    def _nearest_pixel(
        self, pictures: list[NDArray[np.float32]], pixels: F64, layer: NDArray[np.intp] | None, coarse: int = 1
    ) -> NDArray[np.float32]:
        """Return [M] the nearest pixel's value in the picture of each point's layer; clamped to the edge."""
        rows, columns = pictures[0].shape
        at = np.floor(pixels / coarse).astype(np.intp)
        column, row = at[:, 0].clip(0, columns - 1), at[:, 1].clip(0, rows - 1)
        if layer is None or len(pictures) == 1:
            return np.asarray(pictures[0][row, column])
        return np.asarray(np.stack([picture[row, column] for picture in pictures])[layer, np.arange(len(pixels))])

    def project(self, where: F64) -> F64:
        """Return [M, 2] pixels of points [M, 3] in camera axes."""
        height, width = self.mask.shape
        return np.asarray(where[:, :2] / where[:, 2:] * self.focal + (width / 2, height / 2))

    def _facing(self, where: F64, normals: F64, pixels: F64, layer: NDArray[np.intp], low: float, high: float) -> F64:
        """Return [M] from 0, turned away or hidden by its own layer, to 1."""
        height, width = self.mask.shape
        inside = ((pixels >= 0) & (pixels < (width // COARSE * COARSE, height // COARSE * COARSE))).all(axis=1)
        nearest = self._nearest_pixel(self.picture_layers.depths, pixels, layer, COARSE)
        facing = -component_sums(normals * where) / lengths(where)
        return np.where(inside & (where[:, 2] < nearest + _DEPTH_TOLERANCE_M), smoothstep(facing, low, high), 0.0)
