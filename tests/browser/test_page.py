"""What the page may reach and loads, the client of docs/protocol.md, TLS with a token, and an emulated headset."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from glsplat.data import default_avatar
from glsplat.extras.operations.certificate import kept_certificate
from glsplat.net.guard.access import Access
from glsplat.net.guard.state_dir import kept_token, state_folder
from glsplat.net.pages import page_folders, read_folder
from glsplat.net.served_scene import gl_server
from glsplat.net.server import ServerConfig
from tests.browser.conftest import OpenPage
from tests.browser.markers import offered
from tests.browser.served import hosted
from tests.browser.stored import StoredPairs
from tests.browser.vr import visit

ELSEWHERE = "https://elsewhere.example"
MOST_BYTES = 400_000  # before the avatar's first picture
PATIENCE_MS = 10_000  # a page that waits longer for its first picture loads the parts of extras without it


REACH = {
    "fetch": "(u) => fetch(u + '/fetch').then(() => 'reached', () => 'blocked')",
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


def test_the_page_reaches_nothing_but_its_server(open_page: OpenPage, serve: Any) -> None:
    stored = serve(StoredPairs())
    page = visit(open_page, stored, allow=["Content Security Policy", "Content-Security-Policy", "violates", "blocked"])
    asked: list[str] = []
    page.page.route(f"{ELSEWHERE}/**", lambda route: (asked.append(route.request.url), route.fulfill(body="1")))
    page.until("window.glsplat.stats().shown > 0")
    for name, attempt in REACH.items():
        assert page.js(attempt, ELSEWHERE) == "blocked", name

    def violated() -> set[str]:
        return {line.split()[0] for line in page.js("watch.violations")}

    page.meanwhile(lambda: {"connect-src", "img-src"} <= violated() and len(violated()) >= 3)
    assert asked == []
    assert all(address.split("/")[2] == f"localhost:{stored.port}" for address in page.requests
               if address.startswith(("http", "ws")) and ELSEWHERE not in address)  # fmt: skip


def test_nothing_but_the_page_itself_comes_before_the_first_picture(open_page: OpenPage, serve: Any) -> None:
    served = serve(make=lambda config: gl_server(default_avatar(), config))
    page = open_page(None, xr=False)
    page.page.add_init_script("""
      let before = [];  // at the frame before that of the first picture; some parts come without it when it is late
      const look = () => {
        if (window.glsplat?.stats().shown > 0) return (window.seen = before);
        before = performance.getEntriesByType('resource').map(({ name, startTime }) => [name, startTime]);
        return requestAnimationFrame(look);
      };
      requestAnimationFrame(look);""")
    page.page.goto(served.page)
    seen = {name.split("?")[0].removeprefix(served.origin): at for name, at in page.until("window.seen")}
    loaded = page.js("""() => ['resource', 'navigation'].flatMap((kind) => performance.getEntriesByType(kind))
      .map(({name, encodedBodySize}) => [name, encodedBodySize])""")
    sizes = {url: size for url, size in loaded if "thumbnails" not in url}
    assert len(sizes) > 20 and sum(sizes.values()) < MOST_BYTES, sorted(sizes.items(), key=lambda one: -one[1])[:8]
    html = page.page.request.get(f"{served.page}/").text()
    preloaded = {f"/vr/{part.split(chr(34))[0]}" for part in html.split('modulepreload" href="')[1:]}
    # the decoder's worker starts by itself; all other modules are known from the page's first bytes
    own = {*preloaded, "/vr/stream/decoder.js"}
    assert own <= seen.keys()
    assert not [name for name, at in seen.items() if name.endswith(".js") and at < PATIENCE_MS and name not in own]
    assert 30 < len(preloaded) < 50
    unwanted = ("emulate", "study", "avatars/", "thumbnails", "programs.json")
    assert not [name for name in seen if any(word in name for word in unwanted)]


def test_the_core_s_page_works_without_the_files_of_extras(
    open_page: OpenPage, serve: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    core = dict(read_folder(page_folders()[""]))
    monkeypatch.setattr("glsplat.net.pages.page_files", lambda: core)
    page = visit(open_page, serve(StoredPairs()))
    page.until("window.glsplat.stats().shown > 5")
    time.sleep(1)  # what extras bring would be asked for by now; a file that is not there fails the test
    assert page.js("document.querySelector('#voice, #photo')") is None
    assert page.stats()["drawn"]["by"] == "server"


CLIENT = Path(__file__).resolve().parents[2] / "docs" / "examples" / "client.html"


def test_the_client_in_a_page_shows_both_eyes(open_page: OpenPage, serve: Any, tmp_path: Path) -> None:
    with hosted(tmp_path) as address:
        served = serve(StoredPairs(), ServerConfig(port=0, access=Access(origins=(address[:-1],))))
        program = CLIENT.read_text("utf-8").replace("ws://localhost:8000/ws", f"ws://localhost:{served.port}/ws")
        (tmp_path / "index.html").write_text(program)
        page = open_page(address, xr=False, allow=["favicon"])
        page.until("frame > 3 && ack > 2 && left.naturalWidth === 512 && right.naturalWidth === 512")
        assert page.js("left.src !== right.src")


def test_the_printed_address_is_enough(state, serve, open_page):
    folder = state_folder()
    kept, token = kept_certificate(folder, ()), kept_token(folder)
    config = ServerConfig(port=0, tls=(kept.path, kept.path), access=Access(host="0.0.0.0", tls=True, token=token))
    served = serve(StoredPairs(), config)
    opened = open_page(f"{served.page}#token={token}")
    opened.until("window.glsplat?.stats().shown > 2", timeout=60)
    assert opened.js("isSecureContext") and token not in opened.page.url
    assert any(url.startswith(f"wss://localhost:{served.port}/ws") for url in opened.requests)
    assert not any(token in url for url in opened.requests)


def test_vr_is_entered_without_a_headset(open_page: OpenPage, serve: Any) -> None:
    served = serve(StoredPairs(), offered=offered)
    plain = visit(open_page, served, xr=False)
    plain.until("window.glsplat?.stats().shown > 0")
    assert not [address for address in plain.requests if "emulate" in address]  # nobody else loads it
    page = visit(open_page, served, {"drawer": False}, xr=False, address=f"{served.page}?emulate")
    page.until("window.glsplat?.stats().shown > 0")
    page.until("!document.querySelector('#enter-vr').disabled")
    page.page.click("#enter-vr")
    page.until("window.glsplat.stats().session === 'vr'")
    shown = page.stats()["shown"]
    page.until(f"window.glsplat.stats().shown > {shown + 2}")
    for _ in range(4):  # a canvas that is cleared for each frame shows one each time
        seen = cv2.imdecode(np.frombuffer(page.page.screenshot(), np.uint8), cv2.IMREAD_COLOR)
        assert seen.max() > 100
    assert all(address.startswith((served.origin, "ws://localhost", "blob:", "data:")) for address in page.requests)
    licence = page.js("fetch('/vr/emulate/LICENSE-iwer.txt').then((answer) => answer.text())")
    assert "MIT License" in licence and "Meta Platforms" in licence
