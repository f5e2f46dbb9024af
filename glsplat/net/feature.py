"""Feature: an optional part of the server, such as uploads, datagrams or a study.

The server calls its hooks on the event loop. A hook does nothing unless a feature overrides it.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from typing import Any, Protocol

from aiohttp import web

from glsplat.net.backend import PoseSolver
from glsplat.net.catalogue import Catalogue
from glsplat.net.client_stream import ClientStream, Outgoing, PoseAnswer
from glsplat.net.guard.gate import Gate
from glsplat.net.guard.limits import Limits
from glsplat.net.internal_client import InternalClient
from glsplat.net.options import RequestedOptions, ServerConfig
from glsplat.net.rights import User

Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


class PoseResponder(Protocol):
    """Answers requests for poses instead of pictures (extras/browser)."""

    def due(self, client: ClientStream) -> None:
        """Queue the answers to a client that are ready."""

    def pack(self, answer: PoseAnswer) -> Outgoing:
        """Return the messages of an answer with poses, and mark it as being sent."""


class ServerView(Protocol):
    """The part of a server that its features use."""

    config: ServerConfig
    port: int
    clock: Callable[[], float]  # seconds; the render loop's clock
    gate: Gate
    catalogue: Catalogue
    clients: dict[int, ClientStream]  # connected now, by number
    internal_client: InternalClient

    def stats(self, user: User | None = None) -> dict[str, Any]:
        """Return the object of /stats for an account."""

    def session(self, user: User | None = None) -> dict[str, Any]:
        """Return the object of /session for an account."""

    def is_healthy(self) -> bool:
        """Return whether pictures are drawn, and new clients may come."""

    def close_client(self, number: int, reason: str) -> None:
        """Close the connection of a client that broke no limit."""

    async def withdraw(self, name: str) -> bool:
        """Withdraw an avatar and end the connections that show it; return False where it was not offered."""

    def worn_avatars(self, user: User | None) -> set[str]:
        """Return the avatars of people that an account may meet, by all features."""


class Feature:
    """Base class of the server's features."""

    refusal: str = ""
    """Replaces the reason why an avatar may not be shown, where the reason would name the avatar."""

    def limits(self, limits: Limits) -> Limits:
        """Return the limits that the server needs with this feature."""
        return limits

    async def start(self, server: ServerView) -> None:
        """Start, before clients can connect. Raises GlsplatError."""

    async def stop(self) -> None:
        """Stop. Called where ``start`` succeeded."""

    def routes(self) -> Sequence[web.RouteDef]:
        """Return the routes of this feature, all behind the gate. Called after ``start``."""
        return ()

    @web.middleware
    async def guard(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Refuse a request to any address, or return the answer of ``handler``. Runs behind the gate."""
        return await handler(request)

    def is_trusted(self, request: web.Request) -> bool:
        """Return whether a request has a secret of this feature: it then counts less against the visit rate."""
        return False

    def needs_cpu(self) -> bool:
        """Return whether drawing in software should yield the processor to this feature now."""
        return False

    # -------------------------------------------------------------------------------------------------------- clients

    def query(self, query: Mapping[str, str], user: User | None) -> Mapping[str, str]:
        """Return the options of an account's client that connects, given those of its address. Raises ProtocolError."""
        return query

    def solver(self, solver: PoseSolver | None) -> PoseSolver | None:
        """Return the tracking solver of the client whose ``query`` was read last."""
        return solver

    def client_opened(self, client: ClientStream, requested: RequestedOptions) -> None:
        """Handle a new client; may call its methods, such as ``observe``. Raises ProtocolError to refuse it."""

    def client_closed(self, client: ClientStream, goodbye: bool) -> None:
        """Handle a client that left or was refused; ``goodbye``: it closed its connection in order."""

    # -------------------------------------------------------------------------------------------------------- avatars

    async def avatars_added(self) -> None:
        """Handle new avatars in the catalogue."""

    def avatar_withdrawn(self, name: str) -> None:
        """Handle the end of an avatar in the catalogue; another may get its name."""

    def pose_responder(self, server: ServerView) -> PoseResponder | None:
        """Return this feature's responder to requests for poses, if any. Called before ``start``."""
        return None

    def worn_avatars(self, user: User | None) -> Iterable[str]:
        """Return the avatars of people that an account may meet, besides those that it may drive."""
        return ()

    # ---------------------------------------------------------------------------------------------------------- pages

    def stats(self, user: User | None) -> Mapping[str, Any]:
        """Return this feature's fields of /stats for an account."""
        return {}

    def client_stats(self, user: User | None, client: ClientStream) -> Mapping[str, Any]:
        """Return this feature's fields of a client in /stats, which the account may see."""
        return {}

    def session(self, user: User | None) -> Mapping[str, Any]:
        """Return this feature's fields of /session for an account."""
        return {}

    def avatar_fields(self, name: str) -> Mapping[str, Any]:
        """Return this feature's fields of an avatar in /session."""
        return {}
