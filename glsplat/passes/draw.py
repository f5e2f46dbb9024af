"""DrawPass: one instanced draw of quads, both eyes through gl_Layer, premultiplied over."""

from __future__ import annotations

import moderngl

from glsplat.passes.geometry import bind_frame
from glsplat.passes.project import record_layout
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
        bind_frame(program)
        self._array = ctx.vertex_array(program, [])
        stride, offset = variant.record_floats * 4, 0
        for _, name, floats in record_layout(variant):
            attribute = program[name]
            assert isinstance(attribute, moderngl.Attribute)
            self._array.bind(
                attribute.location, "f", records, f"{floats}f", offset=offset, stride=stride, divisor=self._views
            )
            offset += floats * 4

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

    def release(self) -> None:
        """Delete the vertex array."""
        self._array.release()
