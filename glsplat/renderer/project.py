"""Project: write a record per sorted splat, with its footprints in all views."""

from __future__ import annotations

import ctypes
from contextlib import ExitStack
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from glsplat.gl.context import Context
from glsplat.gl.functions import gl_functions
from glsplat.light.light import Light
from glsplat.renderer.owned import OwnsObjects, owned
from glsplat.shaders import Programs, Variant, record_layout

_U = ctypes.c_uint
_CALLS: dict[str, tuple[Any, ...]] = {
    "UseProgram": (_U,),
    "BindVertexArray": (_U,),
    "BindBufferBase": (_U, _U, _U),
    "BindBuffer": (_U, _U),
    "BeginTransformFeedback": (_U,),
    "DrawArraysIndirect": (_U, ctypes.c_void_p),
    "EndTransformFeedback": (),
}


class ProjectPass(OwnsObjects):
    """Gathers from the arena's textures in the order of ``order``, so the records come out sorted."""

    def __init__(self, context: Context, programs: Programs, variant: Variant, count: int) -> None:
        ctx = context.ctx
        program = programs.feedback("project", variant, [name for name, _ in record_layout(variant)])
        self.count: int = 0
        self._ctx = ctx
        self._gl: dict[str, Any] = {}
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

    def run(self, light: Light | None = None, indirect: moderngl.Buffer | None = None) -> None:
        """Project the splats of ``order``, under ``light`` with variant.lit.

        ``indirect`` holds a draw command from byte 16 on, if only the GPU knows their number.
        """
        if self.count:
            if light is not None:  # another pipeline may have set another one
                uniform = self._array.program["light"]
                assert isinstance(uniform, moderngl.Uniform)
                uniform.write(light.uniforms().tobytes())
            if indirect is None:
                self._array.transform(self.records, moderngl.POINTS, vertices=self.count)
            else:
                self._transform_indirect(indirect)

    def _transform_indirect(self, indirect: moderngl.Buffer) -> None:
        """Do moderngl's ``transform()``, which takes no indirect buffer, by GL functions."""
        gl = self._gl = self._gl or {
            name: gl_functions(self._ctx)(name, None, *types) for name, types in _CALLS.items()
        }
        self._ctx.enable_only(moderngl.RASTERIZER_DISCARD)
        gl["UseProgram"](self._array.program.glo)
        gl["BindVertexArray"](self._array.glo)
        gl["BindBufferBase"](0x8C8E, 0, self.records.glo)  # GL_TRANSFORM_FEEDBACK_BUFFER
        gl["BindBuffer"](0x8F3F, indirect.glo)  # GL_DRAW_INDIRECT_BUFFER
        gl["BeginTransformFeedback"](moderngl.POINTS)
        gl["DrawArraysIndirect"](moderngl.POINTS, 16)
        gl["EndTransformFeedback"]()
        self._ctx.enable_only(moderngl.NOTHING)
