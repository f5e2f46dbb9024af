"""``Client`` as a stranger uses it: again, twice, at once, cancelled, and with every field of a camera."""

from __future__ import annotations

import asyncio
import gc
import random
import re
import threading
from collections.abc import Callable
from pathlib import Path

import aiohttp
import pytest

import glsplat
from glsplat.errors import ProtocolError
from glsplat.net.backend import RenderJob
from glsplat.net.client import Client
from glsplat.net.server import Server, ServerConfig
from glsplat.net.session import SessionConfig
from tests.net.conftest import FakeBackend, eyes, serving
from tests.net.workers.fakes import GUARD, until

PAIR = eyes()
EYE = {"viewmat": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 2, 0, 0, 0, 1], "K": [50, 60, 31, 33]}


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
    assert await until(lambda: server.stats()["totals"]["accepted"] == count and server.render_loop.drawing_for)


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


def test_a_client_can_be_used_in_one_event_loop_after_another():
    client = Client("ws://127.0.0.1:1/ws")

    async def main():
        async with serving() as server:
            client.url = server.url
            async with client:
                return (await client.render(PAIR)).frame_id

    assert [asyncio.run(main()) for _ in range(3)] == [1, 1, 1]


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


def test_the_same_where_the_newer_one_fails():
    backend, free = gated(lambda request: RuntimeError("no") if request.frame_id == 3 else None)

    async def main():
        async with serving(backend) as server, Client(server.url, timeout=GUARD) as client:
            await client.send(PAIR)
            await accepted(server, 1)
            waits = asyncio.create_task(client.render(PAIR))
            await accepted(server, 2)
            await client.send(PAIR)
            await accepted(server, 3)
            free.set()
            with pytest.raises(ProtocolError, match="request 2 was dropped"):
                await waits
            assert (await client.receive()).reply.frame_id == 1
            with pytest.raises(ProtocolError, match="could not be drawn"):
                await client.receive()

    asyncio.run(main())


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


@pytest.mark.parametrize("seed", range(3))
def test_any_mixture_of_calls_at_once_ends_in_pictures_or_errors(seed):
    """Two that render, one that sends, two that do anything, some of it cancelled: no render is left without a word."""
    rng = random.Random(seed)
    backend = FakeBackend(
        delay=rng.choice([0, 0.002, 0.01]), fail=lambda request: RuntimeError("no") if rng.random() < 0.1 else None
    )
    unlimited = ServerConfig(port=0, session=SessionConfig(rate=1e5, burst=10**5))
    codes: list[str] = []

    async def act(client: Client, kind: str) -> None:
        for _ in range(30):
            name = kind or rng.choice(["render", "send", "receive"])
            call = client.receive() if name == "receive" else getattr(client, name)(PAIR)
            try:
                if rng.random() < 0.3:
                    await asyncio.wait_for(call, rng.uniform(0, 0.02))
                else:  # a picture that nobody has asked for may be waited for in vain
                    await asyncio.wait_for(call, 0.5 if name == "receive" else None)
            except ProtocolError as error:
                codes.append(f"{name} {error.code}")
            except TimeoutError:
                codes.append("cancelled")
            await asyncio.sleep(rng.uniform(0, 0.005))

    async def main():
        async with serving(backend, unlimited) as server, Client(server.url, window=seed + 1, timeout=GUARD) as client:
            await asyncio.gather(*(act(client, kind) for kind in ("render", "render", "send", "", "")))
            backend.fail = lambda request: None
            reply = await client.render(PAIR)
            return reply.frame_id == client.newest

    assert asyncio.run(main()) and "cancelled" in codes
    assert set(codes) <= {"cancelled", "render dropped", "render render", "receive render"}


# ---------------------------------------------------------------------------------------------------- goes away


def test_a_server_that_goes_away_wakes_all_who_wait():
    backend, free = gated()

    async def main():
        server = Server(backend, ServerConfig(port=0, drain_timeout=0.05))
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


def test_the_example_of_the_page_runs():
    text = (Path(__file__).resolve().parents[2] / "docs" / "python.md").read_text(encoding="utf-8")
    code = re.search(r"## A client\n.*?```python\n(.*?)```", text, re.S).group(1)
    names: dict = {"glsplat": glsplat}  # the page is one program
    exec(compile(code, "python.md", "exec"), names)

    async def main():
        async with serving() as server:
            return await names["main"](server.url)

    assert asyncio.run(main()) == [1, 2, 3, 4]
