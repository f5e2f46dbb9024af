"""Targets: the float texture array the splats blend into, one layer a view, and the 8-bit picture made of it."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera
from glsplat.errors import ContextError
from glsplat.renderer.resolve_step import ResolveStep
from glsplat.shaders import Programs, ResolveVariant, Variant
from glsplat.shaders.slots import UNITS

__all__ = ["FORMATS", "Box", "ByteTarget", "Clear", "Resolve", "Target"]

FORMATS = {"8": "f1", "16f": "f2", "32f": "f4"}
"""RenderConfig.target -> moderngl dtype."""

Box = tuple[int, int, int, int]
"""Pixels: x, y, width, height, from the top left corner."""

_NUMPY = {"f1": np.uint8, "f2": np.float16, "f4": np.float32}


class Target:
    """Colour for V views of one size: premultiplied RGB over the background, and accumulated alpha.

    With ``depth`` a second texture array takes the sum of weight times camera z (metres).
    """

    def __init__(
        self, ctx: moderngl.Context, width: int, height: int, views: int, dtype: str, depth: bool = False
    ) -> None:
        self.shape: tuple[int, int, int, int] = (views, height, width, 4)
        self.numpy_dtype: np.dtype[Any] = np.dtype(_NUMPY[dtype])
        # background of each layer, where hidden splats were left out (lift.glsl)
        self.lift: tuple[tuple[float, float, float], ...] | None = None
        with ExitStack() as stack:  # releases what was made if a later allocation fails
            self.texture: moderngl.TextureArray = ctx.texture_array((width, height, views), 4, dtype=dtype)
            stack.callback(self.texture.release)
            self.texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
            self.depth: moderngl.TextureArray | None = None
            if depth:
                self.depth = ctx.texture_array((width, height, views), 1, dtype="f4")
                stack.callback(self.depth.release)
                self.depth.filter = (moderngl.NEAREST, moderngl.NEAREST)
            attached = [self.texture] if self.depth is None else [self.texture, self.depth]
            self.framebuffer: moderngl.Framebuffer = _framebuffer(ctx, *attached)
            stack.callback(self.framebuffer.release)
            self._owned = stack.pop_all()

    def read_depth(self) -> NDArray[np.float32]:
        """[V, H, W] expected camera z in metres, 0 where nothing was drawn."""
        assert self.depth is not None
        colour = np.empty(self.shape, np.float32)
        self.read(colour)
        total = np.frombuffer(self.depth.read(), np.float32).reshape(self.shape[:3])
        alpha = colour[..., 3]
        return np.divide(total, alpha, out=np.zeros_like(total), where=alpha > 0)

    def read(self, out: NDArray[np.float32]) -> None:
        """Copy all layers to ``out`` [V, H, W, 4] as floats, row 0 first (the top row of the image)."""
        if self.numpy_dtype == out.dtype:
            self.texture.read_into(out)
            return
        pixels = np.empty(self.shape, self.numpy_dtype)
        self.texture.read_into(pixels)
        np.multiply(pixels, 1 / 255 if self.numpy_dtype == np.uint8 else 1, out=out, dtype=np.float32, casting="unsafe")

    def copy_layer(self, ctx: moderngl.Context, layer: int, single: Target) -> None:
        """Make ``layer`` a copy of a target of one view, depth included where both have it; it stays on the GPU."""
        _, height, width, _ = self.shape
        pixels = ctx.buffer(reserve=single.nbytes)
        try:
            for mine, other in ((self.texture, single.texture), (self.depth, single.depth)):
                if mine is not None and other is not None:
                    other.read_into(pixels)
                    mine.write(pixels, viewport=(0, 0, layer, width, height, 1))
        finally:
            pixels.release()

    @property
    def nbytes(self) -> int:
        """GPU bytes of the textures."""
        pixel = 4 * self.numpy_dtype.itemsize + (0 if self.depth is None else 4)
        return int(np.prod(self.shape[:3])) * pixel

    def release(self) -> None:
        """Delete framebuffer and textures."""
        self._owned.close()


class ByteTarget:
    """8 bits a channel, the views one below the other: one plain texture, so that parts of it can be read."""

    def __init__(self, ctx: moderngl.Context, width: int, height: int, views: int) -> None:
        self.shape: tuple[int, int, int, int] = (views, height, width, 4)
        with ExitStack() as stack:  # releases what was made if a later allocation fails
            self.texture: moderngl.Texture = ctx.texture((width, height * views), 4)
            stack.callback(self.texture.release)
            self.framebuffer: moderngl.Framebuffer = _framebuffer(ctx, self.texture)
            stack.callback(self.framebuffer.release)
            self._owned = stack.pop_all()

    def read(self, out: NDArray[np.uint8], box: Box) -> None:
        """Copy the pixels of ``box`` of every view into ``out`` [V, H, W, 4] and fill the rest with the background.

        The background is taken from the box's rim (sort.covered_box), as the driver rounded it: no seam.
        """
        views, rows, columns, _ = self.shape
        x, y, width, height = box
        if (width, height) == (columns, rows):
            self.framebuffer.read_into(out, components=4)
            return
        part = np.empty((height, width, 4), np.uint8)
        for view in range(views):
            self.framebuffer.read_into(part, viewport=(x, view * rows + y, width, height), components=4)
            background = part[0, 0] if x or y else part[-1, -1]
            out[view].view(np.uint32).fill(background.copy().view(np.uint32)[0])  # whole pixels: 30 times as fast
            out[view, y : y + height, x : x + width] = part

    @property
    def nbytes(self) -> int:
        """GPU bytes of the texture."""
        return int(np.prod(self.shape))

    def release(self) -> None:
        """Delete framebuffer and texture."""
        self._owned.close()


class Clear:
    """What lies behind the splats: one plain clear, or a pass where backgrounds differ, for meshes and depth."""

    def __init__(self, ctx: moderngl.Context, programs: Programs, variant: Variant) -> None:
        self._ctx, self._programs, self._variant = ctx, programs, variant
        self._array: moderngl.VertexArray | None = None

    def run(self, target: Target, cameras: Sequence[Camera], box: Box) -> None:
        """Fill ``box`` of all layers with each view's background and alpha 0."""
        colours = {camera.background for camera in cameras}
        variant = self._variant
        if len(colours) == 1 and not (variant.depth or variant.occluded or variant.sampled):
            target.framebuffer.clear(*colours.pop(), 0.0, viewport=box)
            return
        if self._array is None:
            program = self._programs.draw("screen", "background", self._variant)
            self._array = self._ctx.vertex_array(program, [])
        target.framebuffer.use()
        self._ctx.enable_only(moderngl.NOTHING)
        self._array.render(moderngl.TRIANGLES, vertices=3, instances=self._variant.views)

    def release(self) -> None:
        """Delete the vertex array."""
        if self._array is not None:
            self._array.release()


class Resolve:
    """Clamps and rounds the float target to 8 bit, inside the covered box only, after the step of its owner."""

    def __init__(self, ctx: moderngl.Context, programs: Programs, variant: Variant) -> None:
        self._ctx, self._programs = ctx, programs
        self._cull_hidden = variant.cull_hidden
        self._ways: dict[str, tuple[moderngl.Program, moderngl.VertexArray]] = {}  # by the step's source
        self._way("")

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
        program, array = self._way("" if step is None else step.source)
        if texture is not None:
            texture.use(UNITS["step_texture"])
        into.framebuffer.use()
        self._ctx.enable_only(moderngl.NOTHING)
        source.texture.use(UNITS["target"])
        views, rows, _, _ = into.shape
        background = program.get("background", None)
        for view in range(views):
            if isinstance(background, moderngl.Uniform):
                background.value = cameras[view].background
            program["view"] = view, 0, view * rows
            self._ctx.viewport = (x, view * rows + y, width, height)
            array.render(moderngl.TRIANGLES, vertices=3)
        self._ctx.viewport = (0, 0, into.shape[2], views * rows)

    def _way(self, source: str) -> tuple[moderngl.Program, moderngl.VertexArray]:
        if source not in self._ways:
            variant = ResolveVariant(cull_hidden=self._cull_hidden)
            program = self._programs.draw("screen", "resolve", variant, {"step.glsl": source} if source else {})
            self._ways[source] = program, self._ctx.vertex_array(program, [])
        return self._ways[source]

    def release(self) -> None:
        """Delete the vertex arrays."""
        for _, array in self._ways.values():
            array.release()


def _framebuffer(ctx: moderngl.Context, *textures: moderngl.Texture | moderngl.TextureArray) -> moderngl.Framebuffer:
    try:
        return ctx.framebuffer(list(textures))
    except moderngl.Error:
        size = "x".join(map(str, textures[0].size))
        raise ContextError(
            f"the driver cannot make a target of {size}; is there enough memory? use a smaller size"
        ) from None
