"""Pictures by datagrams over real sockets: to whom they go, and what falls back."""

from __future__ import annotations

import asyncio
import socket
import sys
from typing import Any

import pytest

pytest.importorskip("aioquic", reason="aioquic (glsplat[webtransport]) is not installed")

from glsplat.errors import GlsplatError
from glsplat.extras.far_links.datagrams import path as paths
from glsplat.extras.far_links.datagrams import udp, way
from glsplat.extras.far_links.datagrams.congestion import PictureWindow
from glsplat.extras.far_links.datagrams.packets import PICTURE
from glsplat.net.served_scene import server_of
from glsplat.net.server import ServerConfig
from tests.extras.far_links.datagrams.client import open_path
from tests.extras.far_links.datagrams.viewer import CONFIG, viewing, ways
from tests.extras.workers.fakes import pool
from tests.net.conftest import FakeBackend
from tests.net.wire import HANG, native, until

pytestmark = [pytest.mark.usefixtures("every_link_is_long"), pytest.mark.check]


async def test_pictures_go_by_datagrams_once_the_way_is_open(serve: Any) -> None:
    async with serve(config=CONFIG) as server, viewing(server) as viewer:
        await viewer.open()
        await viewer.more(20, by_datagrams=True)
        first = next(i for i, (_, by) in enumerate(viewer.frames) if by)
        ids = [number for number, by in viewer.frames if by]
        assert ids == sorted(set(ids)) and all(by for _, by in viewer.frames[first + 3 :])
        stats = ways(server)
        assert stats["open"] == 1 and stats["sent"] >= 20 and stats["lost"] == 0
        assert server.stats()["clients"][0]["link"]["rate"] > 0 and server.stats()["datagrams"]["open"] == 1
        assert not viewer.errors


async def test_requests_come_by_datagrams_as_well(serve: Any) -> None:
    async with serve(config=CONFIG) as server, viewing(server) as viewer:
        path = await viewer.open()
        await viewer.more(3, by_datagrams=True)
        viewer._tasks[1].cancel()
        for number in range(100_000, 100_005):
            told = {"ack": viewer.newest, "arrival": {"age": 5}, "datagrams": True}
            path.ask(native(number, **told, t=1.0, faces=[[0.1, 1, 1]] * 16))
            await until(lambda number=number: viewer.newest >= number)
        path.ask("{")
        await until(lambda: viewer.errors)
        assert "bad_json" in viewer.errors[-1]


def test_lost_packets_cost_nothing_and_lost_pictures_one(serve: Any, fake_backend: Any) -> None:
    """Every 20th piece is lost, then half of them."""

    async def main() -> None:
        async with serve(fake_backend(noise=True), CONFIG) as server, viewing(server) as viewer:
            path = await viewer.open()
            count = 0

            def keep(datagram: bytes) -> bool:
                nonlocal count
                count += datagram[0] == PICTURE
                return datagram[0] != PICTURE or count % 20 != 0

            path.keep = keep
            await viewer.more(30, by_datagrams=True)
            held = [number for number, by in viewer.frames if by]
            path.keep = lambda datagram: datagram[0] != PICTURE or hash(datagram[4:8]) % 2 == 0
            await viewer.more(10, by_datagrams=True)
            assert len(held) == len(set(held))

    asyncio.run(main())


async def test_pictures_of_workers_as_well(serve: Any) -> None:
    async with serve(pool(2), CONFIG) as server, viewing(server) as viewer:
        await viewer.open()
        await viewer.more(10, by_datagrams=True)


@pytest.mark.parametrize(
    ("config", "wants", "long"),
    [(CONFIG, False, 0.0), (ServerConfig(port=0, webtransport=True), True, 0.0), (CONFIG, True, 10.0)],
    ids=["does not ask", "pictures are not fitted", "a short link"],
)
async def test_nobody_else_is_offered_any(
    serve: Any, monkeypatch: pytest.MonkeyPatch, config: ServerConfig, wants: bool, long: float
) -> None:
    monkeypatch.setattr(way, "LONG", long)
    async with serve(config=config) as server, viewing(server, wants) as viewer:
        await viewer.more(30)
        assert not viewer.offers and server.stats()["datagrams"] == {"open": 0, "refused": 0}


@pytest.mark.parametrize("how", ["closed", "silent"])
async def test_pictures_fall_back_to_the_websocket(serve: Any, monkeypatch: pytest.MonkeyPatch, how: str) -> None:
    async with serve(config=CONFIG) as server, viewing(server) as viewer:
        path = await viewer.open()
        await viewer.more(5, by_datagrams=True)
        monkeypatch.setattr(paths, "_SILENT_S", 0.3)
        if how == "closed":
            path.close()
        else:
            path._transport.sendto = lambda *_: None  # as where a firewall shuts
        await viewer.more(20)
        await until(lambda: ways(server)["open"] == 0)
        assert [by for _, by in viewer.frames[-5:]] == [False] * 5


async def test_a_way_that_lets_no_picture_through_is_left(
    serve: Any, fake_backend: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is unsent when the next picture comes is left out."""
    allow = PictureWindow.allow

    def tight(self: PictureWindow, rate: float, nbytes: int) -> None:
        allow(self, rate, nbytes)
        self.congestion_window = 1300 if narrow else self.congestion_window

    narrow: list[bool] = []
    monkeypatch.setattr(PictureWindow, "allow", tight)
    async with serve(fake_backend(noise=True), CONFIG) as server, viewing(server) as viewer:
        path = await viewer.open()
        await viewer.more(3, by_datagrams=True)
        path.keep = lambda datagram: datagram[0] != PICTURE
        narrow.append(True)
        monkeypatch.setattr(paths, "_SILENT_S", 0.5)
        await until(lambda: ways(server)["open"] == 0)
        await viewer.more(10)
        assert [by for _, by in viewer.frames[-10:]] == [False] * 10


async def test_a_browser_that_throws_away_what_quic_says_it_has_is_left(
    serve: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its window is full of pictures that it never acknowledges."""
    async with serve(config=CONFIG) as server, viewing(server) as viewer:
        path = await viewer.open()
        await viewer.more(3, by_datagrams=True)
        path.keep = lambda datagram: datagram[0] != PICTURE
        monkeypatch.setattr(paths, "_UNANSWERED_S", 0.3)
        await until(lambda: ways(server)["open"] == 0)
        await viewer.more(10)
        assert server.stats()["clients"][0]["unacknowledged"] < 8


async def test_an_answer_that_is_lost_before_a_pause_ends_nothing(serve: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody waits for a picture that only QUIC acknowledges."""
    monkeypatch.setattr(paths, "_UNANSWERED_S", 0.2)
    async with serve(config=CONFIG) as server, viewing(server) as viewer:
        path = await viewer.open()
        await viewer.more(3, by_datagrams=True)
        viewer.pause()
        await asyncio.sleep(0.2)
        path.keep = lambda datagram: datagram[0] != PICTURE
        await viewer.once()
        await until(lambda: server.stats()["clients"][0]["unacknowledged"] == 0)
        await asyncio.sleep(0.4)
        assert ways(server)["open"] == 1
        path.keep = lambda datagram: True
        viewer.go_on()
        await viewer.more(5, by_datagrams=True)


async def test_datagrams_are_offered_anew_after_a_while(serve: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(way, "_AGAIN", 0.2)
    async with serve(config=CONFIG) as server, viewing(server) as viewer:
        await until(lambda: len(viewer.offers) >= 2)
        with pytest.raises((ConnectionError, TimeoutError)):
            await open_path(server.url, viewer.offers[0])
        await viewer.open()
        await viewer.more(5, by_datagrams=True)


async def test_who_leaves_takes_it_along_and_the_server_stops_in_order(serve: Any) -> None:
    async with serve(config=CONFIG) as server:
        async with viewing(server) as viewer:
            path = await viewer.open()
            await viewer.more(3, by_datagrams=True)
            viewer.path = None
            await viewer.ws.close()
            await asyncio.wait_for(path.ended, HANG)
        await until(lambda: server.stats()["datagrams"]["open"] == 0)
        async with viewing(server) as viewer:
            path = await viewer.open()
            await viewer.more(3, by_datagrams=True)
            await server.stop()
            await asyncio.wait_for(path.ended, HANG)


def test_without_what_it_needs_a_line_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "aioquic", None)
    with pytest.raises(GlsplatError, match=r"pip install 'glsplat\[webtransport\]'"):
        server_of(FakeBackend(), CONFIG)


def test_a_port_in_use_is_told_in_a_line() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        with pytest.raises(GlsplatError, match=rf"UDP port {port} .*leave webtransport out"):
            udp.bind_udp("127.0.0.1", port)
