"""Pictures by datagrams, as a feature of a server."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Any

from glsplat.extras.far_links.datagrams.way import SecondWay
from glsplat.net.client_stream import ClientStream
from glsplat.net.feature import Feature, ServerView
from glsplat.net.options import RequestedOptions, ServerConfig
from glsplat.net.rights import User
from glsplat.optional import require_package

if TYPE_CHECKING:
    from glsplat.extras.far_links.datagrams.listener import DatagramListener


class Datagrams(Feature):
    """Listens to UDP at the number of the server's TCP port.

    Raises GlsplatError if aioquic is not installed, or is a version whose internals differ.
    """

    def __init__(self) -> None:
        require_package("WebTransport", "aioquic", "webtransport", "leave it out")
        import_module("glsplat.extras.far_links.datagrams.aioquic_internals")  # refuses other versions
        self.listener: DatagramListener | None = None  # until the server starts

    async def start(self, server: ServerView) -> None:
        """Listen. Raises GlsplatError if the port is in use."""
        from glsplat.extras.far_links.datagrams.listener import DatagramListener

        self._clock, self.listener = server.clock, DatagramListener(server.clock)
        await self.listener.open(server.config.access.host, server.port)

    async def stop(self) -> None:
        """Close all connections and the port."""
        if self.listener is not None:
            await self.listener.close()

    def client_opened(self, client: ClientStream, asked: RequestedOptions) -> None:
        """Offer the client datagrams once its link gains from them."""
        assert self.listener is not None
        client.offer(SecondWay(self.listener, client.session, client.address, self._clock, client.wake))

    def stats(self, user: User | None) -> Mapping[str, Any]:
        """Return ``datagrams`` of /stats; nothing before the server listens."""
        return {} if self.listener is None else {"datagrams": self.listener.status()}


def features(config: ServerConfig) -> list[Feature]:
    """Return WebTransport if ``config`` has it. Raises GlsplatError without a suitable aioquic."""
    return [Datagrams()] if config.webtransport else []
