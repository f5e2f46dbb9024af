"""Catalogue: the avatars that clients may choose. It may change while the server runs."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from typing import Any

from glsplat.errors import GlsplatError
from glsplat.net.backend import AvatarInfo


class Catalogue:
    """The offered avatars by name. The first is the default, and is never removed.

    ``later`` returns more avatars, which take long to load: the server adds them once clients can connect.
    """

    def __init__(self, offered: Sequence[AvatarInfo], later: Callable[[], Iterable[AvatarInfo]] = tuple) -> None:
        self._later = later
        self._offered = {one.name: one for one in offered}
        if not offered or len(self._offered) < len(offered):
            raise GlsplatError("a server offers one thing or several of different names: clients choose by name")

    @property
    def names(self) -> tuple[str, ...]:
        """Names in the order of the offer, the default first."""
        return tuple(self._offered)

    def __getitem__(self, name: str) -> AvatarInfo:
        return self._offered[name]

    def later(self) -> Iterator[AvatarInfo]:
        """Yield the avatars to add after the start; each is loaded when it is its turn."""
        return (one for one in self._later() if one.name not in self._offered)

    def add(self, one: AvatarInfo) -> None:
        """Offer another avatar."""
        self._offered[one.name] = one

    def remove(self, name: str) -> bool:
        """Withdraw an avatar; return False where it was not offered."""
        return self._offered.pop(name, None) is not None

    def fields(self, names: Collection[str]) -> list[dict[str, Any]]:
        """Return the entries of ``names`` in /session."""
        return [
            {
                "name": one.name,
                "title": one.title,
                "height": None if one.height is None else round(one.height, 4),
                "tracking": one.solver is not None,
                "head": "head" in one.parts,
                "made": one.made,
            }
            for one in self._offered.values()
            if one.name in names
        ]
