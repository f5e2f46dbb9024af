"""KeyPass: a sortable depth a splat, or the reason why no view draws it. A vertex shader with transform feedback."""

from __future__ import annotations

import moderngl
import numpy as np
from numpy.typing import NDArray

from glsplat.passes.arena import Arena
from glsplat.shaders import Programs, Variant

__all__ = ["KeyPass"]


class KeyPass:
    """A sortable depth a splat, or the reason why no view draws it, the tiles it touches, and what it costs.

    For the GPU sorter into two buffers. For the host into one, row by row: of two, Mesa's softpipe (22.3.6) leaves the
    second unwritten when it was drawn from in between.
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
        count = self._count = arena.count
        self._outputs = [spare] if keys is None else [keys, spare]
        content: list[tuple[object, ...]] = [] if arena.cones is None else [(arena.cones, "4i1", "cone")]
        content += [] if arena.numbers is None else [(arena.numbers, "1u4", "number")]
        self._array = ctx.vertex_array(program, content)
        self._rows = np.empty((count if keys is None else 0, 3), np.uint32)
        self._columns = np.empty((3, len(self._rows)), np.uint32)

    def run(self) -> None:
        """Write keys, tiles and costs."""
        self._array.transform(self._outputs, moderngl.POINTS, vertices=self._count)

    def read(self) -> tuple[NDArray[np.uint32], NDArray[np.uint32], NDArray[np.uint32]]:
        """[N] the keys, [N] the packed tiles and [N] blocks of 4x4 pixels a splat covers (0: not drawn), on the host.

        To be read before the records are written; the arrays are reused by the next call.
        """
        if self._count:
            self._outputs[0].read_into(self._rows, size=self._rows.nbytes)
            self._columns[:] = self._rows.T  # what follows goes through them one by one
        keys, tiles, costs = self._columns
        return keys, tiles, costs

    def release(self) -> None:
        """Delete the vertex array."""
        self._array.release()
