"""A page that draws all the time, on a server that fits pictures to links: it is no slow link."""

from __future__ import annotations

import time
from typing import Any

from glsplat.net.backend import AvatarInfo
from glsplat.net.server import ServerConfig
from glsplat.net.session import SessionConfig
from tests.browser.conftest import OpenPage
from tests.browser.stored import StoredPairs
from tests.browser.vr import visit

OFFERED = (AvatarInfo(name="stored", parts=frozenset({"head"})),)
BUSY = """() => {
  const draw = () => {
    const end = performance.now() + 250;
    while (performance.now() < end);
    setTimeout(draw, 20);
  };
  draw();
}"""


def test_full_pictures_stay_full(open_page: OpenPage, serve: Any) -> None:
    config = ServerConfig(port=0, session=SessionConfig(adapt=True))
    served = serve(StoredPairs(delay=0.03), config, offered=OFFERED)
    page = visit(open_page, served)
    page.until("window.glsplat.stats().shown > 3")
    page.js(BUSY)
    seen = []
    for _ in range(8):
        time.sleep(1.0)
        (client,) = served.server.stats()["clients"]
        seen.append((client["link"]["scale"], client["link"]["quality"]))
    assert client["link"]["age"] > 100  # what the page says
    assert seen[-4:] == [(1.0, 80)] * 4
