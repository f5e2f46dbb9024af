"""Split a picture by the layers of its fitted body; each is continued where another one occludes it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera
from glsplat.extras.authoring.body.segments import FOREARMS, HANDS, LAYER_COUNT, layer_of
from glsplat.extras.authoring.compute.threads import locked_cached_property, map_threads
from glsplat.extras.authoring.fit.body_fit import FittedView
from glsplat.extras.authoring.geometry.raster import visible_faces
from glsplat.extras.authoring.paint.picture_layers.fill import (
    disc,
    fill_hole,
    nearest_known,
    nearest_known_labels,
)
from glsplat.extras.authoring.paint.picture_layers.labels import labels_of
from glsplat.extras.authoring.paint.picture_layers.patches import continue_cloth
from glsplat.extras.authoring.paint.picture_layers.shadows import shadow_gain
from glsplat.extras.authoring.paint.pixels import detail_of, linear_light, relief_of, upscale_labels
from glsplat.meshes import MeshPart, RiggedMesh
from glsplat.rotations import component_sums
from glsplat.skinning.skin import strongest_joint
from glsplat.skinning.smplx import JOINT_NAMES

F64 = NDArray[np.float64]

COARSE = 2
"""Pixels of the picture to one of the depth map."""

RIM_PX = 2
"""Width of the rim inside the outline whose colours are mixed with the background's."""

_LABEL_HEIGHT_PX = 480  # of the person, where pixels are labelled
_ARM_RIM_FRACTIONS = 0.006, 0.002  # of the height: mixed colours of the trunk about arms, and of arms at their edge
_EDGE_SIGMA_PX = 1.0  # of the border of known pixels
_FOREARM_REACH_FRACTION = 0.03  # of the height: forearms are at most this far from the fit's
_SHADOW_GAIN = 1.05  # from here on a pixel counts as shaded by an arm
_MIN_LAYER_PX = 20
_MIN_KNOWN = 0.9


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """A picture of one layer of the body."""

    picture: NDArray[np.float32]  # [H, W, 3] linear light, continued beyond the layer's own pixels
    known: NDArray[np.float32]  # [H, W] 1 where a pixel shows it
    far: NDArray[np.float32]  # [H, W] distance in pixels to the source of the colour


@dataclass(frozen=True, eq=False)
class PictureLayers:
    """The layers of one picture, ``rgb`` [H, W, 3] with ``mask`` [H, W]; all results are cached.

    The fields are those of ``FittedPicture``.
    """

    rgb: NDArray[np.uint8]
    mask: NDArray[np.bool_]
    focal: float
    view: FittedView
    mesh: RiggedMesh
    segment: NDArray[np.intp] | None
    bones: F64 | None

    @locked_cached_property
    def layer(self) -> NDArray[np.intp]:
        """[V] layer of each vertex; 0 where the body has one layer only."""
        return np.zeros(len(self.mesh.vertices), np.intp) if self.segment is None else layer_of(self.segment)

    @locked_cached_property
    def height(self) -> float:
        """Height of the person in pixels."""
        rows = np.flatnonzero(self.mask.any(axis=1))
        return float(rows[-1] - rows[0] + 1)

    @locked_cached_property
    def _labels(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Layers of the picture's pixels and segments of the body, both smaller than the picture."""
        assert self.segment is not None
        scale = min(1.0, _LABEL_HEIGHT_PX / self.height)
        ids, _ = self._rasterize(self.mesh.faces, scale)
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

    @locked_cached_property
    def label(self) -> NDArray[np.intp]:
        """[H, W] the layer that each pixel shows, negative for none."""
        return upscale_labels(self._labels[0], self.mask.shape)

    @locked_cached_property
    def agreed(self) -> NDArray[np.bool_]:
        """[H, W] where picture and fitted body show the same layer, without a shadow of an arm."""
        if self.segment is None:
            return self.mask
        segment = self._labels[1]
        covered = upscale_labels(layer_of(segment), self.mask.shape)
        own = (self.label == covered) | ((covered < 0) & (self.label >= 0))
        return np.asarray(self.mask & own & (self._shadow_gain < _SHADOW_GAIN))

    @locked_cached_property
    def _shadow_gain(self) -> NDArray[np.float32]:
        """[H, W] the factor that removes arms' shadows from the trunk."""
        trunk = self._rasterize(self._faces(0), min(1.0, _LABEL_HEIGHT_PX / self.height))[0] >= 0
        fore = np.isin(self._labels[1], FOREARMS).astype(np.uint8)  # upper arms hang beside the trunk
        reach = round(_FOREARM_REACH_FRACTION * min(self.height, _LABEL_HEIGHT_PX))
        covered = trunk & (cv2.dilate(fore, disc(reach)) > 0)
        arms = (self.label > 0) & (upscale_labels(covered.astype(np.intp), self.mask.shape) > 0)
        return shadow_gain(linear_light(self.rgb), self.label == 0, arms, self.height)

    def _faces(self, number: int) -> NDArray[np.int32]:
        """Return [F, 3] the faces of a layer."""
        return self.mesh.faces[(self.layer[self.mesh.faces] == number).all(axis=1)]

    @locked_cached_property
    def layers(self) -> list[Layer]:
        """Each layer; the trunk's is continued behind the arms, and cloth behind things that occlude it."""
        inner = cv2.erode(self.mask.astype(np.uint8), disc(RIM_PX)) > 0
        if not inner.any():
            inner = self.mask
        if self.segment is None:
            return [self._layer_of(inner, np.ones(self.mask.shape, np.float32))]

        def extract(number: int) -> Layer:
            depth = cv2.resize(self.depths[number], inner.shape[::-1], interpolation=cv2.INTER_NEAREST)
            covered = np.isfinite(depth)
            other = self.mask & (self.label != number) if number == 0 else self.label != number
            near = disc(max(1, round(_ARM_RIM_FRACTIONS[min(number, 1)] * self.height)))
            own = inner & ~(cv2.dilate(other.astype(np.uint8), near) > 0)
            known = cv2.GaussianBlur(own.astype(np.float32), (0, 0), _EDGE_SIGMA_PX)
            layer = self._layer_of(own if own.sum() > _MIN_LAYER_PX else inner, known)
            if number == 0:
                used = cv2.dilate((covered | self.mask).astype(np.uint8), disc(2 * COARSE)) > 0
                hole = (self.label != 0) & used
                layer = replace(layer, picture=np.minimum(layer.picture * self._shadow_gain[..., None], 1))
                filled = fill_hole(layer.picture, inner & ~hole & (layer.known > _MIN_KNOWN), hole, self.height)
                layer = replace(layer, picture=filled, far=np.zeros_like(layer.far))
            known = inner & (layer.known > _MIN_KNOWN)
            picture = continue_cloth(layer.picture, known, covered, self.label, number)
            carried = np.where((picture == layer.picture).all(axis=2), layer.far, np.float32(0))
            return replace(layer, picture=picture, far=carried)

        return map_threads(extract, range(LAYER_COUNT))

    def _layer_of(self, own: NDArray[np.bool_], known: NDArray[np.float32]) -> Layer:
        nearest, row, column, far = nearest_known_labels(own)
        return Layer(linear_light(self.rgb[row, column])[nearest], known, far)

    @locked_cached_property
    def depths(self) -> list[NDArray[np.float32]]:
        """[H / 2, W / 2] of each layer the camera z of its nearest surface, infinite without any."""
        if self.segment is None:
            return [self._depth_of(self.mesh.faces)]
        return map_threads(lambda number: self._depth_of(self._faces(number)), range(LAYER_COUNT))

    def _depth_of(self, faces: NDArray[np.int32]) -> NDArray[np.float32]:
        ids, bary = self._rasterize(faces, 1 / COARSE)
        depth = np.full(ids.shape, np.inf, np.float32)
        hit = ids >= 0
        depth[hit] = component_sums(bary[hit] * self.view.vertices[faces[ids[hit]], 2])
        return depth

    def _rasterize(self, faces: NDArray[np.int32], scale: float) -> tuple[NDArray[np.int64], F64]:
        return rasterize(self.mesh, self.view.vertices, self.focal, self.mask.shape, faces, scale)

    @locked_cached_property
    def details(self) -> list[NDArray[np.float32]]:
        """[H, W] of each layer the detail, from 0, plain, to 1."""
        return map_threads(lambda layer: detail_of(layer.picture), self.layers)

    @locked_cached_property
    def reliefs(self) -> list[NDArray[np.float32]]:
        """[H, W] of each layer the ``relief_of`` its pixels."""
        return map_threads(lambda layer: relief_of(layer.picture, layer.known > _MIN_KNOWN, self.height), self.layers)

    @locked_cached_property
    def background(self) -> tuple[float, NDArray[np.float32]]:
        """Return a smaller picture's scale, and its linear background, continued into the person."""
        scale = min(1.0, _LABEL_HEIGHT_PX / self.height)
        size = tuple(max(1, int(side * scale)) for side in self.mask.shape[::-1])
        mask = cv2.dilate(cv2.resize(self.mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST), disc(RIM_PX))
        row, column = nearest_known(mask == 0)
        small = cv2.resize(self.rgb, size, interpolation=cv2.INTER_AREA)
        return scale, linear_light(np.asarray(small[row, column], np.uint8))

    @locked_cached_property
    def outline_distances(self) -> tuple[float, list[NDArray[np.float32]]]:
        """Return the same scale, and each layer's distances from its outline, over the person's height."""
        scale = min(1.0, _LABEL_HEIGHT_PX / self.height)
        size = tuple(max(1, int(side * scale)) for side in self.mask.shape[::-1])
        label = np.where(self.mask, 0 if self.segment is None else self.label, -1).astype(np.int16)
        small = cv2.resize(label, size, interpolation=cv2.INTER_NEAREST)
        shown = [(small == number).astype(np.uint8) for number in range(1 if self.segment is None else LAYER_COUNT)]
        return scale, [
            np.asarray(cv2.distanceTransform(some, cv2.DIST_L2, 3) / (scale * self.height), np.float32)
            for some in shown
        ]


def rasterize(
    mesh: RiggedMesh, vertices: F64, focal: float, shape: tuple[int, ...], faces: NDArray[np.int32], scale: float
) -> tuple[NDArray[np.int64], F64]:
    """Return the face of each pixel, of ``faces`` of a mesh, and the barycentric place on it, as ``visible_faces``.

    ``vertices`` [V, 3] are in the camera's axes; ``focal`` and ``shape`` [H, W] in pixels, before scaling by ``scale``.
    """
    height, width = (int(side * scale) for side in shape)
    middle = np.array(shape[::-1]) * scale / 2
    lens = np.array([[focal * scale, 0, middle[0]], [0, focal * scale, middle[1]], [0, 0, 1]])
    white = np.full((1, 1, 4), 255, np.uint8)
    some = replace(mesh, parts=(MeshPart("", faces, np.zeros((*faces.shape, 2)), white),))
    return visible_faces(some, vertices, Camera(np.eye(4), lens, width, height))


def _joints(*names: str) -> list[int]:
    return [index for index, joint in enumerate(JOINT_NAMES) if any(name in joint for name in names)]
