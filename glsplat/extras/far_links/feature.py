"""Pictures by datagrams, as a feature of a server."""

from __future__ import annotations

from glsplat.extras.far_links.datagrams.feature import Datagrams
from glsplat.net.feature import Feature
from glsplat.net.options import ServerConfig


def features(config: ServerConfig) -> list[Feature]:
    """Return WebTransport if ``config`` has it. Raises GlsplatError without a suitable aioquic."""
    return [Datagrams()] if config.webtransport else []
