"""Sort on the GPU: the order of sort.py by radix sort in compute shaders (OpenGL 4.3)."""

from __future__ import annotations

from contextlib import ExitStack

import moderngl
import numpy as np

from glsplat.errors import ContextError
from glsplat.renderer.owned import owned
from glsplat.renderer.sort import CULL_REASONS
from glsplat.shaders import Programs, set_uniforms

__all__ = ["GpuSorter"]

BLOCK_KEYS = 1024  # THREADS * RUN of radix.glsl
DIGIT_BITS = 4  # a pass; 32 and 16 bits both make an even number of passes, so the result ends where it began


class GpuSorter:
    """Sorts keys in place and writes the order; nothing is read back. Scratch space is borrowed."""

    def __init__(
        self,
        ctx: moderngl.Context,
        programs: Programs,
        keys: moderngl.Buffer,  # [N] uint32, overwritten
        order: moderngl.Buffer,  # [N] uint32
        scratch: moderngl.Buffer,  # >= 8 N bytes, free until the records are written; holds the costs [N] uint32
        count: int,
        views: int,
        bits: int = 32,  # 16: by the upper half of a key only
        corners: int = 4,  # vertices of an instance of the indirect draw
        pulled: bool = False,  # all vertices are in one instance
    ) -> None:
        if not self.fits(ctx, scratch):
            limit = ctx.info["GL_MAX_SHADER_STORAGE_BLOCK_SIZE"]
            raise ContextError(f"{count} splats exceed this driver's {limit} byte buffers; use sorter='cpu'")
        self._ctx, self._count, self._views = ctx, count, views
        self._start = np.array(([0, 1] if pulled else [corners, 0]) + [0] * 14, np.uint32)
        self._pulled_corners = corners if pulled else 0
        self._shifts = range(32 - bits, 32, DIGIT_BITS)
        self._buffers = (keys, order, scratch)
        self._groups = max(1, -(-count // BLOCK_KEYS))
        with ExitStack() as stack:  # releases everything if an allocation fails
            self._histogram = owned(stack, ctx.buffer(reserve=16 * self._groups * 4))
            # indirect draw (4 uints), counts by cull code (8), cost (2), 2 to spare
            self.indirect: moderngl.Buffer = owned(stack, ctx.buffer(reserve=64))
            self._stages = {name: programs.compute(f"radix_{name}") for name in ("init", "count", "scan", "scatter")}
            self._owned = stack.pop_all()

    @staticmethod
    def fits(ctx: moderngl.Context, scratch: moderngl.Buffer) -> bool:
        """Return whether shaders can bind the largest buffer."""
        return scratch.size <= int(ctx.info["GL_MAX_SHADER_STORAGE_BLOCK_SIZE"])

    def run(self) -> None:
        """Sort the keys and write the order."""
        if not self._count:
            return
        keys, order, scratch = self._buffers
        self.indirect.write(self._start)
        for binding, buffer in enumerate((keys, order, scratch, self._histogram, self.indirect)):
            buffer.bind_to_storage_buffer(binding)
        self._dispatch(
            "init", -(-self._count // 512), views=self._views, corners=self._pulled_corners
        )  # 256 pairs of keys a group
        for index, shift in enumerate(self._shifts):
            settings = {"shift": shift, "odd": bool(index % 2)}
            self._dispatch("count", self._groups, **settings)
            self._dispatch("scan", 1, **settings)
            self._dispatch("scatter", self._groups, **settings)

    def counts(self) -> tuple[int, dict[str, int], int]:
        """Read back splats drawn, splats culled by reason, and the cost in blocks of 4x4 pixels. Waits for the GPU."""
        if not self._count:
            return 0, dict.fromkeys(CULL_REASONS.values(), 0), 0
        data = np.frombuffer(self.indirect.read(), np.uint32)
        culled = {name: int(data[4 + code]) for code, name in CULL_REASONS.items()}
        corners = self._pulled_corners
        drawn = int(data[0]) // corners if corners else int(data[1])
        return drawn // self._views, culled, int(data[12]) + (int(data[13]) << 32)

    def _dispatch(self, name: str, groups: int, **settings: int | bool) -> None:
        program = self._stages[name]
        set_uniforms(program, {"count": self._count, "groups": self._groups, **settings})
        program.run(groups)
        self._ctx.memory_barrier()

    def release(self) -> None:
        """Delete the histogram and the counters."""
        self._owned.close()
