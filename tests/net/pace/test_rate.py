"""A server that is to hold a rate: what its replies say of level and size, and when they say nothing."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from glsplat.net.backend import Rendered, RenderJob
from glsplat.net.client import Client
from glsplat.net.reply import Reply
from glsplat.net.server import Server, ServerConfig
from tests.net.clocks import Stopped
from tests.net.conftest import FakeBackend, eyes


@dataclass
class Levels(FakeBackend):
    """Two levels: the finer one takes ``slow`` seconds, the other a tenth; half the pixels a tenth of that."""

    clock: Stopped = field(default_factory=Stopped)
    slow: float = 0.05
    last: int = 1

    def render(self, request: RenderJob) -> Rendered:
        level = min(int(request.detail <= -1), self.last)
        self.clock.now += self.slow * 0.1**level * (1 if request.cameras[0].width > 40 else 0.05)
        return replace(super().render(request), levels=(level,), coarsest=level == self.last)


def replies(backend: FakeBackend, config: ServerConfig, count: int) -> list[Reply]:
    async def main() -> list[Reply]:
        server = Server(backend, config)
        await server.start()
        try:
            async with Client(server.url) as client:
                return [await client.render(eyes(64)) for _ in range(count)]
        finally:
            await server.stop()

    return asyncio.run(main())


def test_coarser_levels_first_and_the_reply_says_so(stopped: Stopped) -> None:
    told = replies(Levels(clock=stopped), ServerConfig(port=0, fps=40), 12)
    assert "detail" not in told[0].info
    last = told[-1].info
    assert last["detail"] == {"levels": [1], "bias": last["detail"]["bias"], "scale": 1.0}
    assert last["detail"]["bias"] <= -1 and last["size"] == [64, 64] and told[-1].images()[0].shape == (64, 64, 3)


def test_then_smaller_pictures(stopped: Stopped) -> None:
    told = replies(Levels(clock=stopped, last=0), ServerConfig(port=0, fps=40), 30)
    scale = told[-1].info["detail"]["scale"]
    size = round(64 * scale)
    assert scale < 0.7 and told[-1].info["size"] == [size, size]
    left, right = told[-1].images()
    assert left.shape == right.shape == (size, size, 3)
    first, last = told[0].info["eyes"][0], told[-1].info["eyes"][0]
    assert np.allclose(np.array(last["K"]), np.array(first["K"]) * scale, rtol=0.02)
    assert last["viewmat"] == first["viewmat"]


@pytest.mark.parametrize("fps", [None, 5.0])
def test_without_need_nothing_is_said(stopped: Stopped, fps: float | None) -> None:
    backend = Levels(clock=stopped, last=0)
    told = replies(backend, ServerConfig(port=0, fps=fps), 12)
    assert all("detail" not in reply.info for reply in told)
    assert {request.detail for request in backend.drawn} == {0.0} and backend.drawn[0].viewer > 0
