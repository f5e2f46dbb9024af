"""A page that draws all the time: its browser, and not it, tells the server when pictures arrive."""

from __future__ import annotations

from statistics import median
from time import perf_counter
from typing import Any

import pytest

from glsplat.net.backend import AvatarInfo
from glsplat.net.pace.link_control import LinkControl
from glsplat.net.server import ServerConfig
from glsplat.net.session import SessionConfig
from tests.browser.conftest import OpenPage
from tests.browser.stored import StoredPairs
from tests.browser.vr import visit

OFFERED = (AvatarInfo(name="stored", parts=frozenset({"head"})),)
BUSY = """() => {
  const draw = () => {
    const end = performance.now() + 400;
    while (performance.now() < end);
    setTimeout(draw, 20);
  };
  draw();
}"""


def test_pongs_do_not_wait_for_the_page(open_page: OpenPage, serve: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    written: dict[int, float] = {}
    ponged: dict[int, float] = {}
    told: dict[int, float] = {}
    write, pong, acknowledge = LinkControl.written, LinkControl.ponged, LinkControl.acknowledged

    def noted_pong(self: LinkControl, payload: bytes, now: float) -> None:
        number = self._behind.get(payload)
        if number in written:
            ponged[number] = perf_counter() - written[number]
        pong(self, payload, now)

    def noted_write(self: LinkControl, number: int, nbytes: int, now: float) -> None:
        written[number] = perf_counter()
        write(self, number, nbytes, now)

    def noted_word(self: LinkControl, number: int, age: float, held: float, now: float) -> None:
        if number in written:
            told[number] = perf_counter() - written[number] - held
        acknowledge(self, number, age, held, now)

    for name, noted in (("written", noted_write), ("ponged", noted_pong), ("acknowledged", noted_word)):
        monkeypatch.setattr(LinkControl, name, noted)
    config = ServerConfig(port=0, session=SessionConfig(adapt=True))
    served = serve(StoredPairs(), config, offered=OFFERED)
    page = visit(open_page, served, {"size": 1024})
    page.until("window.glsplat.stats().shown > 3")
    page.js(BUSY)
    written.clear()
    page.meanwhile(lambda: len(ponged.keys() & told.keys() & written.keys()) >= 12)
    both = ponged.keys() & told.keys() & written.keys()
    early, late = (median(times[number] for number in both) for times in (ponged, told))
    assert late > 0.1 and early < 0.5 * late
