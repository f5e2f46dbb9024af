"""``Client`` as a stranger uses it: again, twice, at once, cancelled, and with every field of a camera."""

from __future__ import annotations

import asyncio
import gc
import threading
from collections.abc import Callable

import aiohttp
import pytest

import glsplat
from glsplat.errors import ProtocolError
from glsplat.net.backend import RenderJob
from glsplat.net.client import Client
from glsplat.net.served_scene import server_of
from glsplat.net.server import Server, ServerConfig
from tests.extras.workers.fakes import GUARD, until
from tests.net.conftest import FakeBackend, eyes, serving

PAIR = eyes()


async def settled(server: Server) -> int:
    """Clients once those that left have been noticed."""
    await until(lambda: not server.stats()["clients"])
    return len(server.stats()["clients"])


def gated(fail: Callable[[RenderJob], Exception | None] = lambda request: None):
    """A renderer that draws nothing until the event is set: what is under way meanwhile is known."""
    free = threading.Event()

    def wait(request: RenderJob) -> Exception | None:
        assert free.wait(GUARD)
        return fail(request)

    return FakeBackend(fail=wait), free


async def accepted(server: Server, count: int) -> None:
    """Until the renderer has the first of so many requests, and the newest waits in the mailbox."""
    assert await until(lambda: server.stats()["totals"]["accepted"] == count and server.drawer.drawing_for)


# ------------------------------------------------------------------------------------------------------- again


def test_a_client_can_be_connected_again_after_close():
    async def main():
        async with serving() as server:
            client = Client(server.url)
            seen = []
            for _ in range(3):
                await client.connect()
                seen.append([(await client.render(PAIR)).frame_id for _ in range(3)])
                await client.close()
                await client.close()
            async with client:
                seen.append((await client.render(PAIR)).info["dropped"])
            return seen, server.stats()["totals"]["malformed"]

    assert asyncio.run(main()) == ([[1, 2, 3]] * 3 + [0], 0)


def test_connecting_twice_makes_one_connection():
    async def main():
        async with serving() as server:
            async with Client(server.url) as client:
                await client.connect()
                await asyncio.gather(client.connect(), client.connect())
                assert (await client.render(PAIR)).frame_id == 1
                connected = len(server.stats()["clients"])
            racing = Client(server.url)
            await asyncio.gather(*(racing.connect() for _ in range(3)))
            assert (await racing.render(PAIR)).frame_id == 1
            await racing.close()
            return connected, await settled(server)

    assert asyncio.run(main()) == (1, 0)
    gc.collect()
    assert not [s for s in gc.get_objects() if isinstance(s, aiohttp.ClientSession) and not s.closed]


def test_without_a_connection_every_call_says_so():
    async def main():
        client = Client("ws://127.0.0.1:9/ws", timeout=GUARD)
        await client.close()
        for call in (client.render(PAIR), client.send(PAIR), client.receive(), client.acknowledge()):
            with pytest.raises(ProtocolError, match=r"not connected; await connect\(\) first"):
                await call
        for _ in range(2):
            with pytest.raises(ProtocolError, match="no server at"):
                await client.connect()
        assert (client.newest, client.waiting) == (0, False)

    asyncio.run(main())


# ------------------------------------------------------------------------------------------------------ at once


def test_pictures_asked_for_at_once_all_come():
    async def main():
        async with serving(FakeBackend(delay=0.02)) as server, Client(server.url, window=2) as client:
            replies = await asyncio.gather(*(client.render(PAIR, quality=95) for _ in range(6)))
            return replies, server.stats()["totals"]

    replies, totals = asyncio.run(main())
    assert [reply.frame_id for reply in replies] == [1, 2, 3, 4, 5, 6] and totals["dropped"] == 0
    for reply in replies:  # each has its own picture: the fake renderer draws the number
        assert abs(int(reply.images()[0][32, 32, 0]) - reply.frame_id - 50) <= 3


def test_a_picture_that_a_newer_request_replaced_is_an_error_at_once():
    backend, free = gated()

    async def main():
        async with serving(backend) as server, Client(server.url, timeout=GUARD) as client:
            await client.send(PAIR)
            await accepted(server, 1)
            waits = asyncio.create_task(client.render(PAIR))
            await accepted(server, 2)
            newest = await client.send(PAIR)  # takes its place
            await accepted(server, 3)
            free.set()
            with pytest.raises(ProtocolError, match="request 2 was dropped for a newer one") as caught:
                await waits
            pictures = [(await client.receive()).reply.frame_id for _ in range(2)]
            return caught.value, newest, pictures, (await client.render(PAIR)).frame_id

    error, newest, pictures, after = asyncio.run(main())
    assert (error.code, error.frame_id, newest, pictures, after) == ("dropped", 2, 3, [1, 3], 4)  # by no time-out


def test_pictures_nobody_has_taken_do_not_hold_back_the_one_that_is_waited_for():
    async def main():
        async with serving() as server, Client(server.url, window=2, timeout=GUARD) as client:
            for turn in range(5):
                for sent in (1, 2, 2, 2):  # the window is full then
                    await client.send(PAIR)
                    assert await until(lambda n=3 * turn + sent: server.stats()["totals"]["sent"] == n)
                await client.render(PAIR)
            kept = 0
            while True:
                kept += 1
                if (await client.receive()).reply.frame_id >= 24 or kept == 8:
                    return client.newest, kept

    newest, kept = asyncio.run(main())
    assert newest == 25 and kept <= 8


def test_a_cancelled_call_leaves_a_client_that_works():
    backend, free = gated()

    async def main():
        async with serving(backend) as server, Client(server.url, window=1, timeout=GUARD) as client:
            for count in (1, 2, 3):
                call = asyncio.create_task(client.render(PAIR))
                await accepted(server, count)
                call.cancel()
                with pytest.raises(asyncio.CancelledError):
                    await call
            free.set()
            reply = await client.render(PAIR)
            number = await client.send(PAIR)
            arrived = await client.receive()  # not one of those that were given up
            return reply.frame_id, number, arrived.reply.frame_id

    assert asyncio.run(main()) == (4, 5, 5)


def test_a_cancelled_receive_loses_no_picture():
    backend, free = gated()

    async def main():
        async with serving(backend) as server, Client(server.url, timeout=GUARD) as client:
            await client.send(PAIR)
            with pytest.raises(TimeoutError):
                await asyncio.wait_for(client.receive(), 0.02)
            free.set()
            return (await client.receive()).reply.frame_id

    assert asyncio.run(main()) == 1


# ---------------------------------------------------------------------------------------------------- goes away


def test_a_server_that_goes_away_wakes_all_who_wait():
    backend, free = gated()

    async def main():
        server = server_of(backend, ServerConfig(port=0, drain_timeout=0.05))
        await server.start()
        client = Client(server.url, timeout=GUARD)
        await client.connect()
        calls = [client.render(PAIR), client.render(PAIR), client.receive(), client.receive()]
        tasks = [asyncio.create_task(call) for call in calls]
        await accepted(server, 1)
        stopping = asyncio.create_task(server.stop())
        outcomes = await asyncio.gather(*tasks, return_exceptions=True)
        free.set()
        await stopping
        with pytest.raises(ProtocolError, match="the server closed the connection"):
            await client.send(PAIR)
        async with serving(config=ServerConfig(port=server.port)):  # it comes back
            await client.connect()
            again = (await client.render(PAIR)).frame_id
            await client.close()
        return outcomes, again

    outcomes, again = asyncio.run(main())
    assert [getattr(error, "code", None) for error in outcomes] == ["closed"] * 4  # by no time-out
    assert len({id(error) for error in outcomes}) == 4 and again == 1


def test_a_silent_server_is_not_one_that_is_not_there() -> None:
    async def said() -> tuple[tuple[str, str], tuple[str, str]]:
        async def silent(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            await reader.read()
            writer.close()

        server = await asyncio.start_server(silent, "127.0.0.1", 0)
        port = server.sockets[0].getsockname()[1]
        found = []
        for url in (f"ws://127.0.0.1:{port}/ws", "ws://127.0.0.1:1/ws"):
            with pytest.raises(glsplat.errors.ProtocolError) as caught:
                await Client(url, timeout=0.3).connect()
            found.append((str(caught.value), caught.value.code))
        server.close()
        return found[0], found[1]

    (there, code), (gone, other) = asyncio.run(said())
    assert "no answer within 0.3 s" in there and "start one" not in there and code == "timeout"
    assert "start one with `glsplat serve`" in gone and other == "unreachable"


def test_close_wakes_all_who_wait():
    backend, free = gated()

    async def main():
        async with serving(backend) as server, Client(server.url, timeout=GUARD) as client:
            tasks = [asyncio.create_task(call) for call in (client.render(PAIR), client.render(PAIR), client.receive())]
            await accepted(server, 1)
            await client.close()
            outcomes = await asyncio.gather(*tasks, return_exceptions=True)
            free.set()
            return outcomes

    assert [str(error).endswith("the client was closed") for error in asyncio.run(main())] == [True] * 3
