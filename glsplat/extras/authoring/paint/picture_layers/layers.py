"""What a picture shows of each layer of the body that was fitted to it, carried on where another layer lies before."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera
from glsplat.extras.authoring.body.segments import FOREARMS, HANDS, LAYERS, layer_of
from glsplat.extras.authoring.compute.threads import abreast, found_once
from glsplat.extras.authoring.fit.body_fit import FittedView
from glsplat.extras.authoring.geometry.raster import visible_faces
from glsplat.extras.authoring.paint.picture_layers.fill import continued, disc, nearest_known, sources
from glsplat.extras.authoring.paint.picture_layers.labels import labels_of
from glsplat.extras.authoring.paint.picture_layers.patches import woven
from glsplat.extras.authoring.paint.picture_layers.shadows import brightening
from glsplat.extras.authoring.paint.pixels import busy, grown, linear
from glsplat.meshes import MeshPart, RiggedMesh
from glsplat.rotations import component_sums
from glsplat.skinning.skin import strongest_joint
from glsplat.skinning.smplx import JOINT_NAMES

__all__ = ["COARSE", "RIM", "Layer", "ShownLayers", "drawn"]

F64 = NDArray[np.float64]

COARSE = 2
"""Pixels of the picture to one of the depth map."""

RIM = 2
"""Pixels inside the outline whose colours are mixed with the room's."""

_LABELLED = 480  # pixels of the person's height that are labelled
_MIXED = 0.006, 0.002  # of the height: about arms the trunk's colours are mixed with theirs, and theirs at their edge
_SOFT = 1.0  # pixels over which what is known ends
_ABOUT = 0.03  # of the height: so near to where the fit has a forearm there may be one
_SHADED = 1.05  # times as bright without an arm's shadow: from there on it is one
_FEWEST = 20  # pixels of a layer that is seen at all


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """What a picture shows of one layer of the body."""

    picture: NDArray[np.float32]  # [H, W, 3] linear light, carried on beyond what is its own
    depth: NDArray[np.float32]  # [H / 2, W / 2] camera z of its nearest surface, infinite where there is none
    known: NDArray[np.float32]  # [H, W] 1 where a pixel shows it
    far: NDArray[np.float32]  # [H, W] pixels that the colour was carried


@dataclass(frozen=True, eq=False)
class ShownLayers:
    """The layers of one picture, ``rgb`` [H, W, 3] with ``mask`` [H, W]; all that is found is kept.

    The fields are those of ``FittedPicture``.
    """

    rgb: NDArray[np.uint8]
    mask: NDArray[np.bool_]
    focal: float
    view: FittedView
    mesh: RiggedMesh
    segment: NDArray[np.intp] | None
    bones: F64 | None

    @found_once
    def layer(self) -> NDArray[np.intp]:
        """[V] of the vertices; 0 where the body has one layer only."""
        return np.zeros(len(self.mesh.vertices), np.intp) if self.segment is None else layer_of(self.segment)

    @found_once
    def height(self) -> float:
        """Pixels of the person."""
        rows = np.flatnonzero(self.mask.any(axis=1))
        return float(rows[-1] - rows[0] + 1)

    @found_once
    def _labelled(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """What the picture shows, and the body's segments, both smaller than the picture."""
        assert self.segment is not None
        scale = min(1.0, _LABELLED / self.height)
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

    @found_once
    def label(self) -> NDArray[np.intp]:
        """[H, W] the layer that each pixel shows, below zero none."""
        return grown(self._labelled[0], self.mask.shape)

    @found_once
    def agreed(self) -> NDArray[np.bool_]:
        """[H, W] where the picture shows what the fitted body shows, and no shadow of an arm lies on it."""
        if self.segment is None:
            return self.mask
        segment = self._labelled[1]
        there = grown(layer_of(segment), self.mask.shape)
        own = (self.label == there) | ((there < 0) & (self.label >= 0))
        return np.asarray(self.mask & own & (self._brightening < _SHADED))

    @found_once
    def _brightening(self) -> NDArray[np.float32]:
        """[H, W] how many times as bright the trunk is without arms' shadows."""
        trunk = self._drawn(self._faces(0), min(1.0, _LABELLED / self.height))[0] >= 0
        fore = np.isin(self._labelled[1], FOREARMS).astype(np.uint8)  # upper arms hang beside it
        there = trunk & (cv2.dilate(fore, disc(round(_ABOUT * min(self.height, _LABELLED)))) > 0)
        arms = (self.label > 0) & (grown(there.astype(np.intp), self.mask.shape) > 0)
        return brightening(linear(self.rgb), self.label == 0, arms, self.height)

    def _faces(self, number: int) -> NDArray[np.int32]:
        """[F, 3] of a layer."""
        return self.mesh.faces[(self.layer[self.mesh.faces] == number).all(axis=1)]

    @found_once
    def layers(self) -> list[Layer]:
        """Each layer; the trunk's goes on behind the arms, and cloth behind what is in its way."""
        inner = cv2.erode(self.mask.astype(np.uint8), disc(RIM)) > 0
        if not inner.any():
            inner = self.mask
        if self.segment is None:
            return [self._layer_of(inner, np.ones(self.mask.shape, np.float32), self.mesh.faces)]

        def cut(number: int) -> Layer:
            other = self.mask & (self.label != number) if number == 0 else self.label != number
            near = disc(max(1, round(_MIXED[min(number, 1)] * self.height)))
            own = inner & ~(cv2.dilate(other.astype(np.uint8), near) > 0)
            known = cv2.GaussianBlur(own.astype(np.float32), (0, 0), _SOFT)
            seen = self._layer_of(own if own.sum() > _FEWEST else inner, known, self._faces(number))
            if number == 0:
                hole = self.label != 0
                seen = replace(seen, picture=np.minimum(seen.picture * self._brightening[..., None], 1))
                filled = continued(seen.picture, inner & ~hole & (seen.known > 0.9), hole, self.height)
                seen = replace(seen, picture=filled, far=np.zeros_like(seen.far))
            there = cv2.resize(seen.depth, inner.shape[::-1], interpolation=cv2.INTER_NEAREST)
            picture = woven(seen.picture, inner & (seen.known > 0.9), np.isfinite(there), self.label, number)
            carried = np.where((picture == seen.picture).all(axis=2), seen.far, np.float32(0))
            return replace(seen, picture=picture, far=carried)

        return abreast(cut, range(LAYERS))

    def _layer_of(self, own: NDArray[np.bool_], known: NDArray[np.float32], faces: NDArray[np.int32]) -> Layer:
        nearest, row, column = sources(own)
        picture = linear(self.rgb[row, column])[nearest]
        there = np.indices(own.shape, np.int32)
        far = np.hypot(row[nearest] - there[0], column[nearest] - there[1]).astype(np.float32)
        ids, bary = self._drawn(faces, 1 / COARSE)
        depth = np.full(ids.shape, np.inf, np.float32)
        hit = ids >= 0
        depth[hit] = component_sums(bary[hit] * self.view.vertices[faces[ids[hit]], 2])
        return Layer(picture, depth, known, far)

    def _drawn(self, faces: NDArray[np.int32], scale: float) -> tuple[NDArray[np.int64], F64]:
        return drawn(self.mesh, self.view.vertices, self.focal, self.mask.shape, faces, scale)

    @found_once
    def details(self) -> list[NDArray[np.float32]]:
        """[H, W] of each layer the local spread of colour, as a share of what counts as full of detail."""
        return abreast(lambda seen: busy(seen.picture), self.layers)

    @found_once
    def room(self) -> tuple[float, NDArray[np.float32]]:
        """Of a smaller picture its scale, and the room's colours carried on into the person."""
        scale = min(1.0, _LABELLED / self.height)
        size = tuple(max(1, int(side * scale)) for side in self.mask.shape[::-1])
        mask = cv2.dilate(cv2.resize(self.mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST), disc(RIM))
        row, column = nearest_known(mask == 0)
        small = cv2.resize(self.rgb, size, interpolation=cv2.INTER_AREA)
        return scale, linear(np.asarray(small[row, column], np.uint8))

    @found_once
    def deep(self) -> tuple[float, list[NDArray[np.float32]]]:
        """The same scale, and for each layer how deep in it its pixels lie, in heights of the person."""
        scale = min(1.0, _LABELLED / self.height)
        size = tuple(max(1, int(side * scale)) for side in self.mask.shape[::-1])
        label = np.where(self.mask, 0 if self.segment is None else self.label, -1).astype(np.int16)
        small = cv2.resize(label, size, interpolation=cv2.INTER_NEAREST)
        shown = [(small == number).astype(np.uint8) for number in range(1 if self.segment is None else LAYERS)]
        return scale, [
            np.asarray(cv2.distanceTransform(some, cv2.DIST_L2, 3) / (scale * self.height), np.float32)
            for some in shown
        ]


def drawn(
    mesh: RiggedMesh, vertices: F64, focal: float, shape: tuple[int, ...], faces: NDArray[np.int32], scale: float
) -> tuple[NDArray[np.int64], F64]:
    """Which of the ``faces`` of a mesh a picture shows, and where on them; see ``visible_faces``.

    ``vertices`` [V, 3] are in its camera's axes; ``focal`` and ``shape`` [H, W] its own in pixels, before it is made
    smaller by ``scale``.
    """
    height, width = (int(side * scale) for side in shape)
    middle = np.array(shape[::-1]) * scale / 2
    lens = np.array([[focal * scale, 0, middle[0]], [0, focal * scale, middle[1]], [0, 0, 1]])
    white = np.full((1, 1, 4), 255, np.uint8)
    some = replace(mesh, parts=(MeshPart("", faces, np.zeros((*faces.shape, 2)), white),))
    return visible_faces(some, vertices, Camera(np.eye(4), lens, width, height))


def _joints(*names: str) -> list[int]:
    return [index for index, joint in enumerate(JOINT_NAMES) if any(name in joint for name in names)]
