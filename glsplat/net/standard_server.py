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
from glsplat.net.local_loop import LocalLoop
from glsplat.net.options import ServerConfig
from glsplat.net.pages.routes import Pages

__all__ = ["server_of"]


def server_of(
    backend: Backend | Drawer,
    config: ServerConfig | None = None,
    offered: Sequence[AvatarInfo] = (AvatarInfo(name="default"),),
    features: Sequence[Feature] = (),
    later: Callable[[], Iterable[AvatarInfo]] = tuple,
) -> server.Server:
    """Return a server of what ``backend`` draws, on one thread of this process or with the workers of a pool.

    It has the pages and hands out splat files; rooms and datagrams where ``config`` names them; and ``features``.
    ``later`` returns more avatars to offer once clients can connect.
    """
    config = config or ServerConfig()
    clock = server.clock
    drawer = LocalLoop(backend, clock, config.fps, config.video) if isinstance(backend, Backend) else backend
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
