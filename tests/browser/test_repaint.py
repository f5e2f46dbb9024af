"""The flat page paints what is new and nothing twice: its machine may be the one that draws the avatar."""

from __future__ import annotations

from typing import Any

import numpy as np

from tests.browser.conftest import OpenPage
from tests.browser.markers import Markers, offered
from tests.browser.opened import Opened
from tests.browser.vr import settings

# each painting of the canvas begins by clearing it; half a second lies between two pictures
COUNTED = """
  window.painted = 0;
  const clear = WebGL2RenderingContext.prototype.clear;
  WebGL2RenderingContext.prototype.clear = function (what) {
    if (what & this.COLOR_BUFFER_BIT) window.painted++;
    return clear.call(this, what);
  };"""


def opened(open_page: OpenPage, serve: Any, **values: Any) -> Opened:
    served = serve(Markers(lambda job: {"red": [0, 1.2, 0]}, delay=0.6), offered=offered)
    chosen = {"size": 512, "driver": "rest", "place": "day", "drawer": True} | values
    page = open_page(served.page, init=settings(**chosen) + COUNTED, bypass_csp=True, xr=False)
    page.until("window.glsplat?.stats().shown >= 2")
    return page


def painted(page: Opened, seconds: float) -> tuple[int, int, int]:
    """Paintings, pictures and frames of the display within so many seconds."""
    look = "[window.painted, window.glsplat.stats().shown]"
    before = page.js(look)
    frames = page.js(
        """(ms) => new Promise((done) => {
          const end = performance.now() + ms;
          let frames = 0;
          const tick = () => (++frames && performance.now() < end ? requestAnimationFrame(tick) : done(frames));
          tick();
        })""",
        1000 * seconds,
    )
    after = page.js(look)
    return after[0] - before[0], after[1] - before[1], frames


def test_a_picture_is_painted_once_and_what_changes_at_once(open_page: OpenPage, serve: Any) -> None:
    page = opened(open_page, serve)
    paintings, pictures, frames = painted(page, 2.0)
    assert pictures >= 1 and paintings <= pictures + 1 < frames / 3
    assert page.stats()["frameRate"] < 15  # what would show nothing new is left out, on the fastest display
    for change in (
        lambda: page.page.select_option("#place", "studio"),
        lambda: page.page.press("#canvas", "ArrowLeft"),
    ):
        shown, before = page.stats()["shown"], page.js("window.painted")
        change()
        page.until(f"window.painted > {before} || window.glsplat.stats().shown > {shown} + 1")
        assert page.js("window.painted") > before
    was = page.canvas()
    assert was.std() > 5  # what is left is the picture, not an empty canvas
    page.js("window.lose = document.querySelector('#canvas').getContext('webgl2').getExtension('WEBGL_lose_context')")
    page.js("window.lose.loseContext()")
    page.wait(0.2)
    page.js("window.lose.restoreContext()")
    page.until("window.glsplat.stats().textures >= 2")
    page.wait(1.0)
    assert abs(page.canvas().astype(int) - was).mean() < 8  # whole again


def test_an_emulated_headset_at_rest_paints_pictures_alone(open_page: OpenPage, serve: Any) -> None:
    page = opened(open_page, serve, drawer=False)
    page.page.click("#try-vr")
    page.until("window.glsplat.stats().session === 'vr'")
    shown = page.stats()["shown"]
    page.until(f"window.glsplat.stats().shown > {shown + 1}")
    look = "[window.painted, window.glsplat.stats().shown, window.glsplat.stats().sentId, performance.now()]"
    before = page.js(look)
    page.wait(3.0)
    paintings, pictures, requests, ms = np.subtract(page.js(look), before)
    assert pictures >= 1 and requests > pictures  # tracking goes on
    assert paintings <= 2 * (pictures + ms / 250 + 2)  # IWER clears, too
