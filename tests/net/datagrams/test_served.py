"""Pictures by datagrams over real sockets: to whom they go, what falls back, and who is let in."""

from __future__ import annotations

import asyncio
import json
import logging
import os
import socket
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from typing import Any

import aiohttp
import pytest

pytest.importorskip("aioquic", reason="aioquic (glsplat[webtransport]) is not installed")

from glsplat.errors import GlsplatError
from glsplat.net.datagrams import path as paths
from glsplat.net.datagrams import udp, way
from glsplat.net.datagrams.congestion import PictureWindow
from glsplat.net.datagrams.packets import HEAD, PICTURE, REQUEST
from glsplat.net.reply import parse_reply
from glsplat.net.server import Server, ServerConfig
from glsplat.net.session import SessionConfig
from tests.net.conftest import FakeBackend
from tests.net.datagrams.client import open_path, open_quic
from tests.net.wire import HANG, native, until
from tests.net.workers.fakes import pool

CONFIG = ServerConfig(port=0, session=SessionConfig(adapt=True), webtransport=True)


@pytest.fixture(autouse=True)
def every_link_is_long(monkeypatch: pytest.MonkeyPatch) -> None:
    """The way there and back takes next to nothing here; and a machine may be as slow as it is."""
    monkeypatch.setattr(way, "LONG", 0.0)
    monkeypatch.setattr(paths, "_SILENT", HANG)
    monkeypatch.setattr(paths, "_HANDSHAKE", HANG)


class Viewer:
    """A client: asks, acknowledges, says when pictures arrive, and opens what it is offered where it is told to."""

    def __init__(self, server: Server, ws: aiohttp.ClientWebSocketResponse, wants: bool) -> None:
        self.server, self.ws, self.wants = server, ws, wants
        self.newest = 0
        self.frames: list[tuple[int, bool]] = []  # ids, and whether by datagrams
        self.offers: list[dict[str, str]] = []
        self.infos: list[dict[str, Any]] = []
        self.asks: dict[str, Any] = {}
        self.errors: list[str] = []
        self.path: Any = None
        self._tasks = [asyncio.create_task(self._read()), asyncio.create_task(self._ask())]

    def take(self, data: bytes, by_datagrams: bool) -> None:
        reply = parse_reply(data)
        self.newest = max(self.newest, reply.frame_id)
        self.frames.append((reply.frame_id, by_datagrams))
        self.infos.append(reply.info)
        if (offer := reply.info.get("datagrams")) is not None:
            self.offers.append(offer)

    async def open(self) -> Any:
        await until(lambda: self.offers)
        self.path = await open_path(self.server.url, self.offers[-1], lambda data: self.take(data, True))
        return self.path

    def by_datagrams(self) -> int:
        return sum(by for _, by in self.frames)

    async def more(self, count: int, by_datagrams: bool = False) -> None:
        """Until so many more have come, the last of them that way."""
        before = len(self.frames)
        await until(lambda: sum(by == by_datagrams for _, by in self.frames[before:]) >= count)

    async def close(self) -> None:
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        if self.path is not None:
            self.path.close()

    async def _read(self) -> None:
        async for message in self.ws:
            if message.type == aiohttp.WSMsgType.BINARY:
                self.take(message.data, False)
            else:
                self.errors.append(str(message.data))

    async def _ask(self) -> None:
        number = 0
        while True:
            number += 1
            told: dict[str, Any] = {"ack": self.newest}
            told |= {"arrival": {"age": 20.0}} if self.newest else {}
            told |= {"datagrams": True} if self.wants else {}
            await self.ws.send_str(native(number, **told, **self.asks))
            await asyncio.sleep(0.01)


@asynccontextmanager
async def viewing(server: Server, wants: bool = True) -> AsyncIterator[Viewer]:
    async with aiohttp.ClientSession() as http, http.ws_connect(server.url) as ws:
        viewer = Viewer(server, ws, wants)
        try:
            yield viewer
        finally:
            await viewer.close()


def ways(server: Server) -> Any:
    return server.stats()["clients"][0]["datagrams"]


class TestPictures:
    def test_they_go_by_datagrams_once_the_way_is_open(self, serve: Any) -> None:
        async def main() -> None:
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

        asyncio.run(main())

    def test_requests_come_by_datagrams_as_well(self, serve: Any) -> None:
        async def main() -> None:
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

        asyncio.run(main())

    def test_lost_packets_cost_nothing_and_lost_pictures_one(self, serve: Any, fake_backend: Any) -> None:
        """Every 20th piece is lost, then half of them: pictures go on, and the session waits for none of them."""

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

    def test_a_video_goes_the_same_way_and_goes_on_after_a_loss(self, serve: Any) -> None:
        """A client that misses a number asks for a key frame, over whichever way."""
        pytest.importorskip("av", reason="PyAV (glsplat[video]) is not installed")

        async def main() -> None:
            async with serve(config=replace(CONFIG, video=True)) as server, viewing(server) as viewer:
                viewer.asks = {"video": {"codecs": ["vp9"]}, "alpha": True}
                path = await viewer.open()
                await until(lambda: sum("video" in info for info in viewer.infos) > 20)
                path.keep = lambda datagram: datagram[0] != PICTURE
                await until(lambda: ways(server)["sent"] - viewer.by_datagrams() > 3 or not ways(server)["open"])
                path.keep = lambda datagram: True
                await viewer.more(3, by_datagrams=True)
                viewer.asks["video"]["key"] = True
                before = len(viewer.infos)
                await until(lambda: any(info.get("video", {}).get("key") for info in viewer.infos[before:]))

        asyncio.run(main())

    def test_pictures_of_workers_as_well(self, serve: Any) -> None:
        async def main() -> None:
            async with serve(pool(2), CONFIG) as server, viewing(server) as viewer:
                await viewer.open()
                await viewer.more(10, by_datagrams=True)

        asyncio.run(main())

    @pytest.mark.parametrize(("config", "wants"), [(CONFIG, False), (ServerConfig(port=0, webtransport=True), True)])
    def test_nobody_else_is_offered_any(self, serve: Any, config: ServerConfig, wants: bool) -> None:
        """Who does not ask, and everybody where pictures are not fitted to links."""

        async def main() -> None:
            async with serve(config=config) as server, viewing(server, wants) as viewer:
                await viewer.more(30)
                assert not viewer.offers and viewer.by_datagrams() == 0

        asyncio.run(main())

    def test_a_short_link_keeps_the_websocket(self, serve: Any, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(way, "LONG", 10.0)

        async def main() -> None:
            async with serve(config=CONFIG) as server, viewing(server) as viewer:
                await viewer.more(40)
                assert not viewer.offers and server.stats()["datagrams"] == {"open": 0, "refused": 0}

        asyncio.run(main())


class TestFallingBack:
    @pytest.mark.parametrize("how", ["closed", "silent"])
    def test_pictures_go_on_over_the_websocket(self, serve: Any, monkeypatch: pytest.MonkeyPatch, how: str) -> None:
        async def main() -> None:
            async with serve(config=CONFIG) as server, viewing(server) as viewer:
                path = await viewer.open()
                await viewer.more(5, by_datagrams=True)
                monkeypatch.setattr(paths, "_SILENT", 0.3)
                if how == "closed":
                    path.close()
                else:
                    path._transport.sendto = lambda *_: None  # as where a firewall shuts
                await viewer.more(20)
                await until(lambda: ways(server)["open"] == 0)
                assert [by for _, by in viewer.frames[-5:]] == [False] * 5

        asyncio.run(main())

    def test_a_way_that_lets_no_picture_through_is_left(
        self, serve: Any, fake_backend: Any, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """What is unsent when the next picture comes is left out, and after some time the WebSocket has them again."""
        allow = PictureWindow.allow

        def tight(self: PictureWindow, rate: float, nbytes: int) -> None:
            allow(self, rate, nbytes)
            self.congestion_window = 1300 if narrow else self.congestion_window

        narrow: list[bool] = []
        monkeypatch.setattr(PictureWindow, "allow", tight)

        async def main() -> None:
            async with serve(fake_backend(noise=True), CONFIG) as server, viewing(server) as viewer:
                path = await viewer.open()
                await viewer.more(3, by_datagrams=True)
                path.keep = lambda datagram: datagram[0] != PICTURE
                narrow.append(True)
                monkeypatch.setattr(paths, "_SILENT", 0.5)
                await until(lambda: ways(server)["open"] == 0)
                await viewer.more(10)
                assert [by for _, by in viewer.frames[-10:]] == [False] * 10

        asyncio.run(main())

    def test_a_browser_that_throws_away_what_quic_says_it_has_is_left(
        self, serve: Any, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """Its window is full of pictures that it never acknowledges; by the WebSocket it has the next at once."""

        async def main() -> None:
            async with serve(config=CONFIG) as server, viewing(server) as viewer:
                path = await viewer.open()
                await viewer.more(3, by_datagrams=True)
                path.keep = lambda datagram: datagram[0] != PICTURE
                monkeypatch.setattr(paths, "_UNANSWERED", 0.3)
                await until(lambda: ways(server)["open"] == 0)
                await viewer.more(10)
                assert server.stats()["clients"][0]["unacknowledged"] < 8

        asyncio.run(main())

    def test_it_is_offered_anew_after_a_while(self, serve: Any, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(way, "_AGAIN", 0.2)

        async def main() -> None:
            async with serve(config=CONFIG) as server, viewing(server) as viewer:
                await until(lambda: len(viewer.offers) >= 2)
                with pytest.raises((ConnectionError, TimeoutError)):
                    await open_path(server.url, viewer.offers[0])
                await viewer.open()
                await viewer.more(5, by_datagrams=True)

        asyncio.run(main())

    def test_who_leaves_takes_it_along_and_the_server_stops_in_order(self, serve: Any) -> None:
        async def main() -> None:
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

        asyncio.run(main())

    def test_two_servers_in_a_process(self, serve: Any) -> None:
        async def main() -> None:
            async with serve(config=CONFIG) as one, serve(config=CONFIG) as other:
                async with viewing(one) as first, viewing(other) as second:
                    await first.open()
                    await second.open()
                    await asyncio.gather(first.more(5, by_datagrams=True), second.more(5, by_datagrams=True))

        asyncio.run(main())

    def test_without_what_it_needs_a_line_says_so(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setitem(sys.modules, "glsplat.net.datagrams.listener", None)
        with pytest.raises(GlsplatError, match=r"pip install 'glsplat\[webtransport\]'"):
            Server(FakeBackend(), CONFIG)

    def test_a_port_in_use_is_told_in_a_line(self) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
            taken.bind(("127.0.0.1", 0))
            port = taken.getsockname()[1]
            with pytest.raises(GlsplatError, match=rf"UDP port {port} .*leave --webtransport out"):
                udp.bind_udp("127.0.0.1", port)


class TestStrangers:
    def test_without_an_invitation_nothing_is_answered(self, serve: Any) -> None:
        """Not a byte, to a handshake and to garbage, while a client has its pictures that way."""

        async def main() -> None:
            async with serve(config=CONFIG) as server, viewing(server) as viewer:
                await viewer.open()
                await viewer.more(3, by_datagrams=True)
                loop = asyncio.get_running_loop()
                with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
                    stranger.setblocking(False)
                    stranger.bind(("127.0.0.9", 0))
                    hello = b"\xc0\0\0\0\1\x08" + os.urandom(8) + b"\0\0" + b"\x44\x00" + os.urandom(1180)
                    for data in (hello, b"\xc0\xff\xff\xff\xff" + hello[5:], os.urandom(40), b"", b"\0"):
                        stranger.sendto(data, ("127.0.0.1", server.port))
                    await viewer.more(5, by_datagrams=True)
                    with pytest.raises(TimeoutError):
                        await asyncio.wait_for(loop.sock_recv(stranger, 2048), 0.3)

        asyncio.run(main())

    @pytest.mark.parametrize("path", ["datagrams/wrong", "", "datagrams/" + "x" * 900])
    def test_a_wrong_secret_is_refused(self, serve: Any, path: str) -> None:
        async def main() -> None:
            async with serve(config=CONFIG) as server, viewing(server) as viewer:
                await until(lambda: viewer.offers)
                with pytest.raises(ConnectionError):
                    await open_path(server.url, viewer.offers[0] | {"path": path})
                assert server.stats()["datagrams"] == {"open": 0, "refused": 1}
                await viewer.open()  # the right one is still good
                await viewer.more(5, by_datagrams=True)

        asyncio.run(main())

    def test_a_secret_is_not_used_twice(self, serve: Any) -> None:
        async def main() -> None:
            async with serve(config=CONFIG) as server, viewing(server) as viewer, viewing(server) as other:
                await viewer.open()
                await until(lambda: other.offers)  # so that somebody is expected
                with pytest.raises(ConnectionError):
                    await open_path(server.url, viewer.offers[-1])
                await viewer.more(5, by_datagrams=True)

        asyncio.run(main())

    def test_half_open_connections_are_few_and_end(self, serve: Any, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(paths, "_HANDSHAKE", 0.5)

        async def main() -> None:
            async with serve(config=CONFIG) as server, viewing(server) as viewer:
                await until(lambda: viewer.offers)
                listener = server._datagrams
                assert listener is not None and listener._server is not None
                inside = listener._server
                opened = [asyncio.create_task(open_quic(server.url)) for _ in range(6)]
                most = []
                await until(lambda: most.append(len(inside.paths())) or most[-1] > 0)
                await until(lambda: most.append(len(inside.paths())) or len(most) > 300)
                for task in opened:
                    task.cancel()
                await asyncio.gather(*opened, return_exceptions=True)
                assert 1 <= max(most) <= 2
                await until(lambda: not inside.paths())

        asyncio.run(main())

    @pytest.mark.parametrize("what", ["streams", "datagrams", "requests", "many bytes"])
    def test_who_sends_what_has_no_use_is_put_out_or_ignored(self, serve: Any, what: str) -> None:
        """With a good client beside, which notices nothing."""

        async def main() -> None:
            async with serve(config=CONFIG) as server, viewing(server) as good, viewing(server) as bad:
                await good.open()
                await good.more(3, by_datagrams=True)
                path = await bad.open()
                if what == "streams":
                    for _ in range(40):
                        stream = path.http.create_webtransport_stream(path.session.result(), is_unidirectional=True)
                        path._quic.send_stream_data(stream, b"x" * 1000)
                    path.transmit()
                    await asyncio.wait_for(path.ended, HANG)
                elif what == "many bytes":
                    stream = path._quic.get_next_available_stream_id()
                    path._quic.send_stream_data(stream, b"\x01\x80\x10\0\0" + bytes(60_000))  # headers without end
                    path.transmit()
                    await asyncio.wait_for(path.ended, HANG)
                elif what == "datagrams":
                    for number in range(6000):
                        if path.ended.done():
                            break
                        path.send(HEAD.pack(REQUEST, 0, number % 50, number // 50, 60_000) + b"z" * 1124)
                        if number % 50 == 0:
                            await asyncio.sleep(0.001)
                else:
                    for number in range(500):
                        path.ask(json.dumps({"v": 1, "frame_id": number, "ack": 0}))
                        await asyncio.sleep(0)
                await good.more(20, by_datagrams=True)
                assert server.stats()["datagrams"]["open"] >= 1 and not good.errors

        asyncio.run(main())

    def test_a_flood_shuts_the_port_and_pictures_go_on(self, serve: Any, caplog: pytest.LogCaptureFixture) -> None:
        async def main() -> None:
            async with serve(config=CONFIG) as server, viewing(server) as viewer:
                await viewer.open()
                await viewer.more(3, by_datagrams=True)
                with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
                    for number in range(4000):
                        stranger.sendto(os.urandom(60), ("127.0.0.1", server.port))
                        if number % 40 == 0:
                            await asyncio.sleep(0.001)
                await until(lambda: server.stats()["datagrams"]["open"] == 0)
                await viewer.more(10)
                assert not viewer.errors

        with caplog.at_level(logging.WARNING):
            asyncio.run(main())
        assert [record.name for record in caplog.records] == ["glsplat.net"] and "flooded" in caplog.text

    def test_what_is_mangled_on_the_way_ends_at_most_itself(self, serve: Any) -> None:
        async def main() -> None:
            async with serve(config=CONFIG) as server, viewing(server) as viewer:
                path = await viewer.open()
                await viewer.more(3, by_datagrams=True)
                sendto = path._transport.sendto

                def mangled(data: bytes, addr: Any = None) -> None:
                    flipped = bytearray(data)
                    flipped[len(data) // 2] ^= 0xFF
                    sendto(bytes(flipped), addr)
                    sendto(data[: len(data) // 2], addr)
                    sendto(data, addr)

                path._transport.sendto = mangled
                await viewer.more(10, by_datagrams=True)

        asyncio.run(main())
