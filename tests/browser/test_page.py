"""What the page may reach and who may use it: the content policy, TLS, other origins; keyboard and screen readers."""

from __future__ import annotations

import http.server
import threading
from collections.abc import Iterator
from typing import Any, ClassVar

import pytest

from glsplat.data import default_avatar
from glsplat.net.backend import AvatarInfo
from glsplat.net.backends.server import make_server
from tests.browser.conftest import OpenPage
from tests.browser.markers import as_tracked
from tests.browser.stored import StoredPairs
from tests.browser.vr import visit

OFFERED = (AvatarInfo(name="stored", solver=as_tracked, height=1.75, parts=frozenset({"head"})),)
MOST_BYTES = 400_000  # before the avatar's first picture


@pytest.fixture
def stored(serve: Any) -> Any:
    return serve(StoredPairs(), offered=OFFERED)


class _Elsewhere(http.server.BaseHTTPRequestHandler):
    asked: ClassVar[list[str]] = []

    def do_GET(self) -> None:
        self.asked.append(self.path)
        self.send_response(200)
        self.send_header("Access-Control-Allow-Origin", "*")
        self.send_header("Content-Type", "text/html")
        self.end_headers()
        self.wfile.write(b"<!doctype html><title>elsewhere</title>")

    def log_message(self, *args: Any) -> None: ...


@pytest.fixture
def elsewhere() -> Iterator[str]:
    """Another origin on this machine, which notes what it is asked for."""
    _Elsewhere.asked.clear()
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), _Elsewhere)
    thread = threading.Thread(target=server.serve_forever, args=(0.05,))
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    thread.join()
    server.server_close()


REACH = {
    "fetch": "(u) => fetch(u + '/fetch').then(() => 'reached', () => 'blocked')",
    "socket": """(u) => new Promise((done) => {
      try {
        const socket = new WebSocket(u.replace('http', 'ws') + '/socket');
        socket.onerror = () => done('blocked');
        socket.onopen = () => done('reached');
      } catch { done('blocked'); }
    })""",
    "image": """(u) => new Promise((done) => {
      const image = new Image();
      image.onload = image.onerror = () => done('blocked');
      image.src = u + '/image';
    })""",
    "script": """(u) => new Promise((done) => {
      const script = document.createElement('script');
      script.onload = () => done('reached');
      script.onerror = () => done('blocked');
      script.src = u + '/script';
      document.body.append(script);
    })""",
    "form": """(u) => new Promise((done) => {
      const form = document.createElement('form');
      form.action = u + '/form';
      document.body.append(form);
      form.submit();
      setTimeout(() => done('blocked'), 300);
    })""",
    "beacon": "(u) => { navigator.sendBeacon(u + '/beacon'); return 'blocked'; }",
    "inline": """(u) => {
      const script = document.createElement('script');
      script.textContent = 'window.inlined = true';
      document.body.append(script);
      return window.inlined ? 'reached' : 'blocked';
    }""",
    "eval": "(u) => { const s = document.createElement('a'); s.setAttribute('onclick', 'window.evil = 1'); s.click();"
    " return window.evil ? 'reached' : 'blocked'; }",
}


def test_the_page_reaches_nothing_but_its_server(open_page: OpenPage, stored: Any, elsewhere: str) -> None:
    page = visit(open_page, stored, allow=["Content Security Policy", "Content-Security-Policy", "violates", "blocked"])
    page.until("window.glsplat.stats().shown > 0")
    for name, attempt in REACH.items():
        assert page.js(attempt, elsewhere) == "blocked", name

    def violated() -> set[str]:
        return {line.split()[0] for line in page.js("watch.violations")}

    page.meanwhile(lambda: {"connect-src", "img-src", "form-action"} <= violated() and len(violated()) >= 4)
    assert _Elsewhere.asked == []
    assert all(address.split("/")[2] == f"localhost:{stored.port}" for address in page.requests
               if address.startswith(("http", "ws")) and elsewhere not in address and
               elsewhere.replace("http", "ws") not in address)  # fmt: skip


def test_a_page_from_elsewhere_cannot_connect(open_page: OpenPage, stored: Any, elsewhere: str) -> None:
    page = open_page(f"{elsewhere}/", xr=None, allow=["WebSocket", "CORS", "Failed to load", "ERR_"])
    ends = page.js(
        """(address) => new Promise((done) => {
          const socket = new WebSocket(address, ['glsplat.v1']);
          socket.onopen = () => done('open');
          socket.onerror = () => done('refused');
        })""",
        f"ws://localhost:{stored.port}/ws",
    )
    assert ends == "refused"
    assert page.js("(u) => fetch(u).then((r) => r.status, () => 'refused')", f"{stored.origin}/session") == "refused"
    assert stored.stats()["clients"] == []


def test_the_keyboard_alone_is_enough(open_page: OpenPage, stored: Any) -> None:
    page = visit(open_page, stored)
    page.until("window.glsplat.stats().shown > 0")
    page.until("!document.querySelector('#enter-vr').disabled")
    reached = []
    for _ in range(60):
        page.page.keyboard.press("Tab")
        identity = page.js("document.activeElement.id || document.activeElement.tagName")
        if identity in reached:
            break
        reached.append(identity)
        if identity != "BODY":
            outline = page.js("(({outlineStyle, outlineWidth, boxShadow}) => [outlineStyle, outlineWidth, boxShadow])"
                              "(getComputedStyle(document.activeElement))")  # fmt: skip
            assert outline[0] != "none" or outline[2] != "none", f"{identity} has the focus, and nobody sees it"
    wanted = {"canvas", "enter-vr", "enter-ar", "avatar", "view", "size", "quality", "driver", "stereo", "figures"}
    assert wanted <= set(reached), wanted - set(reached)
    page.page.focus("#enter-vr")
    page.page.keyboard.press("Enter")
    page.until("window.glsplat.stats().session === 'vr'")


def test_nothing_but_the_page_itself_comes_before_the_first_picture(open_page: OpenPage, serve: Any) -> None:
    served = serve(make=lambda config: make_server(default_avatar(), config))
    page = open_page(None, xr=None)
    page.page.add_init_script("""
      const look = () => window.glsplat?.stats().shown > 0 ? (window.seen = performance.getEntriesByType('resource')
        .map(({ name }) => name)) : requestAnimationFrame(look);
      requestAnimationFrame(look);""")
    page.page.goto(served.page)
    seen = {name.split("?")[0].removeprefix(served.origin) for name in page.until("window.seen")}
    loaded = page.js("""() => ['resource', 'navigation'].flatMap((kind) => performance.getEntriesByType(kind))
      .map(({name, encodedBodySize}) => [name, encodedBodySize])""")
    sizes = {url: size for url, size in loaded if "thumbnails" not in url}
    assert len(sizes) > 20 and sum(sizes.values()) < MOST_BYTES, sorted(sizes.items(), key=lambda one: -one[1])[:8]
    html = page.page.request.get(f"{served.page}/").text()
    preloaded = {f"/vr/{part.split(chr(34))[0]}" for part in html.split('modulepreload" href="')[1:]}
    # the decoder's worker starts by itself; all other modules are known from the page's first bytes
    assert {name for name in seen if name.endswith(".js")} == preloaded and len(preloaded) > 30
    assert not [name for name in seen if "emulate" in name or "study" in name]
    assert not [name for name in seen if "avatars/" in name or "thumbnails" in name or name.endswith("programs.json")]
