"""DrawPass: one instanced draw of quads, both eyes through gl_Layer, premultiplied over."""

from __future__ import annotations

from collections.abc import Sequence

import moderngl

from glsplat.passes.frame.budget import Budget
from glsplat.passes.frame.project import record_layout
from glsplat.passes.target import Target
from glsplat.shaders import Programs, Variant

__all__ = ["DrawPass"]


class DrawPass:
    """Instance i draws record i / views into layer i % views."""

    def __init__(self, ctx: moderngl.Context, programs: Programs, variant: Variant, records: moderngl.Buffer) -> None:
        self._ctx = ctx
        self._views = variant.views
        self._corners = 3 if variant.triangle else 4
        program = programs.draw("splat", "splat", variant)
        self._array = ctx.vertex_array(program, [])
        self._records, self._stride, offset = records, variant.record_floats * 4, 0
        self._attributes: list[tuple[int, int, int]] = []  # location, floats, offset in bytes
        for _, name, floats in record_layout(variant):
            attribute = program[name]
            assert isinstance(attribute, moderngl.Attribute)
            self._attributes.append((attribute.location, floats, offset))
            offset += floats * 4
        self._begin_at(0)

    def run(self, target: Target, count: int, indirect: moderngl.Buffer | None = None) -> None:
        """Blend ``count`` records, first to last; ``indirect`` holds the number where only the GPU knows it."""
        target.framebuffer.use()
        if not count:
            return
        self._ctx.enable_only(moderngl.BLEND)
        self._ctx.blend_func = moderngl.ONE, moderngl.ONE_MINUS_SRC_ALPHA
        mode = moderngl.TRIANGLES if self._corners == 3 else moderngl.TRIANGLE_STRIP
        if indirect is None:
            self._array.render(mode, vertices=self._corners, instances=count * self._views)
        else:
            self._array.render_indirect(indirect, mode, count=1)
        self._ctx.enable_only(moderngl.NOTHING)

    def run_slices(self, target: Target, ends: Sequence[int], budget: Budget) -> None:
        """The same picture in several draws, each up to one of the record numbers ``ends``, growing.

        Waits for each and asks the budget whether to go on. Raises what it raises; the target is then half drawn.
        """
        begin = 0
        try:
            for end in ends:
                if begin:
                    self._ctx.finish()
                    budget.check()
                self._begin_at(begin)
                self.run(target, end - begin)
                begin = end
        finally:
            self._begin_at(0)

    def _begin_at(self, record: int) -> None:
        """Let instance 0 be that record; a base instance would need OpenGL 4.2."""
        for location, floats, offset in self._attributes:
            start = record * self._stride + offset
            self._array.bind(
                location, "f", self._records, f"{floats}f", offset=start, stride=self._stride, divisor=self._views
            )

    def release(self) -> None:
        """Delete the vertex array."""
        self._array.release()
