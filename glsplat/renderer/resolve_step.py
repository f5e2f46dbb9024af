"""Step: what somebody else draws into 8-bit pictures, a function of the resolve pass before it rounds."""

from __future__ import annotations

from typing import Protocol

import moderngl
import numpy as np
from numpy.typing import NDArray

from glsplat.errors import GlsplatError
from glsplat.gl.context import Context
from glsplat.renderer.lru_cache import LruCache

__all__ = ["ResolveStep", "StepTextures", "checked_step"]

_KEPT = 64
"""Textures; of 16 KiB each, as many sessions can take turns without any being made anew."""


class ResolveStep(Protocol):
    """A value (hashable, equal ones draw the same), registered as ``Renderer.step`` by who owns it."""

    @property
    def source(self) -> str:
        """GLSL: ``vec4 stepped(vec4 colour, ivec2 pixel)``, premultiplied; it may read ``sampler2D step_texture``.

        ``pixel`` counts from the top left corner of each view.
        """

    def tile(self) -> NDArray[np.float32]:
        """[H, W] what ``step_texture`` holds, row 0 first; not filtered."""

    def __hash__(self) -> int: ...


def checked_step(step: ResolveStep | None, boxed: bool) -> ResolveStep | None:
    """The step, which only 8-bit pictures (``boxed``) have. Raises GlsplatError."""
    if step is None:
        return None
    if not isinstance(getattr(step, "source", None), str) or not callable(getattr(step, "tile", None)):
        raise GlsplatError(
            f"a step needs source and tile(), as glsplat.extras.watermark.Watermark has, not {type(step).__name__}"
        )
    if not boxed:
        raise GlsplatError("a step is drawn into 8-bit pictures; use RenderConfig(output='uint8')")
    return step


class _Texture:
    def __init__(self, context: Context, tile: NDArray[np.float32]) -> None:
        self.texture: moderngl.Texture = context.ctx.texture(tile.shape[::-1], 1, tile, dtype="f4")
        self.texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self.nbytes = tile.nbytes

    def release(self) -> None:
        self.texture.release()


class StepTextures:
    """Owns a texture for each of the steps used last."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._textures: LruCache[ResolveStep, _Texture] = LruCache(_KEPT, 2**30)

    @property
    def nbytes(self) -> int:
        """GPU bytes of the textures."""
        return self._textures.nbytes

    def of(self, step: ResolveStep) -> moderngl.Texture:
        """Its texture."""
        return self._textures.get(step, lambda: _Texture(self._context, step.tile())).texture

    def release(self) -> None:
        """Delete the textures; asking for one afterwards makes it anew."""
        self._textures.release()
