"""Project: write a record per sorted splat, with its footprints in all views."""

from __future__ import annotations

from contextlib import ExitStack

import moderngl
import numpy as np
from numpy.typing import NDArray

from glsplat.gl.context import Context
from glsplat.light.light import Light
from glsplat.renderer.owned import owned
from glsplat.shaders import Programs, Variant, record_layout

__all__ = ["ProjectPass"]


class ProjectPass:
    """Gathers from the arena's textures in the order of ``order``, so the records come out sorted."""

    def __init__(self, context: Context, programs: Programs, variant: Variant, count: int) -> None:
        ctx = context.ctx
        program = programs.feedback("project", variant, [name for name, _ in record_layout(variant)])
        self.count: int = 0
        self._orphans = not context.software  # a GPU may still read the last order; software has finished
        with ExitStack() as stack:  # releases everything if an allocation fails
            self.order: moderngl.Buffer = owned(stack, ctx.buffer(reserve=max(16, count * 4), dynamic=True))
            size = max(16, count * variant.record_floats * 4)
            self.records: moderngl.Buffer = owned(stack, ctx.buffer(reserve=size))
            self._array = owned(stack, ctx.vertex_array(program, [(self.order, "1u4", "order")]))
            self._owned = stack.pop_all()

    def write_order(self, order: NDArray[np.uint32]) -> None:
        """Set the splats to draw: indices, far to near."""
        self.count = len(order)
        if self.count:
            if self._orphans:
                self.order.orphan()  # new memory instead of a wait
            self.order.write(np.ascontiguousarray(order))

    def run(self, light: Light | None = None) -> None:
        """Project the splats of ``order``, under ``light`` with variant.lit."""
        if self.count:
            if light is not None:  # another pipeline may have set another one
                uniform = self._array.program["light"]
                assert isinstance(uniform, moderngl.Uniform)
                uniform.write(light.uniforms().tobytes())
            self._array.transform(self.records, moderngl.POINTS, vertices=self.count)

    def release(self) -> None:
        """Delete the order, the records and the vertex array."""
        self._owned.close()
