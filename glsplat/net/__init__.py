"""The network: ``Server`` and ``Client``, and what a renderer or a solver behind a server is given and gives."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from glsplat.net.backend import Backend, Offered, PoseSolver, Rendered, RenderJob, Solved
    from glsplat.net.backends.server import make_server
    from glsplat.net.client import Client
    from glsplat.net.messages import PictureOptions, Request
    from glsplat.net.reply import Reply
    from glsplat.net.server import Server, ServerConfig

__all__ = [
    "Backend",
    "Client",
    "Offered",
    "PictureOptions",
    "PoseSolver",
    "RenderJob",
    "Rendered",
    "Reply",
    "Request",
    "Server",
    "ServerConfig",
    "Solved",
    "make_server",
]

_HOME = {
    **dict.fromkeys(("Backend", "Offered", "PoseSolver", "RenderJob", "Rendered", "Solved"), "backend"),
    **dict.fromkeys(("PictureOptions", "Request"), "messages"),
    **dict.fromkeys(("Server", "ServerConfig"), "server"),
    "Client": "client",
    "Reply": "reply",
    "make_server": "backends.server",
}


def __getattr__(name: str) -> object:
    if name in _HOME:
        return getattr(import_module(f"glsplat.net.{_HOME[name]}"), name)
    raise AttributeError(f"module 'glsplat.net' has no attribute {name!r}")
