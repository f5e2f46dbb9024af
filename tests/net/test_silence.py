"""Clients that say nothing, or nothing that counts, are put out in time: by a clock that leaps."""

from __future__ import annotations

import asyncio

import pytest

from glsplat.net.client import Client
from glsplat.net.server import ServerConfig
from tests.net.wire import UNLIMITED, all_of, frame, native, raw, until

pytestmark = pytest.mark.check


async def test_slow_handshakes_and_silence_are_ended(serve, ahead):
    ahead.lead()
    async with serve(config=ServerConfig(port=0, heartbeat=1e6)) as server:
        silent, silent_writer = await asyncio.open_connection("127.0.0.1", server.port)
        slow, slow_writer = await asyncio.open_connection("127.0.0.1", server.port)
        slow_writer.write(b"GET /ws HTTP/1.1\r\nHost: x\r\nX-A: ")  # never ends its headers
        mute, mute_writer = await raw(server)
        idle, idle_writer = await raw(server)
        idle_writer.write(frame(0x1, native(1).encode()))
        await idle.readuntil(b"VR")
        await until(lambda: server.stats()["waiting"] == 2)
        ahead.leap(11.5)  # aiohttp rounds up to whole seconds
        assert await all_of(silent) == b"" and b" 101 " not in await all_of(slow)
        assert b"no valid request in time" in await all_of(mute)
        await until(lambda: [client["accepted"] for client in server.stats()["clients"]] == [1])
        ahead.leap(50.0)
        assert b'"message":"idle"' in await all_of(idle)
        for writer in (silent_writer, slow_writer, mute_writer, idle_writer):
            writer.close()


async def test_half_open_connections_are_found_by_pings(serve, cameras, ahead):
    """Peers that vanished without a word: they neither read, nor answer, nor close."""
    ahead.lead()
    async with serve() as server:
        gone = [await raw(server) for _ in range(5)]
        for _, writer in gone:
            writer.write(frame(0x1, native(1).encode()))
        async with Client(server.url) as alive:  # answers pings, and stays
            await alive.render(cameras)
            await until(lambda: all(client["sent"] for client in server.stats()["clients"]))
            for seconds in (16.0, 8.5):  # a ping after 15 s, given up 7.5 s later; aiohttp rounds up
                ahead.leap(seconds)
                for _ in range(3):  # meanwhile its pong arrives
                    await alive.render(cameras)
            await until(lambda: len(server.stats()["clients"]) == 1)
            assert (await alive.render(cameras)).frame_id == 8
        for _, writer in gone:
            writer.transport.abort()


@pytest.mark.parametrize(
    ("asks", "opcode", "seconds", "why"),
    [(False, 0x9, 10, b"no valid request in time"), (True, 0xA, 60, b'"message":"idle"')],
    ids=["pings before a request", "pongs after one"],
)
async def test_control_frames_are_no_messages(serve, ahead, asks, opcode, seconds, why):
    """One every second keeps no connection."""
    ahead.lead()
    async with serve(config=ServerConfig(port=0, heartbeat=1e6)) as server:
        reader, writer = await raw(server)
        start, sent = ahead(), 0
        if asks:
            writer.write(frame(0x1, native(1).encode()))
            await reader.readuntil(b"VR")
        while server.stats()["clients"] and sent < 120:
            writer.write(frame(opcode, b"here"))
            ahead.leap(1.0)
            sent += 1
            for _ in range(10):  # the server's last words are read before the next leap cuts the connection
                await asyncio.sleep(0)
            await asyncio.sleep(0.002)
        assert why in await all_of(reader)
        writer.close()
    assert sent <= seconds + 15 and ahead() - start >= seconds


async def test_pings_whose_pongs_are_not_read_end_the_connection(serve, ahead):
    """The server gets stuck on writing them, and its time limit holds all the same."""
    ahead.lead()
    async with serve(config=ServerConfig(port=0, limits=UNLIMITED, heartbeat=1e6)) as server:
        _, writer = await raw(server)
        (talk,) = server._conversations.values()
        while not talk._ws._writer.transport.get_write_buffer_size():
            writer.write(frame(0x9, b"x" * 125) * 500)
            await asyncio.sleep(0)
        ahead.leap(10.0)
        await until(lambda: not server.stats()["clients"])
        writer.transport.abort()
