"""A stereo pair's swapchains: one of two layers if the runtime has it, else one for each eye; with optional depth."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack

import moderngl

from glsplat.errors import ContextError, ContextLostError, GlsplatError
from glsplat.extras.openxr.eyes import DepthRange, EyeImages, EyePass, Surroundings
from glsplat.extras.openxr.openxr.calls import Swapchain
from glsplat.extras.openxr.openxr.runtime import OpenXrRuntime
from glsplat.extras.openxr.runtime import Projection, ViewPose
from glsplat.gl.context import Context
from glsplat.renderer.targets import Target

SRGB8, RGBA16F, RGBA8 = 0x8C43, 0x881A, 0x8058
"""GL formats of colour, best first. Colours are sRGB; for the last two they are converted to linear light."""

DEPTHS = (0x8CAC, 0x81A6, 0x81A5)  # GL_DEPTH_COMPONENT32F, 24, 16


def fitting(runtime: OpenXrRuntime, scale: float, most: int) -> tuple[int, int]:
    """Return the pixels of an eye: the recommended size times ``scale``, within the runtime's and driver's limits."""
    width, height = (max(1, round(side * scale)) for side in runtime.size)
    limits = (min(runtime.max_size[0], most), min(runtime.max_size[1], most))
    shrink = min(1.0, limits[0] / width, limits[1] / height)
    return max(1, int(width * shrink)), max(1, int(height * shrink))


class EyeSwapchains:
    """Swapchains of one size; ``fill`` draws into the next image of each."""

    def __init__(self, runtime: OpenXrRuntime, context: Context, size: tuple[int, int], depth: bool) -> None:
        self.size: tuple[int, int] = size
        colour = next((f for f in (SRGB8, RGBA16F, RGBA8) if f in runtime.formats), None)
        if colour is None:
            known = ", ".join(hex(f) for f in runtime.formats)
            raise ContextError(f"{runtime.name} has no images of a colour format that is known here; it has {known}")
        deep = next((f for f in DEPTHS if f in runtime.formats), None) if depth else None
        self._stack = ExitStack()
        with ExitStack() as stack:
            self._colour = _made(runtime, colour, size, False, stack)
            self._depth: Sequence[Swapchain] = ()
            if deep is not None:
                self._depth = _made(runtime, deep, size, True, stack)
                if len(self._depth) != len(self._colour):  # one draw has to write both
                    self._depth = ()
            self._pass = EyePass(context, linear=colour != SRGB8)
            stack.callback(self._pass.release)  # the framebuffers before the images
            self._stack = stack.pop_all()
        self.filled = False

    @property
    def depth(self) -> bool:
        """Whether pictures need depth."""
        return bool(self._depth)

    @property
    def layers(self) -> int:
        """Layers of an image: 2 if one draw fills both eyes."""
        return self._colour[0].layers

    def fill(
        self,
        target: Target,
        depth: DepthRange | None = None,
        around: Surroundings | None = None,
        finish: Callable[[], None] | None = None,
    ) -> float:
        """Draw a pair into the next images; return the seconds it took, including the GPU's with ``finish``."""
        chains = [*self._colour, *self._depth]
        names = []
        taken: list[Swapchain] = []
        try:
            for chain in chains:
                index = chain.acquire()
                taken.append(chain)
                names.append(chain.textures[index])
            count = len(self._colour)
            images = EyeImages(tuple(names[:count]), tuple(names[count:]))
            begun = time.perf_counter()
            self._pass.run(target, images, depth, around)
            if finish is not None:
                finish()
            spent = time.perf_counter() - begun
        finally:
            for chain in taken:
                chain.release()
        self.filled = True
        return spent

    def show(
        self,
        target: Target,
        framebuffer: moderngl.Framebuffer,
        size: tuple[int, int],
        around: Surroundings | None = None,
        eye: int = 0,
    ) -> None:
        """Show one eye's picture in a window."""
        self._pass.show(target, framebuffer, size, around, eye)

    def projection(
        self, views: Sequence[ViewPose], depth: DepthRange | None = None, transparent: bool = False
    ) -> Projection:
        """Return the projection layer of the last filled images, drawn for ``views``."""
        return Projection(tuple(views), self._colour, self._depth, depth, transparent)

    def close(self) -> None:
        """Destroy the swapchains; a lost runtime has no swapchains left."""
        try:
            self._stack.close()
        except ContextLostError:
            pass


def _made(
    runtime: OpenXrRuntime, internal_format: int, size: tuple[int, int], depth: bool, stack: ExitStack
) -> tuple[Swapchain, ...]:
    """Return one swapchain of two layers, or two of one layer."""
    try:
        chains = [runtime.swapchain(internal_format, size, 2, depth)]
    except ContextLostError:
        raise
    except GlsplatError:
        chains = [runtime.swapchain(internal_format, size, 1, depth) for _ in range(2)]
    for chain in chains:
        stack.callback(chain.close)
    return tuple(chains)
