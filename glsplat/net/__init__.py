"""The network: ``Server`` and ``Client``, and what a renderer or a solver behind them is given. No OpenGL."""

from __future__ import annotations

from typing import TYPE_CHECKING

from glsplat import on_demand

if TYPE_CHECKING:
    from glsplat.net.backend import AvatarInfo, Backend, PoseSolver, Rendered, RenderJob, Solved
    from glsplat.net.client.client import Client
    from glsplat.net.fields import PictureOptions
    from glsplat.net.gl_server import make_server
    from glsplat.net.messages import Request
    from glsplat.net.options import ServerConfig
    from glsplat.net.reply import Reply
    from glsplat.net.server import Server

__all__ = [
    "AvatarInfo",
    "Backend",
    "Client",
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
    **dict.fromkeys(("Backend", "AvatarInfo", "PoseSolver", "RenderJob", "Rendered", "Solved"), "backend"),
    "PictureOptions": "fields",
    "Request": "messages",
    "ServerConfig": "options",
    "Server": "server",
    "Client": "client.client",
    "Reply": "reply",
    "make_server": "gl_server",
}

__getattr__ = on_demand(__name__, _HOME)
