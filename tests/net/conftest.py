"""A renderer made of numpy and a running server on a free port of loopback."""

from __future__ import annotations

import threading
import time
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from glsplat.camera import head_matrix, stereo_cameras
from glsplat.net.backend import Rendered, RenderJob
from glsplat.net.served_scene import server_of
from glsplat.net.server import Server, ServerConfig
from tests.net.clocks import Ahead, Stopped, given_to_servers
from tests.net.wire import HANG


@dataclass
class FakeBackend:
    """Draws an ellipse whose grey value is the frame_id; fails, waits and counts on demand."""

    delay: float = 0.0
    gate: threading.Event = field(default_factory=lambda: _open_gate())  # while it is not set, drawing waits
    fail: Callable[[RenderJob], Exception | None] = lambda request: None
    noise: bool = False  # pictures that do not compress
    opened: bool = False
    closed: bool = False
    threads: set[int] = field(default_factory=set)
    drawn: list[RenderJob] = field(default_factory=list)

    def open(self) -> str:
        self.threads.add(threading.get_ident())
        self.opened = True
        return "numpy <fake>"

    def render(self, request: RenderJob) -> Rendered:
        self.threads.add(threading.get_ident())
        self.drawn.append(request)
        time.sleep(self.delay)
        assert self.gate.wait(HANG)
        error = self.fail(request)
        if error is not None:
            raise error
        width, height = request.cameras[0].width, request.cameras[0].height
        out = np.zeros((len(request.cameras), height, width, 4), np.uint8)
        if self.noise:
            out[:] = np.random.default_rng(0).integers(0, 255, out.shape, np.uint8)
            return Rendered(out, {"draw": 1.0, "total": 1.0})
        y, x = np.mgrid[:height, :width]
        for view, camera in enumerate(request.cameras):
            cx = width * (0.5 - 2 * camera.viewmat[0, 3])
            inside = ((x - cx) / (width / 5)) ** 2 + ((y - height / 2) / (height / 3)) ** 2 < 1
            out[view, inside] = (*(((request.frame_id or 0) % 200 + 50,) * 3), 255)
        return Rendered(out, {"draw": 1.0, "total": 1.0})

    def close(self) -> None:
        self.threads.add(threading.get_ident())
        self.closed = True


def _open_gate() -> threading.Event:
    gate = threading.Event()
    gate.set()
    return gate


Serve = Callable[..., AbstractAsyncContextManager[Server]]


@asynccontextmanager
async def serving(backend: Any = None, config: ServerConfig | None = None, **options: Any) -> AsyncIterator[Server]:
    server = server_of(backend or FakeBackend(), config or ServerConfig(port=0), **options)
    await server.start()
    try:
        yield server
    finally:
        await server.stop()


@pytest.fixture
def serve() -> Serve:
    """``async with serve(backend, config) as server``."""
    return serving


@pytest.fixture
def fake_backend() -> type[FakeBackend]:
    return FakeBackend


@pytest.fixture
def stopped(monkeypatch: pytest.MonkeyPatch) -> Stopped:
    """The clock of the servers that the test starts; it moves by hand alone."""
    clock = Stopped()
    given_to_servers(clock, monkeypatch)
    return clock


@pytest.fixture
def ahead(monkeypatch: pytest.MonkeyPatch) -> Ahead:
    """The clock of the servers that the test starts; it leaps."""
    clock = Ahead()
    given_to_servers(clock, monkeypatch)
    return clock


def eyes(size: int = 64) -> Any:
    """A head 2 m in front of the avatar, looking at it."""
    return stereo_cameras(head_matrix((0, 1.2, 2.0), (0, 0, 0, 1)), size=(size, size))


@pytest.fixture
def cameras() -> Any:
    return eyes()
