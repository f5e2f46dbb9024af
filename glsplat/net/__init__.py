"""The network: ``Server`` and ``Client``, and what a renderer or a solver behind them is given. No OpenGL."""

from __future__ import annotations

from typing import TYPE_CHECKING

from glsplat import on_demand

if TYPE_CHECKING:
    from glsplat.net.backend import AvatarInfo, Backend, PoseSolver, Rendered, RenderJob, Solved
    from glsplat.net.client.client import Client
    from glsplat.net.feature import Feature
    from glsplat.net.fields import PictureOptions
    from glsplat.net.gl_server import make_server
    from glsplat.net.messages import Request
    from glsplat.net.options import ServerConfig
    from glsplat.net.reply import Reply
    from glsplat.net.server import Server
    from glsplat.net.standard_server import server_of

__all__ = [
    "AvatarInfo",
    "Backend",
    "Client",
    "Feature",
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
    "server_of",
]

_HOME = {
    **dict.fromkeys(("Backend", "AvatarInfo", "PoseSolver", "RenderJob", "Rendered", "Solved"), "backend"),
    "Feature": "feature",
    "PictureOptions": "fields",
    "Request": "messages",
    "ServerConfig": "options",
    "Server": "server",
    "Client": "client.client",
    "Reply": "reply",
    "make_server": "gl_server",
    "server_of": "standard_server",
}

__getattr__ = on_demand(__name__, _HOME)
