"""How many pictures arrive on the screen, what the page says of it, and that nothing piles up over a long time."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

import pytest

from glsplat.net.pace import stages
from tests.browser.conftest import OpenPage
from tests.browser.markers import Markers, offered
from tests.browser.opened import Opened
from tests.browser.stored import StoredPairs
from tests.browser.vr import enter, hands, pose, steer, visit

WINDOW = (640, 400)  # pixels: a software rasterizer is to spend its time on little else than the pictures


def moving(page: Opened, side: int = 256) -> Opened:
    """In VR on the fake headset, with a head and hands that move, at full speed."""
    page.js("watch.reading = false")
    steer(page, input="hands", hands=hands(pose([-0.3, 1, -0.3]), pose([0.3, 1.1, -0.3])), side=side)
    page.js("""() => { fakeXR.motion = (time, device) => {
      const turn = 0.05 * Math.sin(time / 400);
      device.head = [0.05 * Math.sin(time / 700), 1.6, 0, 0, Math.sin(turn), 0, Math.cos(turn)];
    }; }""")
    return enter(page)


def settle(page: Opened) -> None:
    """No more frames; until no picture is under way, and the newest one waits to be shown."""
    page.js("fakeXR.stop()")
    sent, shown = 1, 0
    while shown != sent:
        sent = page.stats()["sentId"]
        page.js("fakeXR.step()")
        shown = page.stats()["shownId"]
        page.until("window.glsplat.stats().bitmaps > 0")


def test_the_renderer_does_not_wait_for_the_page(open_page: OpenPage, serve: Any) -> None:
    """A picture is begun while the one before is on its way; with one picture under way it never would be."""
    begun = set()

    def place(request: Any) -> dict[str, list[float]]:
        for client in list(served.server.clients.values()):
            status = client.session.status()
            if status["under_way"] + status["unacknowledged"] > 1:
                begun.add(request.frame_id)
        return {"red": [0, 1, 0]}

    served = serve(Markers(place, radius=0.1, delay=0.1), offered=offered)
    page = moving(visit(open_page, served, {"view": "facing", "size": 512, "drawer": False}, size=WINDOW))
    page.meanwhile(lambda: len(begun) >= 8)


def test_the_figures_are_the_servers(open_page: OpenPage, serve: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    backend = Markers(lambda request: {"red": [0, 1, 0]}, radius=0.1, delay=0.05)
    served = serve(backend, offered=offered)
    values = {"view": "facing", "size": 512, "figures": True, "drawer": False}
    page = moving(visit(open_page, served, values, size=WINDOW))
    page.meanwhile(lambda: served.stats()["clients"][0]["sent"] >= 30)
    settle(page)  # both sides know the same pictures now, fewer than they keep
    here, there = page.stats(), served.stats()
    for stage in ("total", "render"):
        assert here["server"][stage] == pytest.approx(there["stages"][stage]["median"], rel=0.1)
    assert here["droppedByServer"] == there["clients"][0]["dropped"]
    assert here["rttMs"] >= here["server"]["total"] > 50
    # ten pictures a second by clocks that are turned by hand, for longer than either side looks back
    clock = SimpleNamespace(now=time.monotonic() + 10)
    monkeypatch.setattr(stages, "time", SimpleNamespace(monotonic=lambda: clock.now))
    page.js("const start = performance.now() + 1e4; window.passed = 0; performance.now = () => start + passed;")
    for _ in range(60):
        clock.now += 0.1
        page.js("() => { passed += 100; fakeXR.step(); }")
        page.until("window.glsplat.stats().bitmaps > 0", every=0.01)
    assert page.stats()["fps"] == pytest.approx(10) and served.stats()["fps"] == pytest.approx(10, abs=0.3)
    values = "[...document.querySelectorAll('#numbers dd')].map((value) => value.textContent)"
    page.until(f"{values}[0] === '10.0'")
    assert len(page.js(values)) >= 6


def test_nothing_piles_up(open_page: OpenPage, serve: Any) -> None:
    served = serve(StoredPairs(), offered=offered)
    page = moving(visit(open_page, served, {"view": "mirror", "size": 256, "drawer": False}, size=WINDOW), 64)

    def state(pictures: float) -> dict[str, float]:
        page.until(f"window.glsplat.stats().shown >= {pictures}", 800, every=0.5)
        settle(page)
        page.js("() => { gc(); gc(); }")
        found = page.js("""() => ({heap: performance.memory.usedJSHeapSize, open: watch.opened - watch.closed,
          textures: window.glsplat.stats().textures, shown: window.glsplat.stats().shown})""")
        page.js("fakeXR.run()")
        return found

    early = state(250)  # what the page keeps is there by then
    late = state(early["shown"] + 150)
    assert late["open"] <= 4 and early["open"] <= 4, (early, late)  # one pair may wait to be shown
    assert late["textures"] == early["textures"]
    assert late["heap"] <= 1.05 * early["heap"], (early, late)
