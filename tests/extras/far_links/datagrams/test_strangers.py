"""Strangers at the port of datagrams, and clients that do what they may not."""

from __future__ import annotations

import asyncio
import json
import logging
import os
import socket
from typing import Any

import pytest

pytest.importorskip("aioquic", reason="aioquic (glsplat[webtransport]) is not installed")

from glsplat.extras.far_links.datagrams import path as paths
from glsplat.extras.far_links.datagrams.listener import DatagramListener
from glsplat.extras.far_links.datagrams.offers import Offers
from glsplat.extras.far_links.datagrams.packets import HEAD, REQUEST
from glsplat.extras.far_links.feature import Datagrams
from tests.extras.far_links.datagrams.client import open_path, open_quic
from tests.extras.far_links.datagrams.viewer import CONFIG, viewing
from tests.net.wire import HANG, until

pytestmark = [pytest.mark.usefixtures("every_link_is_long"), pytest.mark.check]


async def test_without_an_invitation_nothing_is_answered(serve: Any) -> None:
    """Not a byte, to a handshake and to garbage."""
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


@pytest.mark.parametrize("path", ["datagrams/wrong", "datagrams/" + "x" * 900])
async def test_a_wrong_secret_is_refused(serve: Any, path: str) -> None:
    async with serve(config=CONFIG) as server, viewing(server) as viewer:
        await until(lambda: viewer.offers)
        with pytest.raises(ConnectionError):
            await open_path(server.url, viewer.offers[0] | {"path": path})
        assert server.stats()["datagrams"] == {"open": 0, "refused": 1}
        await viewer.open()  # the right one is still good
        await viewer.more(5, by_datagrams=True)


async def test_half_open_connections_are_few_and_end(serve: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(paths, "_HANDSHAKE_S", 0.5)
    async with serve(config=CONFIG) as server, viewing(server) as viewer:
        await until(lambda: viewer.offers)
        listener = server.feature(Datagrams).listener
        assert listener is not None and listener._server is not None
        inside = listener._server
        opened = [asyncio.create_task(open_quic(server.url)) for _ in range(20)]
        most = []
        await until(lambda: most.append(len(inside.paths())) or most[-1] > 0)
        await until(lambda: most.append(len(inside.paths())) or len(most) > 300)
        for task in opened:
            task.cancel()
        await asyncio.gather(*opened, return_exceptions=True)
        assert 1 <= max(most) <= 24  # each takes two of the packets that are looked at
        await until(lambda: not inside.paths())


@pytest.mark.parametrize("what", ["streams", "datagrams", "requests", "many bytes"])
async def test_who_sends_what_has_no_use_is_put_out_or_ignored(serve: Any, what: str) -> None:
    """A good client beside notices nothing."""
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


async def test_packets_that_take_long_count_as_many(serve: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """A client whose packets take too long is put out; its pictures go on by the WebSocket."""
    async with serve(config=CONFIG) as server, viewing(server) as good, viewing(server) as bad:
        await good.open()
        path = await bad.open()
        await bad.more(3, by_datagrams=True)
        monkeypatch.setattr(paths, "_PACKET_S", 1e-8)
        await asyncio.wait_for(path.ended, HANG)
        monkeypatch.undo()
        await bad.more(5)
        assert not bad.errors and not good.errors


async def test_small_strays_are_not_looked_at() -> None:
    """A packet that opens a connection has 1,200 bytes."""
    listener = DatagramListener(asyncio.get_running_loop().time)
    await listener.open("127.0.0.1", 0)
    try:
        inside, offers = listener._server, listener._offers
        assert inside is not None
        somebody: Any = object()
        offers.make("127.0.0.1", somebody)
        hello = b"\xc0\0\0\0\1\x08" + os.urandom(8) + b"\0\0" + b"\x44\x00" + os.urandom(1180)
        for stray in (os.urandom(60), b"\x40" + os.urandom(1199), hello[:1199], b"\xc0", b"\0"):
            assert not inside.received(stray, ("127.0.0.1", 4))
        fresh: Offers[object] = Offers(lambda: 0.0)
        fresh.make("127.0.0.1", object())
        left, most = (sum(one.knock("127.0.0.1") for _ in range(1000)) for one in (offers, fresh))
        assert left == most > 0
    finally:
        await listener.close()


def test_a_flood_shuts_the_port_and_pictures_go_on(serve: Any, caplog: pytest.LogCaptureFixture) -> None:
    async def main() -> None:
        async with serve(config=CONFIG) as server, viewing(server) as viewer:
            await viewer.open()
            await viewer.more(3, by_datagrams=True)
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
                while server.stats()["datagrams"]["open"]:
                    for _ in range(200):
                        stranger.sendto(os.urandom(60), ("127.0.0.1", server.port))
                    await asyncio.sleep(0.001)
            await viewer.more(10)
            assert not viewer.errors

    with caplog.at_level(logging.WARNING):
        asyncio.run(main())
    assert [record.name for record in caplog.records] == ["glsplat.net"] and "flooded" in caplog.text
