"""Sort on the GPU: the order of sort.py by radix sort in compute shaders (OpenGL 4.3)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from weakref import WeakKeyDictionary

import moderngl
import numpy as np

from glsplat.errors import ContextError
from glsplat.gl.context import Context
from glsplat.renderer.owned import OwnsObjects, owned
from glsplat.renderer.sort import CULL_REASONS, sorted_indices
from glsplat.renderer.stage import ROW, rows_of
from glsplat.shaders import Programs, set_uniforms
from glsplat.timing import StageTimer

DIGITS, TILE = 256, 2048
"""Twins of radix.glsl: values of a digit, and splats that a group sorts at a time."""

MAX_CPU_SORTED = 65_536
"""Most splats for which a GPU's sort is measured against the CPU's, which takes over 2 ms beyond."""

_faster: WeakKeyDictionary[moderngl.Context, dict[int, bool]] = WeakKeyDictionary()

_BARRIERS = (
    moderngl.SHADER_STORAGE_BARRIER_BIT  # the next dispatch
    | moderngl.COMMAND_BARRIER_BIT  # the indirect draw
    | moderngl.VERTEX_ATTRIB_ARRAY_BARRIER_BIT  # the order
    | moderngl.TRANSFORM_FEEDBACK_BARRIER_BIT  # records over the scratch space
    | moderngl.BUFFER_UPDATE_BARRIER_BIT  # counts, read and reset
)


class GpuSorter(OwnsObjects):
    """Sorts keys and writes the order of the drawn splats; nothing is read back. Scratch space is borrowed."""

    def __init__(
        self,
        ctx: moderngl.Context,
        programs: Programs,
        order: moderngl.Buffer,  # [N] uint32
        scratch: moderngl.Buffer,  # >= 28 N bytes, free until the records are written; begins with rows of key.py
        count: int,  # N
        views: int,
        bits: int = 32,  # 16: by the upper half of a key only
        corners: int = 4,  # vertices of an instance of the indirect draw
        pulled: bool = False,  # all vertices are in one instance
    ) -> None:
        limit = int(ctx.info["GL_MAX_SHADER_STORAGE_BLOCK_SIZE"])
        if scratch.size > limit:
            raise ContextError(f"{count} splats exceed this driver's {limit} byte buffers; use sorter='cpu'")
        self._ctx, self._count = ctx, 0
        self._ranges: tuple[tuple[int, int], ...] = ()
        self._digits = bits // 8
        self._settings = {"ignored_bits": 32 - bits, "views": views, "corners": corners if pulled else 0}
        # Counts of radix.glsl: draw, projection, culled splats, cost, range of the keys
        draw = [0, 1] if pulled else [corners, 0]
        self._start = np.array([*draw, 0, 0, *(0, 1, 0, 0), *[0] * 10, 2**32 - 1, 0], np.uint32)
        with ExitStack() as stack:  # releases everything if an allocation fails
            rows = owned(stack, ctx.buffer(reserve=4 * rows_of(count), dynamic=True))
            histogram = owned(stack, ctx.buffer(reserve=4 * DIGITS * _groups(count)))
            # commands of the draw and, from byte 16 on, of the project pass; then counts
            self.indirect: moderngl.Buffer = owned(stack, ctx.buffer(reserve=self._start.nbytes))
            self._buffers = (rows, order, scratch, histogram, self.indirect)
            self._programs = [programs.compute(f"radix_{name}") for name in ("count", "scatter")]
            self._owned = stack.pop_all()

    @staticmethod
    def fits(context: Context, scratch: moderngl.Buffer) -> bool:
        """Return whether the driver has compute shaders, which can bind the largest buffer."""
        return context.compute and scratch.size <= int(context.ctx.info["GL_MAX_SHADER_STORAGE_BLOCK_SIZE"])

    def run(self, ranges: Sequence[tuple[int, int]]) -> None:
        """Sort the splats of ``ranges``, first index (of a whole row) and number of each, by their keys."""
        if tuple(ranges) != self._ranges:
            self._ranges, self._count = tuple(ranges), sum(count for _, count in ranges)
            rows = [np.arange(first // ROW, -(-(first + count) // ROW), dtype=np.uint32) for first, count in ranges]
            self._buffers[0].write(np.concatenate([*rows, np.zeros(1, np.uint32)[: not self._count]]))
        self.indirect.write(self._start)
        for binding, buffer in enumerate(self._buffers):
            buffer.bind_to_storage_buffer(binding)
        groups = _groups(self._count)
        for program in self._programs:  # another sorter may share them
            set_uniforms(program, {"count": self._count, "groups": groups, **self._settings})
        for digit in range(self._digits):  # the GPU skips high digits that do not differ
            for program in self._programs:
                set_uniforms(program, {"digit": digit})
                program.run(groups)
                self._ctx.memory_barrier(_BARRIERS)

    def counts(self) -> tuple[int, dict[str, int], int]:
        """Read back splats drawn, splats culled by reason, and the cost in blocks of 4x4 pixels. Waits for the GPU."""
        data = np.frombuffer(self.indirect.read(), np.uint32)
        culled = {name: int(data[8 + code]) for code, name in CULL_REASONS.items()}
        return int(data[4]), culled, int(data[16]) + (int(data[17]) << 32)


def gpu_sorts_faster(context: Context, programs: Programs, count: int) -> bool:
    """Return whether the GPU sorts ``count`` splats faster than the CPU; the order is the same.

    Measured once a context and power of two. The CPU's time includes waiting for the keys, the GPU's for the order.
    """
    if context.software:
        return False
    if count > MAX_CPU_SORTED:
        return True
    size = 1 << max(10, (count - 1).bit_length())
    found = _faster.setdefault(context.ctx, {})
    if size not in found:
        found[size] = _measured(context.ctx, programs, size)
    return found[size]


def _measured(ctx: moderngl.Context, programs: Programs, count: int) -> bool:
    mixed = np.arange(count, dtype=np.uint32) * np.uint32(2654435761)
    rows = np.zeros(7 * count, np.uint32)
    rows[: 3 * count : 3] = 0xC0000000 + (mixed >> np.uint32(8))  # depths from 2 m to 8 m
    with ExitStack() as stack:
        order = owned(stack, ctx.buffer(reserve=4 * count, dynamic=True))
        scratch = owned(stack, ctx.buffer(rows))
        sorter = owned(stack, GpuSorter(ctx, programs, order, scratch, count, 2))

        def by_cpu() -> None:
            found = np.frombuffer(scratch.read(12 * count), np.uint32)[::3]
            order.orphan()
            order.write(np.ascontiguousarray(sorted_indices(np.ascontiguousarray(found))))

        return _least_ms(ctx, lambda: sorter.run([(0, count)])) < _least_ms(ctx, by_cpu)


def _least_ms(ctx: moderngl.Context, step: Callable[[], None]) -> float:
    """Return the shortest time of up to three calls, which begin within 20 ms."""
    step()  # a driver may still compile
    ctx.finish()
    timer = StageTimer(ctx.finish)
    times: list[float] = []
    while len(times) < 3 and sum(times) < 20:
        timer.start()
        step()
        timer.mark("sort")
        times.append(timer.ms["sort"])
    return min(times)


def _groups(count: int) -> int:
    """Return the work groups of a dispatch.

    Each adds up the counts of all. That reads at most 16 bytes a splat and digit, from the cache.
    Up to 32 groups share even few splats, so that more than a corner of a GPU works.
    """
    return max(1, min(-(-count // TILE), max(32, math.isqrt(count // 128))))
