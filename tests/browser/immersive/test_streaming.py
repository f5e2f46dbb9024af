"""How many pictures arrive on the screen, what the page says of it, and that nothing piles up over a long time."""

from __future__ import annotations

from typing import Any

import psutil
import pytest

import glsplat
from glsplat.net.backend import Offered
from glsplat.net.backends.server import make_server
from tests.browser.conftest import OpenPage
from tests.browser.markers import Markers, as_tracked
from tests.browser.opened import Opened
from tests.browser.stored import StoredPairs
from tests.browser.vr import enter, hands, pose, steer, visit

OFFERED = (Offered(name="stored", solver=as_tracked, height=1.75, parts=frozenset({"head"})),)
WINDOW = (640, 400)  # pixels: a software rasterizer is to spend its time on little else than the pictures
FPS = 30.0
SHARE = 0.88  # of the pictures a second that the renderer could draw at the same time
FRAMES = 0.6  # of the browser's own frames
TRIES = 3


BUSY = 30.0  # per cent of the machine


@pytest.fixture
def quiet() -> None:
    """Speed is measured where nothing else runs."""
    busy = psutil.cpu_percent(1.0)
    if busy > BUSY:
        pytest.skip(f"the machine is busy ({busy:.0f} % before the test does anything): no speed is measured")


def moving(page: Opened, side: int = 256) -> Opened:
    """In VR on the fake headset, with a head and hands that move, at full speed."""
    page.js("watch.reading = false")
    steer(page, input="hands", hands=hands(pose([-0.3, 1, -0.3]), pose([0.3, 1.1, -0.3])), side=side)
    page.js("""() => { fakeXR.motion = (time, device) => {
      const turn = 0.05 * Math.sin(time / 400);
      device.head = [0.05 * Math.sin(time / 700), 1.6, 0, 0, Math.sin(turn), 0, Math.cos(turn)];
    }; }""")
    return enter(page)


def served(config: Any) -> Any:
    """The renderer with the default avatar."""
    return make_server(glsplat.default_avatar(), config)


def rates(page: Opened, seconds: float = 2.5) -> tuple[float, float]:
    """Pictures shown and display frames a second, over some seconds."""
    shown, began = page.js("[window.glsplat.stats().shown, performance.now()]")
    page.wait(seconds)
    later, ended = page.js("[window.glsplat.stats().shown, performance.now()]")
    return 1e3 * (later - shown) / (ended - began), page.stats()["frameRate"]


def test_stored_pictures_are_shown_at_speed(quiet: None, open_page: OpenPage, serve: Any) -> None:
    served = serve(StoredPairs(), offered=OFFERED)
    page = visit(open_page, served, {"view": "facing", "size": 512}, xr="iwer", size=WINDOW)
    page.js("watch.reading = false")
    enter(page, run=False)
    page.until("window.glsplat.stats().shown > 10")
    seen = []
    for _ in range(TRIES):
        shown, frames = rates(page)
        seen.append((shown, frames))
        # where the browser itself has no time for 50 frames a second, the machine is not free for this
        if shown >= min(FPS, FRAMES * frames):
            break
    else:
        pytest.fail(f"pictures and frames a second: {seen}")
    print(f"pictures and frames a second: {seen}")


@pytest.mark.gl
@pytest.mark.slow
def test_the_renderers_pictures_arrive(quiet: None, open_page: OpenPage, serve: Any) -> None:
    """As many as the renderer can draw beside the browser: it never waits for the page.

    With one picture under way instead of two it would be at 0.80 to 0.86 of that.
    """
    page = moving(visit(open_page, serve(make=served), {"view": "facing", "size": 512}, size=WINDOW))
    page.until("window.glsplat.stats().shown > 10", 60)
    shares = []
    for _ in range(TRIES):
        shown, _ = rates(page, 4)
        shares.append(shown * 1e-3 * page.stats()["server"]["render"])
        if shares[-1] >= SHARE:
            break
    print(f"of what is drawn: {shares}")
    assert max(shares) >= SHARE


def test_the_figures_are_the_servers(open_page: OpenPage, serve: Any) -> None:
    backend = Markers(lambda request: {"red": [0, 1, 0]}, radius=0.1, delay=0.05)
    served = serve(backend, offered=OFFERED)
    page = moving(visit(open_page, served, {"view": "facing", "size": 512, "figures": True}, size=WINDOW))
    for _ in range(TRIES):
        page.wait(6)  # longer than either side looks back
        here, there = page.stats(), served.stats()
        pairs = {
            "pictures a second": (here["fps"], there["fps"]),
            "total": (here["server"]["total"], there["stages"]["total"]["median"]),
            "render": (here["server"]["render"], there["stages"]["render"]["median"]),
        }
        off = {name: pair for name, pair in pairs.items() if pair[0] != pytest.approx(pair[1], rel=0.1)}
        if not off:
            break
    assert not off
    client = there["clients"][0]
    assert here["droppedByServer"] == pytest.approx(client["dropped"], rel=0.1, abs=10)
    assert here["rttMs"] >= here["server"]["total"] > 50
    rows = page.js("Object.fromEntries([...document.querySelectorAll('#numbers dt')]"
                   ".map((term) => [term.textContent, term.nextElementSibling.textContent]))")  # fmt: skip
    assert any(value.startswith(("1", "2")) for value in rows.values()) and len(rows) >= 6


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_nothing_piles_up_over_2000_pictures(open_page: OpenPage, serve: Any) -> None:
    page = moving(
        visit(open_page, serve(StoredPairs(), offered=OFFERED), {"view": "mirror", "size": 512}, size=WINDOW), 64
    )

    def state(pictures: float) -> dict[str, float]:
        page.until(f"window.glsplat.stats().shown >= {pictures}", 400, every=0.5)
        page.js("fakeXR.stop()")
        page.wait(0.7)
        page.js("() => { fakeXR.step(); fakeXR.step(); gc(); gc(); }")
        page.wait(0.3)
        found = page.js("""() => ({heap: performance.memory.usedJSHeapSize, open: watch.opened - watch.closed,
          textures: window.glsplat.stats().textures, shown: window.glsplat.stats().shown})""")
        page.js("fakeXR.run()")
        return found

    early = state(500)
    late = state(early["shown"] + 2000)
    assert late["shown"] - early["shown"] >= 2000
    assert late["open"] <= 4 and early["open"] <= 4, (early, late)  # one pair may wait to be shown
    assert late["textures"] == early["textures"]
    assert late["heap"] <= 1.05 * early["heap"], (early, late)
