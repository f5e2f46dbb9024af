"""MeshTruth: pictures of a textured mesh that avatars made from it are measured against."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, Self

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from glsplat.arrays import F32, count, instance, own, pixels
from glsplat.camera import Camera
from glsplat.config import DebugConfig, Output, RenderConfig
from glsplat.errors import GlsplatError
from glsplat.gl.context import Context
from glsplat.meshes import RiggedMesh
from glsplat.renderer import Renderer
from glsplat.renderer.checks import Views, checked_views
from glsplat.scene import Item
from glsplat.skinning.pose import Pose

__all__ = ["MeshTruth"]


class MeshTruth:
    """Draws one mesh in larger pictures and box-filters them: ``samples * supersample ** 2`` points a pixel.

    Make, use and release it on one thread, as a Renderer.
    """

    def __init__(
        self,
        mesh: RiggedMesh,
        *,
        size: tuple[int, int] = (1024, 1024),  # width, height of the pictures
        supersample: int = 2,  # larger by this factor, 1 to 8
        samples: Literal[1, 4] = 4,  # of the renderer; 1 if the driver supports no more
        anisotropy: Literal[1, 2, 4, 8, 16] = 16,  # at most the driver's maximum
        output: Output = "uint8",
        context: Context | None = None,
    ) -> None:
        factor = count(supersample, "supersample", GlsplatError)
        if not 1 <= factor <= 8:
            raise GlsplatError(f"supersample needs 1 to 8, not {factor}")
        # as textures, colours have 8 bits: single samples keep them as they are, means of four need the float target
        config = RenderConfig(
            output="float32",
            target="8" if samples == 1 else "32f",
            debug=DebugConfig(mesh_samples=samples, mesh_anisotropy=anisotropy),
        )
        self.mesh: RiggedMesh = instance(mesh, RiggedMesh, "MeshTruth", GlsplatError)
        self.size: tuple[int, int] = pixels(size, error=GlsplatError)
        self._output = RenderConfig(output=output).output
        self._factor, self._item = factor, Item(mesh)
        large = (self.size[0] * factor, self.size[1] * factor)
        self._renderer = _MeshTruthRenderer(self._item, size=large, config=config, context=context)

    @property
    def context(self) -> Context:
        """The context in which the mesh is drawn."""
        return self._renderer.context

    def render(
        self,
        views: Views,
        pose: Pose | None = None,
        *,
        shade: ArrayLike | None = None,  # [N, 3] factors a vertex of the mesh, in linear light (evaluate/turntable.py)
    ) -> NDArray[Any]:
        """Return the images [V, H, W, 4], row 0 at the top: RGB over the background, and the covered share of a pixel.

        uint8, or float32 in [0, 1]. Colours are those of the textures; with ``shade`` they are taken for sRGB and
        multiplied in linear light. Raises PoseError for a pose that does not fit, GlsplatError for all else.
        """
        cameras = checked_views(views, self.size)
        self._item.pose = pose
        factors = None if shade is None else own(shade, np.float32, "shade", GlsplatError)
        if factors is not None and not (factors.shape == self.mesh.vertices.shape and np.isfinite(factors).all()):
            raise GlsplatError(f"shade needs {self.mesh.vertices.shape} finite factors, not {factors.shape}")
        self._renderer.factors = factors
        (width, height), factor = self.size, self._factor
        out = np.empty((len(cameras), height, width, 4), np.float32)
        for camera, image in zip(cameras, out, strict=True):  # one by one: large pictures take much memory
            large = self._renderer.render([camera.resized(width * factor, height * factor)])
            image[:] = cv2.resize(large[0], (width, height), interpolation=cv2.INTER_AREA)  # the mean, by whole factors
        return out if self._output == "float32" else np.rint(255 * np.clip(out, 0, 1)).astype(np.uint8)

    def release(self) -> None:
        """Delete every GL object, and the context if it was made here. May be called twice."""
        self._renderer.release()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()


class _MeshTruthRenderer(Renderer):
    """Renderer of one mesh, whose vertices are lit by ``factors`` [N, 3]."""

    factors: F32 | None = None

    def _update(self, cameras: Sequence[Camera], pose: Pose | None) -> list[Camera]:
        placed = super()._update(cameras, pose)
        (item,) = self._scene.scene
        self._scene.shade(item, self.factors)
        return placed
