"""Resolve: convert the float target to 8 bits, after an optional step of the application such as a watermark."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import moderngl
import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera
from glsplat.errors import GlsplatError
from glsplat.gl.context import Context
from glsplat.renderer.stats import Box
from glsplat.renderer.targets import ByteTarget, Target
from glsplat.shaders import Programs, ResolveVariant, Variant, set_uniforms
from glsplat.shaders.slots import UNITS

MAX_TEXTURES = 64
"""Textures of steps, 16 KiB each: so many sessions can take turns without uploads."""


class ResolveStep(Protocol):
    """Draws into 8-bit pictures before rounding (``Renderer.step``). A hashable value: equal steps draw alike."""

    @property
    def source(self) -> str:
        """GLSL: ``vec4 stepped(vec4 colour, ivec2 pixel)``, premultiplied; it may read ``sampler2D step_texture``.

        ``pixel`` counts from the top left corner of each view.
        """

    def tile(self) -> NDArray[np.float32]:
        """Return the content [H, W] of ``step_texture``, row 0 first; it is not filtered."""

    def __hash__(self) -> int: ...


def checked_step(step: ResolveStep | None, boxed: bool) -> ResolveStep | None:
    """Return the step, which only 8-bit pictures (``boxed``) have. Raises GlsplatError."""
    if step is None:
        return None
    if not isinstance(getattr(step, "source", None), str) or not callable(getattr(step, "tile", None)):
        raise GlsplatError(
            f"a step needs source and tile(), as glsplat.extras.watermark.Watermark has, not {type(step).__name__}"
        )
    if not boxed:
        raise GlsplatError("a step is drawn into 8-bit pictures; use RenderConfig(output='uint8')")
    return step


class StepTexture:
    """The texture of a step."""

    def __init__(self, context: Context, step: ResolveStep) -> None:
        tile = step.tile()
        self.texture: moderngl.Texture = context.ctx.texture(tile.shape[::-1], 1, tile, dtype="f4")
        self.texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self.nbytes: int = tile.nbytes

    def release(self) -> None:
        """Delete the texture."""
        self.texture.release()


class ResolvePass:
    """Clamps and rounds the float target to 8 bits, inside the covered box only."""

    def __init__(self, ctx: moderngl.Context, programs: Programs, variant: Variant) -> None:
        self._ctx, self._programs = ctx, programs
        self._cull_hidden = variant.cull_hidden
        self._arrays: dict[str, moderngl.VertexArray] = {}  # by the step's source
        self._array("")

    def run(
        self,
        source: Target,
        into: ByteTarget,
        cameras: Sequence[Camera],
        box: Box,
        step: ResolveStep | None = None,
        texture: moderngl.Texture | None = None,  # of the step
    ) -> None:
        """Convert the pixels of ``box`` of every view."""
        x, y, width, height = box
        array = self._array("" if step is None else step.source)
        program = array.program
        if texture is not None:
            texture.use(UNITS["step_texture"])
        into.framebuffer.use()
        source.texture.use(UNITS["target"])
        views, rows, _, _ = into.shape
        for view in range(views):
            set_uniforms(program, {"background": cameras[view].background, "view": (view, 0, view * rows)})
            self._ctx.viewport = (x, view * rows + y, width, height)
            array.render(moderngl.TRIANGLES, vertices=3)

    def _array(self, source: str) -> moderngl.VertexArray:
        if source not in self._arrays:
            variant = ResolveVariant(cull_hidden=self._cull_hidden)
            program = self._programs.draw("screen", "resolve", variant, {"step.glsl": source} if source else {})
            self._arrays[source] = self._ctx.vertex_array(program, [])
        return self._arrays[source]

    def release(self) -> None:
        """Delete the vertex arrays."""
        for array in self._arrays.values():
            array.release()
