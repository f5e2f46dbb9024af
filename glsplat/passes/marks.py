"""Marks: the tiles of the marks drawn last, on the GPU."""

from __future__ import annotations

import moderngl

from glsplat.gl.context import Context
from glsplat.passes.kept import Kept
from glsplat.watermark.mark import Mark
from glsplat.watermark.pattern import TILE

__all__ = ["Marks"]

_KEPT = 64
"""Tiles, 16 KiB each; as many sessions can take turns without any being made anew."""


class _Tile:
    def __init__(self, context: Context, mark: Mark) -> None:
        self.texture: moderngl.Texture = context.ctx.texture((TILE, TILE), 1, mark.tile(), dtype="f4")
        self.texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self.nbytes = TILE * TILE * 4

    def release(self) -> None:
        self.texture.release()


class Marks:
    """Owns a texture for each of the marks used last."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._tiles: Kept[Mark, _Tile] = Kept(_KEPT, 2**30)

    @property
    def nbytes(self) -> int:
        """GPU bytes of the textures."""
        return self._tiles.nbytes

    def tile(self, mark: Mark) -> moderngl.Texture:
        """[TILE, TILE] float32, row 0 the top one."""
        return self._tiles.get(mark, lambda: _Tile(self._context, mark)).texture

    def release(self) -> None:
        """Delete the textures; asking for one afterwards makes it anew."""
        self._tiles.release()
