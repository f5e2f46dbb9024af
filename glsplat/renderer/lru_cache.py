"""LruCache: what was made for a key stays for the next time, as long as it is among the few used last."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from typing import Generic, Protocol, TypeVar

__all__ = ["LruCache"]


class _Owner(Protocol):
    @property
    def nbytes(self) -> int: ...

    def release(self) -> None: ...


K = TypeVar("K", bound=Hashable)
V = TypeVar("V", bound=_Owner)


class LruCache(Generic[K, V]):
    """Owners of GL objects by key. A call that is broken off at any line leaves it whole."""

    def __init__(self, most: int, most_bytes: int) -> None:
        self._most, self.most_bytes = most, most_bytes  # owners, and bytes of those that are not in use
        self._owners: dict[K, V] = {}
        self._used: dict[K, int] = {}  # the larger the later
        self._uses = 0

    def __len__(self) -> int:
        return len(self._owners)

    def __iter__(self) -> Iterator[V]:
        return iter(tuple(self._owners.values()))

    @property
    def nbytes(self) -> int:
        """GPU bytes of all that is kept."""
        return sum(owner.nbytes for owner in self._owners.values())

    def get(self, key: K, make: Callable[[], V]) -> V:
        """What is kept for ``key``, or what ``make`` makes; lets go what was not used for longest."""
        owner = self._owners.get(key)
        if owner is None:
            owner = make()
            self._owners[key] = owner
        self._uses += 1
        self._used[key] = self._uses
        while len(self) > 1 and (len(self) > self._most or self.nbytes - owner.nbytes > self.most_bytes):
            oldest = min((other for other in self._owners if other != key), key=lambda other: self._used.get(other, 0))
            self._owners.pop(oldest).release()
            self._used.pop(oldest, None)
        return owner

    def release(self) -> None:
        """Delete all; forgotten first, so that what is broken off is not used again."""
        owners, self._owners, self._used = self._owners, {}, {}
        for owner in owners.values():
            owner.release()
