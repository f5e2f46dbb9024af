"""Key: a sortable depth per splat, or the reason why no view draws it. A vertex shader with transform feedback."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import moderngl
import numpy as np
from numpy.typing import NDArray

from glsplat.renderer.arena import Arena
from glsplat.renderer.sort import NOT_SHOWN
from glsplat.shaders import Programs, Variant

__all__ = ["BLOCK_PIXELS", "KeyPass"]

BLOCK_PIXELS = 16
"""Pixels of a block of 4x4, in which key.vert.glsl counts costs: rasterizers work on whole blocks."""

_ROW_BYTES = 12  # key, tiles, cost


class KeyPass:
    """Writes a key per splat, the tiles that it touches and its cost.

    The GPU sorter reads two buffers. The host reads one, with a row a splat, as Mesa's softpipe (22.3.6) leaves the
    second of two unwritten if it was drawn from in between.
    """

    def __init__(
        self,
        ctx: moderngl.Context,
        programs: Programs,
        variant: Variant,
        arena: Arena,  # borrowed
        keys: moderngl.Buffer | None,  # [N] uint32, borrowed; None: the host sorts
        spare: moderngl.Buffer,  # 12 bytes a splat or more, borrowed: the records', free until they are made
    ) -> None:
        program = programs.feedback("key", variant, ("key", "cover"), separate=keys is not None)
        self._count = arena.count
        self._outputs = [spare] if keys is None else [keys, spare]
        content: list[tuple[object, ...]] = [] if arena.cones is None else [(arena.cones, "4i1", "cone")]
        content += [] if arena.numbers is None else [(arena.numbers, "1u4", "number")]
        self._array = ctx.vertex_array(program, content)
        self._found = 0
        self._rows = np.empty((arena.most if keys is None else 0, 3), np.uint32)
        self._columns = np.empty((3, len(self._rows)), np.uint32)

    def run(self, ranges: Sequence[tuple[int, int]]) -> None:
        """Write keys, tiles and costs of the splats in ``ranges``, first index and number of each.

        The host gets the ranges one after the other. For the GPU sorter every splat keeps its place, and splats outside
        of the ranges are marked as not shown.
        """
        if len(self._outputs) == 1:
            self._found = 0
            for first, count in ranges:
                place = self._found * _ROW_BYTES
                self._array.transform(self._outputs, moderngl.POINTS, count, first=first, buffer_offset=place)
                self._found += count
            return
        self._array.transform(self._outputs, moderngl.POINTS, self._count)
        keys, spare = self._outputs
        for first, end in _gaps(ranges, self._count):
            keys.write(np.full(end - first, NOT_SHOWN, np.uint32), offset=4 * first)
            spare.write(bytes(8 * (end - first)), offset=8 * first)

    def read(self) -> tuple[NDArray[np.uint32], NDArray[np.uint32], NDArray[np.uint32]]:
        """Read back keys [N], packed tiles [N] and covered blocks of 4x4 pixels [N] (0: not drawn).

        N are the splats of the ranges, in their order. Call it before the records are written; the next call reuses the
        arrays.
        """
        rows, columns = self._rows[: self._found], self._columns[:, : self._found]
        if self._found:
            self._outputs[0].read_into(rows, size=rows.nbytes)
            columns[:] = rows.T  # contiguous columns: they are used one by one
        keys, tiles, costs = columns
        return keys, tiles, costs

    def read_costs(self, ranges: Sequence[tuple[int, int]]) -> NDArray[np.uint32]:
        """Read back the costs [N] before the GPU sorts. Waits for the GPU."""
        found = np.frombuffer(self._outputs[-1].read(8 * self._count), np.uint32)[1::2]
        return np.concatenate([found[:0], *(found[first : first + count] for first, count in ranges)])

    def release(self) -> None:
        """Delete the vertex array."""
        self._array.release()


def _gaps(ranges: Sequence[tuple[int, int]], count: int) -> Iterator[tuple[int, int]]:
    """Yield first index and end of each gap before, between and after the ranges, up to ``count``."""
    at = 0
    for first, length in (*ranges, (count, 0)):
        if first > at:
            yield at, first
        at = first + length
