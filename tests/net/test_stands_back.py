"""While others need the processor, a driver that draws on it draws a tenth of the time; any other goes on as it was."""

from __future__ import annotations

import time
from dataclasses import dataclass

import pytest

from glsplat.gl.software import is_software
from glsplat.net import render_loop
from glsplat.net.client import Client
from tests.net.conftest import FakeBackend, eyes, serving

pytestmark = pytest.mark.check

TOOK = 0.02  # seconds of a picture


@dataclass
class Named(FakeBackend):
    driver: str = ""

    def open(self) -> str:
        super().open()
        return self.driver


async def seconds(driver: str, needed: bool, pictures: int = 3) -> float:
    async with serving(Named(TOOK, driver=driver)) as server, Client(server.url) as client:
        server.render_loop.stands_back = lambda: needed
        await client.render(eyes())
        began = time.monotonic()
        for _ in range(pictures):
            await client.render(eyes())
        return time.monotonic() - began


async def test_a_software_driver_stands_back() -> None:
    assert await seconds("llvmpipe (LLVM 15.0.6, 256 bits)", True) >= 3 * 9 * TOOK


@pytest.mark.parametrize(("driver", "needed"), [("NVIDIA H100/PCIe/SSE2", True), ("llvmpipe", False)])
async def test_others_go_on(monkeypatch: pytest.MonkeyPatch, driver: str, needed: bool) -> None:
    monkeypatch.setattr(render_loop, "_BACK", 1e9)
    monkeypatch.setattr(render_loop, "_LONGEST_BACK", 1e9)  # it would never end
    assert await seconds(driver, needed) < 60


@pytest.mark.parametrize("driver", ["llvmpipe (LLVM 15.0.6, 256 bits)", "softpipe", "Google SwiftShader", "lavapipe"])
def test_names_of_software(driver: str) -> None:
    assert is_software(driver) and not is_software("zink Vulkan 1.3(NVIDIA)") and not is_software("AMD Radeon")
