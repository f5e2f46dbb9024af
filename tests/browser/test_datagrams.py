"""WebTransport in Chromium: the page's pictures come by datagrams, what is lost is made up for, and it falls back."""

from __future__ import annotations

from typing import Any

import pytest

pytest.importorskip("aioquic", reason="aioquic (glsplat[webtransport]) is not installed")

from glsplat.extras.far_links.datagrams import way
from glsplat.extras.far_links.datagrams.path import DatagramPath
from glsplat.extras.far_links.datagrams.udp import UdpSocket
from glsplat.net.server import ServerConfig
from glsplat.net.session import SessionConfig
from tests.browser.conftest import OpenPage
from tests.browser.markers import offered
from tests.browser.stored import StoredPairs
from tests.browser.vr import visit

CONFIG = ServerConfig(port=0, session=SessionConfig(adapt=True), webtransport=True)
REFUSED = [r"Failed to establish a connection to https://127\.0\.0\.1"]


@pytest.fixture(autouse=True)
def every_link_is_long(monkeypatch: pytest.MonkeyPatch) -> None:
    """The way there and back takes next to nothing here; one that ended is soon offered again."""
    monkeypatch.setattr(way, "LONG", 0.0)
    monkeypatch.setattr(way, "_AGAIN", 1.0)
    monkeypatch.setattr(way, "_TRIES", 100)


def opened(open_page: OpenPage, serve: Any, **options: Any) -> tuple[Any, Any]:
    """(server, page); not by the name localhost, which has an address of IPv6, too."""
    served = serve(StoredPairs(), CONFIG, offered=offered)
    address = f"http://127.0.0.1:{served.port}/vr"
    page = visit(open_page, served, {"size": 512, "driver": "motion:walk"}, address=address, **options)
    page.until("window.glsplat?.stats().shown > 2")
    return served, page


def ways(served: Any) -> dict[str, Any]:
    clients = served.stats()["clients"]
    return clients[0]["datagrams"] if clients else {"open": 0, "sent": 0, "lost": 0}


def test_pictures_come_by_datagrams_and_lost_packets_are_made_up_for(
    open_page: OpenPage, serve: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    sendto, sent = UdpSocket.sendto, [0, 0]

    def lossy(self: UdpSocket, data: bytes, addr: Any) -> None:
        """Every 50th large packet is lost."""
        sent[0] += len(data) > 1000
        if len(data) > 1000 and sent[0] % 50 == 0:
            sent[1] += 1
            return
        sendto(self, data, addr)

    heard: list[bytes] = []
    paths: list[DatagramPath] = []
    hear, open_way = way.SecondWay.heard, way.SecondWay.opened
    monkeypatch.setattr(way.SecondWay, "opened", lambda self, path: (paths.append(path), open_way(self, path))[1])
    monkeypatch.setattr(way.SecondWay, "heard", lambda self, message: (heard.append(message), hear(self, message))[1])
    monkeypatch.setattr(UdpSocket, "sendto", lossy)
    served, page = opened(open_page, serve)
    page.meanwhile(lambda: ways(served)["sent"] >= 40)
    before = ways(served)

    def enough() -> bool:
        now = ways(served)
        return now["open"] == 1 and now["sent"] >= before["sent"] + 30 and now["loss"] > 0.004 and sent[1] >= 3

    page.meanwhile(enough)  # a busy machine may fall back to the WebSocket in between
    lost, by_datagrams = (ways(served)[key] - before[key] for key in ("lost", "sent"))
    assert lost <= by_datagrams / 2  # with no redundancy nearly every picture would lose one of its packets
    assert len(heard) >= 20 and all(message.startswith(b'{"v":1,') for message in heard)

    async def end() -> None:
        monkeypatch.setattr(way.SecondWay, "offer", lambda self: None)  # else a quick page has the next one at once
        for path in paths:
            path.end()

    served.call(end())
    page.meanwhile(lambda: ways(served)["open"] == 0)
    shown = page.stats()["shown"]
    page.until(f"window.glsplat.stats().shown > {shown + 10}")  # by its WebSocket
    assert page.stats()["reconnects"] == 0


def test_where_udp_does_not_get_through_the_page_notices_nothing(
    open_page: OpenPage, serve: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(UdpSocket, "listen", lambda self: None)
    served, page = opened(open_page, serve, allow=REFUSED)
    shown = page.stats()["shown"]
    page.until(f"window.glsplat.stats().shown > {shown + 10}")
    assert ways(served) == {"open": 0, "sent": 0, "lost": 0, "loss": 0.0} and page.stats()["reconnects"] == 0
