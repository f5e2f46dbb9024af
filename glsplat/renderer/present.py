"""Present: draw the float layers of a frame to a window (or any 8-bit framebuffer), with text over them."""

from __future__ import annotations

from typing import Any, Literal

import moderngl
import numpy as np
from numpy.typing import NDArray

from glsplat.gl.context import Context
from glsplat.gl.owner import ContextGuard, owner_of
from glsplat.renderer.targets import Target
from glsplat.shaders import Variant, flatten, link, set_uniforms
from glsplat.shaders.slots import UNITS

Layout = Literal["mono", "side-by-side", "anaglyph"]


def view_size(window: tuple[int, int], layout: Layout) -> tuple[int, int]:
    """Return the size of one view in a window of ``window`` pixels; side by side an odd column stays black."""
    width, height = window
    return max(1, width // 2 if layout == "side-by-side" else width), max(1, height)


class Present:
    """Copies layers to a window texel by pixel, without filtering."""

    def __init__(self, context: Context | moderngl.Context) -> None:
        self._context = context
        self._ctx = context.ctx if isinstance(context, Context) else context
        self._arrays: dict[tuple[int, int, int], moderngl.VertexArray] = {}  # by (anaglyph, text, lifted)
        with self._entered("Present()"):
            self._text = self._ctx.texture((1, 1), 4)
        self._box = (0, 0, 0, 0)

    def write_text(self, image: NDArray[np.uint8] | None) -> None:
        """Set the text over the picture: premultiplied RGBA [h, w, 4] in the upper left corner; None removes it."""
        if image is None:
            self._box = (0, 0, 0, 0)
            return
        height, width = image.shape[:2]
        with self._entered("Present.write_text()"):
            if self._text.size != (width, height):
                old, self._text = self._text, self._ctx.texture((width, height), 4)
                old.release()
            self._text.write(np.ascontiguousarray(image))
        self._box = (0, 0, width, height)

    def run(self, target: Target, framebuffer: moderngl.Framebuffer, size: tuple[int, int], layout: Layout) -> None:
        """Fill ``size`` (width, height) pixels of ``framebuffer`` from ``target``; all layouts but mono need a pair.

        Values are clamped and rounded by the fixed-point framebuffer, as in resolve.frag.glsl.
        """
        with self._entered("Present.run()"):
            views, _, width, _ = target.shape
            framebuffer.viewport = (0, 0, *size)
            framebuffer.use()
            self._ctx.enable_only(moderngl.NOTHING)
            values: dict[str, Any] = {"window": size, "view_width": width}
            target.texture.use(UNITS["target"])
            has_text = self._box[2] > 0
            if has_text:
                self._text.use(UNITS["text"])
                values["text_box"] = self._box
            if target.lift is not None:
                values |= {"first_background": target.lift[0], "second_background": target.lift[-1]}
            array = self._array(int(layout == "anaglyph" and views > 1), int(has_text), int(target.lift is not None))
            set_uniforms(array.program, values)
            array.render(moderngl.TRIANGLES, vertices=3)

    def _array(self, anaglyph: int, text: int, lifted: int) -> moderngl.VertexArray:
        """Return the vertex array of a program, compiled when it is first needed."""
        key = (anaglyph, text, lifted)
        if key not in self._arrays:
            flags = Variant().defines()
            own = {"ANAGLYPH": anaglyph, "TEXT": text, "LIFTED": lifted}
            stages = {
                "vertex_shader": flatten("screen.vert.glsl", flags),
                "fragment_shader": flatten("present.frag.glsl", flags | own),
            }
            self._arrays[key] = self._ctx.vertex_array(link(self._ctx, "present", stages), [])
        return self._arrays[key]

    def release(self) -> None:
        """Delete programs, vertex arrays and texture."""
        with self._entered("Present.release()"):
            arrays, self._arrays = self._arrays, {}
            for array in arrays.values():
                array.program.release()
                array.release()
            self._text.release()

    def _entered(self, call: str) -> ContextGuard:
        if isinstance(self._context, Context):
            return self._context.entered(call)
        return owner_of(self._context).entered(call)
