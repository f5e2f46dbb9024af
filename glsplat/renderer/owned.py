"""Own GL objects: an ExitStack releases them together, also if an allocation fails half way; a cache of owners."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from contextlib import ExitStack
from typing import Generic, Protocol, TypeVar

import moderngl
import numpy as np
from numpy.typing import NDArray


class Owner(Protocol):
    """Anything that owns GL objects."""

    def release(self) -> None:
        """Delete them."""


class Sized(Owner, Protocol):
    """An owner of GL objects that take ``nbytes`` on the GPU."""

    @property
    def nbytes(self) -> int:
        """GPU bytes."""


T = TypeVar("T", bound=Owner)
K = TypeVar("K", bound=Hashable)
V = TypeVar("V", bound=Sized)


class OwnsObjects:
    """Base of classes whose GL objects are in one stack, which ``__init__`` sets when all allocations are done."""

    _owned: ExitStack

    def release(self) -> None:
        """Delete the GL objects. May be called twice."""
        self._owned.close()


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


class LruCache(Generic[K, V]):
    """Owners of GL objects by key. A call that is interrupted at any line leaves it consistent."""

    def __init__(self, most: int, most_bytes: int) -> None:
        self._most, self.most_bytes = most, most_bytes  # owners, and bytes of owners that are not in use
        self._owners: dict[K, V] = {}
        self._last_use: dict[K, int] = {}
        self._uses = 0

    def __len__(self) -> int:
        return len(self._owners)

    def __iter__(self) -> Iterator[V]:
        return iter(tuple(self._owners.values()))

    @property
    def nbytes(self) -> int:
        """GPU bytes of all owners."""
        return sum(owner.nbytes for owner in self._owners.values())

    def get(self, key: K, make: Callable[[], V]) -> V:
        """Return the owner for ``key``, made by ``make`` if there is none, and trim the others."""
        owner = self.use(key, make)
        self.trim(key)
        return owner

    def use(self, key: K, make: Callable[[], V]) -> V:
        """Return the owner for ``key`` as ``get()`` does, and trim nothing."""
        owner = self._owners.get(key)
        if owner is None:
            owner = make()
            self._owners[key] = owner
        self._uses += 1
        self._last_use[key] = self._uses
        return owner

    def trim(self, key: K) -> None:
        """Release owners above the limits, the least recently used first, but not the one for ``key``."""
        used = self._owners[key]
        while len(self) > 1 and (len(self) > self._most or self.nbytes - used.nbytes > self.most_bytes):
            others = (other for other in self._owners if other != key)
            oldest = min(others, key=lambda other: self._last_use.get(other, 0))
            self._owners.pop(oldest).release()
            self._last_use.pop(oldest, None)

    def release(self) -> None:
        """Release all owners; forgotten first, so that none is used half released."""
        owners, self._owners, self._last_use = self._owners, {}, {}
        for owner in owners.values():
            owner.release()
