"""The flat page paints what is new and nothing twice: its machine may be the one that draws the avatar."""

from __future__ import annotations

from typing import Any

from tests.browser.conftest import OpenPage
from tests.browser.flat_page import flat_page
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
    page = open_page(served.page, init=settings(**chosen) + COUNTED, bypass_csp=True)
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
    for change in (
        lambda: page.page.select_option("#place", "studio"),
        lambda: page.page.press("#canvas", "ArrowLeft"),
    ):
        shown, before = page.stats()["shown"], page.js("window.painted")
        change()
        page.until(f"window.painted > {before} || window.glsplat.stats().shown > {shown} + 1")
        assert page.js("window.painted") > before
    assert page.canvas().std() > 5  # what is left is the picture, not an empty canvas


def test_the_canvas_is_whole_after_it_was_lost_and_made_anew(open_page: OpenPage, serve: Any) -> None:
    page = opened(open_page, serve)
    was = page.canvas()
    page.js("window.lose = document.querySelector('#canvas').getContext('webgl2').getExtension('WEBGL_lose_context')")
    page.js("window.lose.loseContext()")
    page.wait(0.2)
    page.js("window.lose.restoreContext()")
    page.until("window.glsplat.stats().textures >= 2")
    page.wait(1.5)
    again = page.canvas()
    assert was.std() > 10 and abs(again.astype(int) - was).mean() < 8


BACKDROP = """
import { Painter } from '/vr/show/painter.js';
import { Orbit } from '/vr/show/orbit.js';
const [width, height] = [120, 96];
const fresh = () => {
  const canvas = Object.assign(document.createElement('canvas'), { width, height });
  const gl = canvas.getContext('webgl2', { antialias: false, alpha: false });
  return { gl, painter: new Painter(gl) };
};
let copied = 0;
const blit = WebGL2RenderingContext.prototype.blitFramebuffer;
WebGL2RenderingContext.prototype.blitFramebuffer = function (...at) {
  copied++;
  return blit.apply(this, at);
};
const orbit = new Orbit();
const kept = fresh();
// of each step: pixels of the canvas that keeps which one that never painted before has not; shades; views copied
window.painted = (stereo, steps) => steps.map(([turn, look, blobs]) => {
  orbit.turn(turn, 0);
  copied = 0;
  const [one, other] = [kept, fresh()].map(({ gl, painter }) => {
    painter.begin(null, false, null);
    const how = { room: true, look, blobs, keeps: painter === kept.painter };
    orbit.views(width, height, { stereo }).forEach((view, i) => painter.view(view, i, how));
    const bytes = new Uint8Array(4 * width * height);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
    if (gl !== kept.gl) gl.getExtension('WEBGL_lose_context').loseContext(); // a page has sixteen
    return bytes;
  });
  return [one.filter((value, i) => value !== other[i]).length, new Set(one).size, copied];
});
"""


def test_a_room_that_is_copied_is_the_room_that_would_be_painted(chromium: Any) -> None:
    shadow = [[0.0, 0.0, 0.3, 0.5]]
    still: list[Any] = [[0, "day", []], [0, "day", shadow], [0, "day", shadow], [0, "day", []]]
    moved: list[Any] = [[0.3, "day", []], [0.0, "night", []], [0.0, "night", []], [0.0, "night", shadow]]
    with flat_page(chromium, BACKDROP) as page:
        page.wait_for_function("window.painted !== undefined")
        for stereo, views in ((False, 1), (True, 2)):
            found = page.evaluate("([stereo, steps]) => painted(stereo, steps)", [stereo, still + moved])
            assert [wrong for wrong, _, _ in found] == [0] * 8, found
            assert all(shades > 30 for _, shades, _ in found), found  # there is something to see
            # painted, painted and kept, then copied until the eye moves or the place is another
            assert [copied for _, _, copied in found] == [views * n for n in (0, 0, 1, 1, 0, 0, 0, 1)]
