"""The client's side of the WebSocket: ``Client``, its connection, and what it sends."""

from __future__ import annotations

from typing import TYPE_CHECKING

from glsplat import on_demand

if TYPE_CHECKING:
    from glsplat.net.client.client import Client
    from glsplat.net.client.request import request_message
    from glsplat.net.flow import ReceivedReply

__all__ = ["Client", "ReceivedReply", "request_message"]

_HOME = {"Client": "client", "ReceivedReply": "client", "request_message": "request"}

__getattr__ = on_demand(__name__, _HOME)
