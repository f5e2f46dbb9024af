"""Target: a texture array with one layer a view and the framebuffer that renders to all of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera
from glsplat.passes.geometry import bind_frame
from glsplat.shaders import Programs, Variant

__all__ = ["FORMATS", "Resolve", "Target"]

FORMATS = {"8": "f1", "16f": "f2", "32f": "f4"}
"""RenderConfig.target -> moderngl dtype."""

_NUMPY = {"f1": np.uint8, "f2": np.float16, "f4": np.float32}


class Target:
    """Colour for V views of one size: premultiplied RGB over the background, and accumulated alpha."""

    def __init__(self, ctx: moderngl.Context, width: int, height: int, views: int, dtype: str) -> None:
        self._ctx = ctx
        self.shape = (views, height, width, 4)
        self.dtype = dtype
        self.texture = ctx.texture_array((width, height, views), 4, dtype=dtype)
        self.texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self.framebuffer = ctx.framebuffer([self.texture])

    @property
    def numpy_dtype(self) -> np.dtype[Any]:
        """numpy type of one channel."""
        return np.dtype(_NUMPY[self.dtype])

    def empty(self) -> NDArray[Any]:
        """A host array [V, H, W, 4] of the target's own number type, to read into."""
        return np.empty(self.shape, self.numpy_dtype)

    def read(self, out: NDArray[Any]) -> None:
        """Copy all layers to ``out``, row 0 first (the top row of the image)."""
        self.texture.read_into(out)

    @property
    def nbytes(self) -> int:
        """GPU bytes of the texture."""
        return int(np.prod(self.shape)) * self.numpy_dtype.itemsize

    def release(self) -> None:
        """Delete framebuffer and texture."""
        self.framebuffer.release()
        self.texture.release()


class Resolve:
    """Backgrounds before the splats, 8-bit conversion after them."""

    def __init__(self, ctx: moderngl.Context, programs: Programs, variant: Variant) -> None:
        self._ctx = ctx
        self._views = variant.views
        self._resolve = ctx.vertex_array(programs.draw("screen", "resolve", variant), [])
        background = programs.draw("screen", "background", variant)
        bind_frame(background)
        self._background = ctx.vertex_array(background, [])

    def clear(self, target: Target, cameras: Sequence[Camera]) -> None:
        """Fill the target with each view's background and alpha 0."""
        colours = {camera.background for camera in cameras}
        if len(colours) == 1:
            target.framebuffer.clear(*colours.pop(), 0.0)
            return
        target.framebuffer.use()
        self._ctx.enable_only(moderngl.NOTHING)
        self._background.render(moderngl.TRIANGLES, vertices=3, instances=self._views)

    def run(self, source: Target, into: Target) -> None:
        """Clamp and round the float ``source`` to the 8-bit ``into``."""
        into.framebuffer.use()
        self._ctx.enable_only(moderngl.NOTHING)
        source.texture.use(0)
        self._resolve.render(moderngl.TRIANGLES, vertices=3, instances=self._views)

    def release(self) -> None:
        """Delete the vertex arrays."""
        self._resolve.release()
        self._background.release()
