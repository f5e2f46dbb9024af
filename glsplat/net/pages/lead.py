"""Lead: who leads the clients of a server through more than pictures (a study, say), as the server sees it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

from aiohttp import web

from glsplat.net.backend import PoseSolver
from glsplat.net.options import RequestedOptions
from glsplat.net.pace.client_stream import Tap

__all__ = ["Lead"]


class Lead(Protocol):
    """Has addresses of its own, behind the server's gate, and a word in what each client is shown."""

    def open(self, end: Callable[[int, str], None]) -> Sequence[web.RouteDef]:
        """The addresses, from now on. ``end`` closes the connection of a client by its number, for a reason."""
        ...

    def knows(self, request: web.Request) -> bool:
        """Whether it comes from somebody with a secret of these addresses, who may ask often."""
        ...

    async def stop(self) -> None:
        """The server stops."""
        ...

    def choose(self, asked: RequestedOptions, query: Mapping[str, str]) -> RequestedOptions:
        """What a client that connects is shown. Raises ProtocolError for one that may not."""
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
