"""ProjectPass: the sorted splats' footprints in all views, one record a splat."""

from __future__ import annotations

from contextlib import ExitStack

import moderngl
import numpy as np
from numpy.typing import NDArray

from glsplat.gl.context import Context
from glsplat.shaders import Programs, Variant

__all__ = ["ProjectPass", "record_layout"]


def record_layout(variant: Variant) -> list[tuple[str, str, int]]:
    """(captured varying, attribute of record_input.glsl, floats) in the order of project.vert.glsl's record."""
    views = range(variant.views)

    def spread(name: str, floats: int) -> list[tuple[str, str, int]]:
        return [(f"{name}[{v}]", f"{name}{v}", floats) for v in views]

    layout = [("rgb", "rgb0", 3)] if variant.sh_degree == 0 else spread("rgb", 3)
    layout += [("alpha", "alpha0", 1)] if not variant.antialias else spread("alpha", 1)
    layout += spread("centre", 2) + spread("cholesky", 3)
    return layout + (spread("z", 1) if variant.depth or variant.occluded else [])


class ProjectPass:
    """Runs through ``order`` and gathers from the arena's textures, so the records come out sorted."""

    def __init__(self, context: Context, programs: Programs, variant: Variant, count: int) -> None:
        ctx, varyings = context.ctx, []
        for captured, _, _ in record_layout(variant):
            base = captured.split("[")[0]
            if base not in varyings:
                varyings.append(base)
        program = programs.feedback("project", variant, varyings)
        self.count: int = 0
        self._orphans = not context.software  # a GPU may still read the order before; software is done with it
        with ExitStack() as stack:  # releases what was made if a later allocation fails
            self.order: moderngl.Buffer = ctx.buffer(reserve=max(16, count * 4), dynamic=True)
            stack.callback(self.order.release)
            self.records: moderngl.Buffer = ctx.buffer(reserve=max(16, count * variant.record_floats * 4))
            stack.callback(self.records.release)
            self._array = ctx.vertex_array(program, [(self.order, "1u4", "order")])
            stack.callback(self._array.release)
            self._owned = stack.pop_all()

    def write_order(self, order: NDArray[np.uint32]) -> None:
        """Set the splats to draw and their order (indices, far to near)."""
        self.count = len(order)
        if self.count:
            if self._orphans:
                self.order.orphan()  # new memory instead of a wait
            self.order.write(np.ascontiguousarray(order))

    def run(self) -> None:
        """Project the splats of ``order``."""
        if self.count:
            self._array.transform(self.records, moderngl.POINTS, vertices=self.count)

    def release(self) -> None:
        """Delete the order, the records and the vertex array."""
        self._owned.close()
