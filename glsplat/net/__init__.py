"""Streaming: messages, sans-I/O session, JPEG, server and client (docs/protocol.md). Imports no OpenGL."""

from __future__ import annotations

from typing import TYPE_CHECKING

from glsplat import on_demand

if TYPE_CHECKING:
    from glsplat.net.backends.server import make_server
    from glsplat.net.client import Client
    from glsplat.net.server import ServerConfig

__all__ = ["Client", "ServerConfig", "make_server"]

_HOME = {"Client": "client", "ServerConfig": "server", "make_server": "backends.server"}

__getattr__ = on_demand(__name__, _HOME)
