"""Key: a sortable depth per splat, or the reason why no view draws it. A vertex shader with transform feedback."""

from __future__ import annotations

from collections.abc import Sequence

import moderngl
import numpy as np
from numpy.typing import NDArray

from glsplat.renderer.arena import Arena
from glsplat.shaders import Programs, Variant

BLOCK_PIXELS = 16
"""Pixels of a block of 4x4, in which key.vert.glsl counts costs: rasterizers work on whole blocks."""

_ROW_BYTES = 12  # key, tiles, cost


class KeyPass:
    """Writes a row a splat: its key, the tiles that it touches and its cost.

    One buffer, as Mesa's softpipe (22.3.6) leaves the second of two unwritten if it was drawn from in between.
    """

    def __init__(
        self,
        ctx: moderngl.Context,
        programs: Programs,
        variant: Variant,
        arena: Arena,  # borrowed
        rows: moderngl.Buffer,  # 12 bytes a splat or more, borrowed: the records', free until they are made
    ) -> None:
        program = programs.feedback("key", variant, ("key", "cover"))
        self._output = rows
        content: list[tuple[object, ...]] = [] if arena.cones is None else [(arena.cones, "4i1", "cone")]
        content += [] if arena.numbers is None else [(arena.numbers, "1u4", "number")]
        self._array = ctx.vertex_array(program, content)
        self._found = 0
        self._rows = np.empty((arena.most, 3), np.uint32)
        self._columns = np.empty((3, len(self._rows)), np.uint32)

    def run(self, ranges: Sequence[tuple[int, int]]) -> None:
        """Write the rows of the splats in ``ranges``, first index and number of each, one after the other."""
        self._found = 0
        for first, count in ranges:
            place = self._found * _ROW_BYTES
            self._array.transform(self._output, moderngl.POINTS, count, first=first, buffer_offset=place)
            self._found += count

    def read(self) -> tuple[NDArray[np.uint32], NDArray[np.uint32], NDArray[np.uint32]]:
        """Read back keys [N], packed tiles [N] and covered blocks of 4x4 pixels [N] (0: not drawn).

        N are the splats of the ranges, in their order. Call it before the records are written, or the GPU sorts; the
        next call reuses the arrays.
        """
        rows, columns = self._rows[: self._found], self._columns[:, : self._found]
        if self._found:
            self._output.read_into(rows, size=rows.nbytes)
            columns[:] = rows.T  # contiguous columns: they are used one by one
        keys, tiles, costs = columns
        return keys, tiles, costs

    def release(self) -> None:
        """Delete the vertex array."""
        self._array.release()
