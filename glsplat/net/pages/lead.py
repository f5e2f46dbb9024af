"""Lead: who leads the clients of a server through more than pictures (a study, say), as the server sees it."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Collection, Mapping, Sequence
from typing import Protocol

from aiohttp import web

from glsplat.net.backend import AvatarInfo, PoseSolver
from glsplat.net.client_stream import Tap

__all__ = ["Lead"]


class Lead(Protocol):
    """Has addresses of its own, behind the server's gate, and a word in what each client is shown."""

    unseen: str
    """The reply to a client that may not be shown its avatar, instead of the reason, which names the avatar."""

    def open(self, end: Callable[[int, str], None], offered: Collection[AvatarInfo]) -> Sequence[web.RouteDef]:
        """The addresses, from now on. ``end`` closes the connection of a client by its number, for a reason."""
        ...

    async def guard(
        self, request: web.Request, handler: Callable[[web.Request], Awaitable[web.StreamResponse]]
    ) -> web.StreamResponse:
        """Refuse a request, to whatever address, or let ``handler`` answer it. A middleware behind the gate."""
        ...

    def knows(self, request: web.Request) -> bool:
        """Whether it comes from somebody with a secret of these addresses, who may ask often."""
        ...

    async def stop(self) -> None:
        """The server stops."""
        ...

    def query(self, asked: Mapping[str, str]) -> Mapping[str, str]:
        """The options of a client that connects, instead of those of its address. Raises ProtocolError."""
        ...

    def solver(self, solver: PoseSolver | None) -> PoseSolver | None:
        """What solves the tracking of the client that was asked about last."""
        ...

    def tap(self, number: int) -> Tap:
        """What hears that client, whose number this is."""
        ...

    def left(self, number: int) -> None:
        """That client is gone."""
        ...
