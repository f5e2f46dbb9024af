"""A server of numpy pictures that runs in a thread of its own, for commands that bring their own event loop."""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial

import numpy as np
import pytest

from glsplat.net.backend import AvatarInfo, Rendered
from glsplat.net.server import Server, ServerConfig


class Stripes:
    delay = 0.0

    def __init__(self) -> None:
        self.requests = []

    def open(self) -> str:
        return "numpy"

    def render(self, request) -> Rendered:
        self.requests.append(request)
        time.sleep(self.delay)
        camera = request.cameras[0]
        out = np.zeros((len(request.cameras), camera.height, camera.width, 4), np.uint8)
        out[:, :, 16:48] = (200, (request.frame_id * 9) % 256, 40, 255)
        return Rendered(out, {"skin": 0.1, "draw": 0.2, "total": 0.3}, "numpy")

    def close(self) -> None:
        pass


@pytest.fixture
def stripes() -> Iterator[tuple[str, Stripes]]:
    """(url, backend) of a running server."""
    backend = Stripes()
    with running(backend) as url:
        yield url, backend


@contextmanager
def running(backend: Stripes, **offered: str) -> Iterator[str]:
    """The url of a server of it, which offers one thing that is ``offered`` so."""
    ready, state = threading.Event(), {}

    def work() -> None:
        async def main() -> None:
            server = Server(backend, ServerConfig(port=0), [AvatarInfo(name="default", **offered)])
            await server.start()
            state.update(url=server.url, loop=asyncio.get_running_loop(), end=asyncio.Event())
            ready.set()
            await state["end"].wait()
            await server.stop()

        asyncio.run(main())

    thread = threading.Thread(target=work)
    thread.start()
    assert ready.wait(60)
    try:
        yield state["url"]
    finally:
        state["loop"].call_soon_threadsafe(state["end"].set)
        thread.join(60)


@pytest.fixture(autouse=True)
def _no_log_of_commands() -> Iterator[None]:
    """A command that logs in the tests' own process writes to the standard error that it had."""
    root = logging.getLogger()
    level = root.level
    yield
    root.setLevel(level)
    for handler in [one for one in root.handlers if type(one) is logging.StreamHandler]:
        root.removeHandler(handler)
    logging.captureWarnings(False)


@pytest.fixture
def quickly_made(monkeypatch: pytest.MonkeyPatch) -> None:
    """Avatars of meshes by few rays, and levels in few steps: what is tested is the command."""
    from apps.avatar import making
    from glsplat.authoring.detail.make import with_levels
    from glsplat.authoring.light import surfaces
    from glsplat.authoring.surface import SamplerConfig, make_avatar

    def made(mesh, splats, seed, **more):
        return make_avatar(mesh, splats, seed, SamplerConfig(probe=96), **more)

    monkeypatch.setattr(making, "make_avatar", made)
    monkeypatch.setattr(making, "with_levels", partial(with_levels, steps=6))
    monkeypatch.setattr(surfaces, "ambient_occlusion", partial(surfaces.ambient_occlusion, directions=6))
