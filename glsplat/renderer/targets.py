"""Targets: the float texture array the splats blend into, one layer a view, and the 8-bit picture made of it."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any

import moderngl
import numpy as np

from glsplat.errors import ContextError
from glsplat.gl.context import Context
from glsplat.renderer.owned import LruCache, OwnsObjects, owned

FORMATS = {"8": "f1", "16f": "f2", "32f": "f4"}
"""RenderConfig.target -> moderngl dtype."""

MAX_SIZES = 4
"""Sizes whose targets are kept."""

MAX_BYTES = 256 * 2**20
"""Bytes of targets of sizes other than the current one."""

_NUMPY = {"f1": np.uint8, "f2": np.float16, "f4": np.float32}


class Target(OwnsObjects):
    """Colour for V views of one size: premultiplied RGB over the background, and accumulated alpha.

    With ``depth`` a second texture array takes the sums of weight times camera z (metres) and of weight.
    """

    def __init__(
        self, ctx: moderngl.Context, width: int, height: int, views: int, dtype: str, depth: bool = False
    ) -> None:
        self.shape: tuple[int, int, int, int] = (views, height, width, 4)
        self.numpy_dtype: np.dtype[Any] = np.dtype(_NUMPY[dtype])
        self.depth_unit: float = 1.0  # metres of the cameras' world a unit of ``depth``
        # background of each layer, where hidden splats were left out (lift.glsl)
        self.lift: tuple[tuple[float, float, float], ...] | None = None
        with ExitStack() as stack:  # releases everything if an allocation fails
            size = width, height, views
            self.texture: moderngl.TextureArray = owned(stack, ctx.texture_array(size, 4, dtype=dtype))
            self.depth: moderngl.TextureArray | None = None
            if depth:
                self.depth = owned(stack, ctx.texture_array(size, 2, dtype="f4"))
            attached = [self.texture] if self.depth is None else [self.texture, self.depth]
            for texture in attached:
                texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
            self.framebuffer: moderngl.Framebuffer = owned(stack, _framebuffer(ctx, *attached))
            self._owned = stack.pop_all()

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
        pixel = 4 * self.numpy_dtype.itemsize + (0 if self.depth is None else 8)
        return int(np.prod(self.shape[:3])) * pixel


class ByteTarget(OwnsObjects):
    """8 bits a channel, the views one below the other: one plain texture, so that parts of it can be read."""

    def __init__(self, ctx: moderngl.Context, width: int, height: int, views: int) -> None:
        self.shape: tuple[int, int, int, int] = (views, height, width, 4)
        with ExitStack() as stack:  # releases everything if an allocation fails
            self.texture: moderngl.Texture = owned(stack, ctx.texture((width, height * views), 4))
            self.framebuffer: moderngl.Framebuffer = owned(stack, _framebuffer(ctx, self.texture))
            self._owned = stack.pop_all()

    @property
    def nbytes(self) -> int:
        """GPU bytes of the texture."""
        return int(np.prod(self.shape))


class TargetPool:
    """Targets of the recently used sizes, so that clients of several sizes can take turns without allocations.

    moderngl restores the bound framebuffer when it makes or deletes another, and fails if that one was deleted. So the
    scratch framebuffer is bound first.
    """

    def __init__(self, context: Context, dtype: str) -> None:
        self._context, self._dtype = context, dtype
        self._sizes: LruCache[tuple[int, int], _SizeTargets] = LruCache(MAX_SIZES, MAX_BYTES)

    @property
    def nbytes(self) -> int:
        """GPU bytes of all targets that are kept."""
        return self._sizes.nbytes

    def float_target(self, size: tuple[int, int], views: int, depth: bool = False) -> Target:
        """Return the float target of ``size`` (width, height); releases the least recently used sizes."""
        made = self._of(size).floats
        if (views, depth) not in made:
            self._context.scratch.use()
            made[views, depth] = Target(self._context.ctx, *size, views, self._dtype, depth)
            self._sizes.trim(size)
        return made[views, depth]

    def byte_target(self, size: tuple[int, int], views: int) -> ByteTarget:
        """Return the target of the 8-bit picture of that size."""
        made = self._of(size).bytes
        if views not in made:
            self._context.scratch.use()
            made[views] = ByteTarget(self._context.ctx, *size, views)
            self._sizes.trim(size)
        return made[views]

    def release(self) -> None:
        """Delete all targets; they are made again when needed."""
        self._sizes.release()

    def _of(self, size: tuple[int, int]) -> _SizeTargets:
        return self._sizes.use(size, lambda: _SizeTargets(self._context))


class _SizeTargets:
    """Targets of one size: float ones by views and depth, 8-bit ones by views."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self.floats: dict[tuple[int, bool], Target] = {}
        self.bytes: dict[int, ByteTarget] = {}

    @property
    def _all(self) -> list[Target | ByteTarget]:
        return [*self.floats.values(), *self.bytes.values()]

    @property
    def nbytes(self) -> int:
        """GPU bytes."""
        return sum(target.nbytes for target in self._all)

    def release(self) -> None:
        """Delete all targets."""
        self._context.scratch.use()
        targets, self.floats, self.bytes = self._all, {}, {}
        for target in targets:
            target.release()


def _framebuffer(ctx: moderngl.Context, *textures: moderngl.Texture | moderngl.TextureArray) -> moderngl.Framebuffer:
    try:
        return ctx.framebuffer(list(textures))
    except moderngl.Error:
        size = "x".join(map(str, textures[0].size))
        raise ContextError(
            f"the driver cannot make a target of {size}; is there enough memory? use a smaller size"
        ) from None
