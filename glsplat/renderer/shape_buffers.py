"""ShapeBuffers: the shapes of an avatar on the GPU, staged once, and the weights of the moment."""

from __future__ import annotations

from contextlib import ExitStack

import moderngl
import numpy as np
from numpy.typing import NDArray

from glsplat.errors import ContextError
from glsplat.shaders.slots import UNITS
from glsplat.skinning.shapes import Shapes

__all__ = ["ShapeBuffers"]

_ROW = 1024  # entries a row of the texture (shapes.glsl)


class ShapeBuffers:
    """Entries, each splat's range of them, and a texture of weights; ``stack`` owns all of it."""

    def __init__(self, ctx: moderngl.Context, shapes: Shapes, stack: ExitStack) -> None:
        entries = shapes.texels()
        height = -(-len(entries) // _ROW)
        limit = int(ctx.info["GL_MAX_TEXTURE_SIZE"])
        if height > limit:
            raise ContextError(f"{len(entries)} entries of shapes, but this driver's textures hold {limit * _ROW}")
        padded = np.zeros((height * _ROW, 4), np.uint32)
        padded[: len(entries)] = entries
        self._shapes = shapes
        self._entries = ctx.texture((_ROW, height), 4, padded, dtype="u4")
        stack.callback(self._entries.release)
        self._amounts = ctx.texture((len(shapes), 1), 2, dtype="f4")
        stack.callback(self._amounts.release)
        for texture in (self._entries, self._amounts):
            texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        ranges = np.stack([shapes.starts[:-1], shapes.starts[1:]], axis=1).astype(np.uint32)
        self._ranges = ctx.buffer(ranges)
        stack.callback(self._ranges.release)

    @property
    def nbytes(self) -> int:
        """GPU bytes."""
        return _ROW * self._entries.height * 16 + self._amounts.width * 8 + self._ranges.size

    @property
    def content(self) -> tuple[object, ...]:
        """The attribute of shapes.glsl."""
        return (self._ranges, "2u4", "range")

    def use(self, weights: NDArray[np.float64]) -> None:
        """Write the weights [T] and bind the textures."""
        self._amounts.write(self._shapes.amounts(weights))
        self._entries.use(UNITS["entries"])
        self._amounts.use(UNITS["amounts"])
