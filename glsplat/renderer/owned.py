"""Own GL objects: an ExitStack releases them together, also if an allocation fails half way."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Protocol, TypeVar

import moderngl
import numpy as np
from numpy.typing import NDArray


class Owner(Protocol):
    """Anything that owns GL objects."""

    def release(self) -> None:
        """Delete them."""


T = TypeVar("T", bound=Owner)


def owned(stack: ExitStack, item: T) -> T:
    """Release ``item`` when ``stack`` is closed, and return it."""
    stack.callback(item.release)
    return item


def data_texture(
    stack: ExitStack,
    ctx: moderngl.Context,
    size: tuple[int, int],  # width, height
    components: int,
    data: NDArray[np.generic] | None = None,
    dtype: str = "f4",
) -> moderngl.Texture:
    """Return a texture that shaders read texel by texel, without filtering; ``stack`` owns it."""
    texture: moderngl.Texture = owned(stack, ctx.texture(size, components, data, dtype=dtype))
    texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
    return texture
