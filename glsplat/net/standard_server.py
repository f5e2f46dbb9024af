"""A server with the features that every server has."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from glsplat.extras.browser.poses.splat_files import SplatFiles
from glsplat.extras.operations.history import History
from glsplat.extras.operations.previews import Previews
from glsplat.net import server
from glsplat.net.backend import AvatarInfo, Backend
from glsplat.net.catalogue import Catalogue
from glsplat.net.drawer import Drawer
from glsplat.net.feature import Feature
from glsplat.net.options import ServerConfig
from glsplat.net.pages.routes import Pages
from glsplat.net.render_loop import RenderLoop
from glsplat.net.worker.encoding import PictureEncoder
from glsplat.net.worker.thread import ThreadWorker
from glsplat.net.worker.worker import Worker

__all__ = ["server_of"]


def server_of(
    backend: Backend | Worker | Drawer,
    config: ServerConfig | None = None,
    offered: Sequence[AvatarInfo] = (AvatarInfo(name="default"),),
    features: Sequence[Feature] = (),
    later: Callable[[], Iterable[AvatarInfo]] = tuple,
) -> server.Server:
    """Return a server that draws with ``backend``: on a thread of this process, with a worker, or with a pool.

    It has the pages and hands out splat files; rooms and datagrams where ``config`` names them; and ``features``.
    ``later`` returns more avatars to offer once clients can connect.
    """
    config = config or ServerConfig()
    clock = server.clock
    drawer = ThreadWorker(backend) if isinstance(backend, Backend) else backend
    if isinstance(drawer, Worker):
        drawer = RenderLoop(drawer, clock, config.fps, PictureEncoder(config.video))
    history = History()
    splat_files = SplatFiles()
    standard: list[Feature] = [splat_files, Pages(history), Previews(history)]
    if config.rooms:
        from glsplat.extras.rooms.rooms import Rooms  # here: most servers have none

        rooms = Rooms(config.rooms, config.furnished)
        splat_files.worn = rooms.worn_for
        standard.append(rooms)
    if config.webtransport:
        from glsplat.extras.far_links.datagrams.feature import Datagrams

        standard.append(Datagrams(clock))
    return server.Server(Catalogue(offered), drawer, config, (*standard, *features), later)
