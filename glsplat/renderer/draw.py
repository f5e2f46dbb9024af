"""Draw: fill the background, then blend all records in one draw of quads or triangles, both eyes through gl_Layer."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import moderngl

from glsplat.camera import Camera
from glsplat.gl.context import Context
from glsplat.renderer.stats import Box
from glsplat.renderer.targets import Target
from glsplat.shaders import Programs, Variant, record_layout

MAX_PULLED = 500_000
"""Most records that software rasterizers pull by default: 0.8 of the draw's time up to 320,000, 1.1 at a million."""

MIN_PART_RECORDS, MAX_PARTS = 4096, 10
"""Size and number of the parts in which a software rasterizer draws pulled records: it bins one part while it draws the
previous one, and the bins of a small part stay in the cache; but each part adds a cost by the covered pixels."""


@dataclass(frozen=True, slots=True)
class Slices:
    """Slices of a costly picture, of about ``cost`` covered pixels each, with a call between two of them."""

    between: Callable[[], None] | None = None  # an exception that it raises ends the picture
    cost: float = math.inf


def corners_of(variant: Variant) -> int:
    """Return the vertices of a record in one view: of a strip as an instance, or of triangles if records are pulled."""
    return 3 if variant.triangle else 6 if variant.pulled else 4


def fits(ctx: moderngl.Context, variant: Variant, count: int) -> bool:
    """Return whether ``count`` records can be pulled: storage buffers have a limit, and a vertex number has 31 bits."""
    vertices = count * variant.views * corners_of(variant)
    limit = int(ctx.info["GL_MAX_SHADER_STORAGE_BLOCK_SIZE"])
    return count * variant.record_floats * 4 <= limit and vertices < 2**31


class BackgroundPass:
    """Fills the background: by one clear, or by a draw for several colours, meshes and depth."""

    def __init__(self, ctx: moderngl.Context, programs: Programs, variant: Variant) -> None:
        self._ctx, self._programs, self._variant = ctx, programs, variant
        self._array: moderngl.VertexArray | None = None

    def run(self, target: Target, cameras: Sequence[Camera], box: Box) -> None:
        """Bind the target and fill ``box`` of all layers with each view's background and alpha 0.

        With depth all pixels are read, so all are filled.
        """
        target.framebuffer.use()
        self._ctx.enable_only(moderngl.NOTHING)  # the passes that follow switch off again what they switch on
        colours = {camera.background for camera in cameras}
        variant = self._variant
        if len(colours) == 1 and not (variant.depth or variant.occluded or variant.sampled):
            target.framebuffer.clear(*colours.pop(), 0.0, viewport=box)
            return
        if self._array is None:
            program = self._programs.draw("screen", "background", self._variant)
            self._array = self._ctx.vertex_array(program, [])
        self._ctx.viewport = (0, 0, target.shape[2], target.shape[1]) if variant.depth else box
        self._array.render(moderngl.TRIANGLES, vertices=3, instances=variant.views)
        self._ctx.viewport = (0, 0, target.shape[2], target.shape[1])

    def release(self) -> None:
        """Delete the vertex array."""
        if self._array is not None:
            self._array.release()


class DrawPass:
    """Blends records in their order into one layer a view.

    Instance i draws record i / views into layer i % views. With ``variant.pulled`` there is one instance, and the
    vertices of all records follow each other: on llvmpipe an instance costs more than its vertices.
    """

    def __init__(self, context: Context, programs: Programs, variant: Variant, records: moderngl.Buffer) -> None:
        self._ctx, self._variant, self._records = context.ctx, variant, records
        self._corners = corners_of(variant)
        self._flushed = context.scratch if context.software and variant.pulled else None
        program = programs.draw("splat", "splat", variant)
        self._array = context.ctx.vertex_array(program, [])
        self._mode = moderngl.TRIANGLES if variant.triangle or variant.pulled else moderngl.TRIANGLE_STRIP
        self._attributes: list[tuple[int, int, int]] = []  # location, floats, offset in bytes
        offset = 0
        for name, floats in record_layout(variant) if not variant.pulled else ():
            attribute = program[name]
            assert isinstance(attribute, moderngl.Attribute)
            self._attributes.append((attribute.location, floats, offset))
            offset += floats * 4
        self._begin_at(0)

    def run_slices(self, target: Target, ends: Sequence[int], between: Callable[[], None]) -> None:
        """Blend the records in several draws, which end at the record numbers ``ends``.

        Waits for each draw, then calls ``between``. If that raises, the target is half drawn.
        """
        begin = 0
        try:
            for end in ends:
                if begin:
                    self._ctx.finish()
                    between()
                    target.framebuffer.use()
                self._begin_at(begin)
                self.run(end, begin)
                begin = end
        finally:
            self._begin_at(0)

    def run(self, end: int, begin: int = 0, indirect: moderngl.Buffer | None = None) -> None:
        """Blend records ``begin`` to ``end`` in order into the target that the background pass has bound.

        ``indirect`` holds their number if only the GPU knows it.
        """
        if begin == end:
            return
        self._ctx.enable(moderngl.BLEND)
        self._ctx.blend_func = moderngl.ONE, moderngl.ONE_MINUS_SRC_ALPHA
        if self._variant.pulled:
            self._records.bind_to_storage_buffer(0)
        if indirect is not None:
            self._array.render_indirect(indirect, self._mode, count=1)
        elif self._variant.pulled:
            vertices = self._corners * self._variant.views
            part = max(MIN_PART_RECORDS, -((begin - end) // MAX_PARTS)) if self._flushed else end - begin
            for first in range(begin, end, part):
                if self._flushed and first > begin:
                    self._flushed.clear()  # llvmpipe starts drawing when the target changes; moderngl has no glFlush
                last = min(first + part, end)
                self._array.render(self._mode, vertices=(last - first) * vertices, first=first * vertices)
        else:
            self._array.render(self._mode, vertices=self._corners, instances=(end - begin) * self._variant.views)
        self._ctx.disable(moderngl.BLEND)

    def _begin_at(self, record: int) -> None:
        """Make ``record`` instance 0; a base instance would need OpenGL 4.2."""
        stride, views = self._variant.record_floats * 4, self._variant.views
        for location, floats, offset in self._attributes:
            start = record * stride + offset
            self._array.bind(location, "f", self._records, f"{floats}f", offset=start, stride=stride, divisor=views)

    def release(self) -> None:
        """Delete the vertex array."""
        self._array.release()
