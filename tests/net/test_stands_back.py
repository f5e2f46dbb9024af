"""While others need the processor, a driver that draws on it draws a tenth of the time; any other goes on as it was."""

from __future__ import annotations

import asyncio
import time

import pytest

from glsplat.gl.software import is_software
from glsplat.net import render_loop
from glsplat.net.client import Client
from glsplat.net.server import Server, ServerConfig
from tests.net.conftest import FakeBackend, eyes

pytestmark = pytest.mark.check

TOOK = 0.02  # seconds of a picture, at least


class Slow(FakeBackend):
    def __init__(self, driver: str) -> None:
        super().__init__()
        self.called = driver

    def open(self) -> str:
        super().open()
        return self.called

    def render(self, job):
        time.sleep(TOOK)
        return super().render(job)


def seconds(driver: str, needed: bool, pictures: int = 5) -> float:
    async def main() -> float:
        server = Server(Slow(driver), ServerConfig(port=0))
        server.render_loop.stands_back = lambda: needed
        await server.start()
        try:
            async with Client(server.url) as client:
                await client.render(eyes())
                began = time.monotonic()
                for _ in range(pictures):
                    await client.render(eyes())
                return time.monotonic() - began
        finally:
            await server.stop()

    return asyncio.run(main())


def test_a_software_driver_stands_back() -> None:
    assert seconds("llvmpipe (LLVM 15.0.6, 256 bits)", True) >= 5 * 9 * TOOK


@pytest.mark.parametrize(("driver", "needed"), [("NVIDIA H100/PCIe/SSE2", True), ("llvmpipe", False)])
def test_others_go_on(monkeypatch: pytest.MonkeyPatch, driver: str, needed: bool) -> None:
    monkeypatch.setattr(render_loop, "_BACK", 1e9)
    monkeypatch.setattr(render_loop, "_LONGEST_BACK", 1e9)  # it would never end
    assert seconds(driver, needed) < 60


@pytest.mark.parametrize("driver", ["llvmpipe (LLVM 15.0.6, 256 bits)", "softpipe", "Google SwiftShader", "lavapipe"])
def test_names_of_software(driver: str) -> None:
    assert is_software(driver) and not is_software("zink Vulkan 1.3(NVIDIA)") and not is_software("AMD Radeon")
