"""A renderer that all clients want at any time, on a clock that nothing but its pictures moves."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field

import numpy as np

from glsplat.net.backend import Rendered, RenderJob
from glsplat.net.served_scene import server_of
from glsplat.net.server import Server, ServerConfig
from tests.net.clocks import Stopped
from tests.net.conftest import FakeBackend
from tests.net.wire import HANG

__all__ = ["Contested", "contest"]


@dataclass
class Contested(FakeBackend):
    """Draws once every other client waits for a picture, too: who comes next is the server's choice alone."""

    cost: Callable[[RenderJob], float] = lambda request: 0.0  # seconds
    others: int = 0
    clock: Stopped = field(default_factory=Stopped)
    seconds: float = 1.0  # on the clock, after which it is over
    over: threading.Event = field(default_factory=threading.Event)
    contested: list[RenderJob] = field(default_factory=list)  # what was drawn until then
    server: Server | None = None

    def render(self, request: RenderJob) -> Rendered:
        assert self.server is not None
        until, since = time.monotonic() + HANG, self.clock.now
        while not self.over.is_set() and self._waiting() < self.others:
            assert time.monotonic() < until
            time.sleep(0.0005)
        self.drawn.append(request)
        if not self.over.is_set():
            self.contested.append(request)
        self.clock.now = since + self.cost(request)
        self.seconds -= self.cost(request)
        if self.seconds <= 0:
            self.over.set()
        camera = request.cameras[0]
        pictures = np.zeros((len(request.cameras), camera.height, camera.width, 4), np.uint8)
        return Rendered(pictures, covered=(0, 0, 16, 16))

    def _waiting(self) -> int:
        assert self.server is not None
        return sum(stream.session.newest is not None for stream in list(self.server.clients.values()))


def contest(backend: Contested, clients: list[Callable[[Server], Awaitable[None]]]) -> None:
    """All clients at once on a server with that backend; each asks until it is over."""

    async def main() -> None:
        server = backend.server = server_of(backend, ServerConfig(port=0))
        backend.others = len(clients) - 1
        await server.start()
        try:
            await asyncio.wait_for(asyncio.gather(*(client(server) for client in clients)), 2 * HANG)
        finally:
            backend.over.set()
            await server.stop()

    asyncio.run(main())
