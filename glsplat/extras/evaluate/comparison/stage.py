"""The stage renders a participant's truth and any number of avatars with the same cameras at the same moments.

The pixels of the participant's pictures are assigned to body parts.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera
from glsplat.errors import FormatError
from glsplat.extras.authoring.mesh_truth import MeshTruth
from glsplat.extras.evaluate.comparison.protocol import Performance, Protocol, eyes
from glsplat.extras.evaluate.turntable import CaptureLight, shade_of
from glsplat.gl.context import create_context
from glsplat.meshes import MeshPart, RiggedMesh
from glsplat.renderer import Renderer
from glsplat.scene import Rigged
from glsplat.skinning.skin import strongest_joint

PARTS = ("face", "head", "hands", "torso", "legs")
"""The face is the front of the head without hair; ``head`` is the rest of it, ``torso`` has the arms."""

_HEAD = ("head", "jaw", "left_eye", "right_eye")
_HANDS = tuple(
    f"{side}_{name}" for side in ("left", "right") for name in ("wrist", "index", "middle", "pinky", "ring", "thumb")
)
_LEGS = tuple(f"{side}_{name}" for side in ("left", "right") for name in ("hip", "knee", "ankle", "foot"))
_HAIR = ("hair",)
_STEP = 40  # levels of 255 between the greys of two parts

_FRONT = 0.03  # metres in front of the head joint: between ears and face

Picture = NDArray[np.uint8]
_REACH = 0.02  # share of the picture; pixels farther from the figure belong to no body part


def labelled_mesh(mesh: RiggedMesh) -> RiggedMesh:
    """Return the mesh with each triangle in the grey of its part; for a renderer with one sample per pixel."""
    kinds = np.concatenate([_kinds(mesh, part) for part in mesh.parts])
    faces, parts = mesh.faces, []
    for index, name in enumerate(PARTS):
        mine = faces[kinds == index]
        if len(mine):
            grey = np.full((2, 2, 4), 255, np.uint8)
            grey[..., :3] = _STEP * (index + 1)
            parts.append(MeshPart(name, mine, np.zeros((*mine.shape, 2)), grey))
    return RiggedMesh(mesh.vertices, mesh.skeleton, mesh.joints, mesh.weights, tuple(parts))


def labels_of(picture: NDArray[np.uint8]) -> NDArray[np.int8]:
    """Return the part (index into PARTS) [H, W] in a picture [H, W, 4] of a labelled mesh, -1 for none."""
    return np.asarray(np.where(picture[..., 3] > 127, np.rint(picture[..., 0] / _STEP).astype(int) - 1, -1), np.int8)


def regions(labels: NDArray[np.int8], reach: int) -> NDArray[np.int8]:
    """Return labels [H, W] with background pixels within ``reach`` pixels of a part assigned to the nearest one.

    Pixels that an avatar wrongly covers beside the person so count as errors of that part.
    """
    empty = labels < 0
    if empty.all():
        return labels
    away, nearest = cv2.distanceTransformWithLabels(
        empty.astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    of = np.full(int(nearest.max()) + 1, -1, np.int8)
    of[nearest[~empty]] = labels[~empty]
    return np.where(away <= reach, of[nearest], np.int8(-1))


def _kinds(mesh: RiggedMesh, part: MeshPart) -> NDArray[np.intp]:
    """Return each triangle's index into PARTS [F], by the strongest joint of its first corner."""
    corner = part.faces[:, 0]
    strongest = strongest_joint(mesh.joints, mesh.weights)[corner]
    names = mesh.skeleton.names
    out = np.full(len(corner), PARTS.index("torso"))
    for kind, starts in (("head", _HEAD), ("hands", _HANDS), ("legs", _LEGS)):
        out[np.array([name.startswith(starts) for name in names])[strongest]] = PARTS.index(kind)
    if "head" in names and not part.name.startswith(_HAIR):
        before = mesh.vertices[part.faces].mean(axis=1)[:, 2] > mesh.skeleton.joints[names.index("head"), 2] + _FRONT
        out[(out == PARTS.index("head")) & before] = PARTS.index("face")
    return out


@dataclass(frozen=True, eq=False)
class StageTruth:
    """The true pictures of both eyes at one moment from one side."""

    cameras: tuple[Camera, Camera]
    pictures: Picture  # [2, H, W, 4] RGBA
    regions: NDArray[np.int8]  # [2, H, W] index into PARTS, -1 for none


class Stage:
    """Renderers of one participant and of avatars, on one context; release it on the thread that made it.

    ``light`` is the note of the participant's photograph, for a protocol with the light of the capture.
    """

    def __init__(
        self, mesh: RiggedMesh, performance: Performance, protocol: Protocol, light: Mapping[str, Any] | None = None
    ) -> None:
        self._mesh, self._performance, self._protocol = mesh, performance, protocol
        self._used = np.unique(mesh.faces)
        self._size = (protocol.size, protocol.size)
        self._reach = round(_REACH * protocol.size)
        self._posed: tuple[int, NDArray[np.float64]] = -1, mesh.vertices
        lit = protocol.light == "capture"
        if lit and light is None:
            raise FormatError('the light of the photograph is not known ("light" in capture/NAME.json); compare unlit')
        self._light = CaptureLight.of_note(light) if lit and light is not None else None
        self._shade: NDArray[np.float64] | None = None  # of the posed vertices
        with ExitStack() as stack:
            self._context = create_context()
            stack.callback(self._context.release)
            self._truth = MeshTruth(mesh, size=self._size, context=self._context)
            stack.callback(self._truth.release)
            parts = labelled_mesh(mesh)
            self._parts = MeshTruth(parts, size=self._size, samples=1, supersample=1, context=self._context)
            stack.callback(self._parts.release)
            self._stack = stack.pop_all()

    @property
    def driver(self) -> str:
        """Renderer and version strings of the driver."""
        return self._context.driver

    def add(self, figure: Rigged) -> Renderer:
        """Add an avatar and return its renderer of both eyes."""
        renderer = Renderer(figure, size=self._size, views=2, context=self._context)
        self._stack.callback(renderer.release)
        return renderer

    def truth(self, moment: int, view: str) -> StageTruth:
        """Render the participant at a moment of the performance, from a side."""
        pose = self._performance.pose(moment)
        if self._posed[0] != moment:
            vertices = self._mesh.posed(pose)
            self._posed = moment, vertices
            self._shade = None if self._light is None else shade_of(self._mesh, vertices, self._light)
        cameras = eyes(self._posed[1][self._used], view, self._protocol)
        pictures = self._truth.render(cameras, pose, shade=self._shade)
        labels = self._parts.render(cameras, pose)
        return StageTruth(cameras, pictures, np.stack([regions(labels_of(one), self._reach) for one in labels]))

    def release(self) -> None:
        """Delete all renderers and the context."""
        self._stack.close()

    def __enter__(self) -> Stage:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()
