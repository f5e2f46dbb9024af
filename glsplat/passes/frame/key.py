"""KeyPass: a sortable depth a splat, or the reason why no view draws it. A vertex shader with transform feedback."""

from __future__ import annotations

import moderngl
import numpy as np
from numpy.typing import NDArray

from glsplat.shaders import Programs, Variant

__all__ = ["KeyPass"]


class KeyPass:
    """A sortable depth a splat, or the reason why no view draws it, the tiles it touches, and what it costs."""

    def __init__(
        self,
        ctx: moderngl.Context,
        programs: Programs,
        variant: Variant,
        cones: moderngl.Buffer | None,  # [N, 4] int8, borrowed
        count: int,
        keys: moderngl.Buffer,  # [N] uint32, borrowed
        cover: moderngl.Buffer,  # [N, 2] uint32, borrowed: the records', free until they are made
    ) -> None:
        program = programs.feedback("key", variant, ("key", "cover"), separate=True)
        self._count = count
        self._keys, self._cover = keys, cover
        self._array = ctx.vertex_array(program, [(cones, "4i1", "cone")] if cones is not None else [])
        self._host = np.empty(count, np.uint32), np.empty((count, 2), np.uint32)

    def run(self) -> None:
        """Write keys, tiles and costs."""
        self._array.transform([self._keys, self._cover], moderngl.POINTS, vertices=self._count)

    def read(self) -> tuple[NDArray[np.uint32], NDArray[np.uint32], NDArray[np.uint32]]:
        """[N] the keys, [N] the packed tiles and [N] blocks of 4x4 pixels a splat covers (0: not drawn), on the host.

        To be read before the order and the records are written; the arrays are reused by the next call.
        """
        keys, cover = self._host
        if self._count:
            self._keys.read_into(keys, size=keys.nbytes)
            self._cover.read_into(cover, size=cover.nbytes)
        return keys, cover[:, 0], cover[:, 1]

    def release(self) -> None:
        """Delete the vertex array."""
        self._array.release()
