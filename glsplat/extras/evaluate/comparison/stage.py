"""The stage renders a participant's truth and any number of avatars with the same cameras at the same moments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera
from glsplat.errors import FormatError
from glsplat.extras.authoring.mesh_truth import MeshTruth
from glsplat.extras.evaluate.comparison.parts import labelled_mesh, labels_of, regions
from glsplat.extras.evaluate.comparison.performance import Performance
from glsplat.extras.evaluate.comparison.protocol import Protocol, eyes
from glsplat.extras.evaluate.light import CaptureLight, shade_of
from glsplat.gl.context import create_context
from glsplat.meshes import RiggedMesh
from glsplat.renderer import Renderer
from glsplat.scene import Rigged
from glsplat.skinning.pose import Pose

Picture = NDArray[np.uint8]
_REACH = 0.02  # share of the picture; pixels farther from the figure belong to no body part


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
        self._figures: list[Renderer] = []
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

    def add(self, figure: Rigged) -> int:
        """Add an avatar and return its number for ``draw``."""
        renderer = Renderer(figure, size=self._size, views=2, context=self._context)
        self._stack.callback(renderer.release)
        self._figures.append(renderer)
        return len(self._figures) - 1

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

    def draw(self, figure: int, cameras: Sequence[Camera], pose: Pose) -> Picture:
        """Render an avatar in a pose for both eyes [2, H, W, 4]."""
        return self._figures[figure].render(cameras, pose)

    def release(self) -> None:
        """Delete all renderers and the context."""
        self._stack.close()

    def __enter__(self) -> Stage:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()
