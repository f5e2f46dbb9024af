"""The simulated link: it delays, throttles, holds back and passes on the ends of connections."""

from __future__ import annotations

import argparse
import asyncio
import socket
from random import Random
from types import SimpleNamespace

import numpy as np
import pytest

from apps.replay import link as link_module
from apps.replay.link import Link, link, over


class Hours(asyncio.SelectorEventLoop):
    """Time passes at once where everybody waits for it: what a link takes is what it says, on any machine."""

    def __init__(self):
        super().__init__()
        self.passed, self._servers = 0.0, {}
        select = self._selector.select

        def jump(timeout=None):
            ready = select(timeout and 0)
            if not ready and timeout:
                self.passed += timeout
            return ready

        self._selector.select = jump

    def time(self):
        return self.passed

    async def create_server(self, factory, host, port):
        """Its connections are pairs of sockets, which hand over at once: loopback may be late."""
        port = len(self._servers) + 1
        self._servers[port] = factory
        return SimpleNamespace(sockets=[SimpleNamespace(getsockname=lambda: (host, port))], close=lambda: None)

    async def create_connection(self, factory, host, port):
        near, far = socket.socketpair()
        await self.connect_accepted_socket(self._servers[port], far)
        return await super().create_connection(factory, sock=near)


def now():
    return asyncio.get_running_loop().time()


@pytest.fixture
def run(monkeypatch):
    monkeypatch.setattr(link_module, "time", SimpleNamespace(perf_counter=now))

    def run(coroutine):
        with asyncio.Runner(loop_factory=Hours) as runner:
            return runner.run(coroutine)

    return run


async def far(answer, simulated, use):
    """``use(reader, writer)`` at the near end of a link to a server that runs ``answer`` for each connection."""
    tasks = []

    async def connected(reader, writer):
        tasks.append(asyncio.current_task())
        try:
            await answer(reader, writer)
        except ConnectionError:
            pass
        finally:
            writer.close()

    server = await asyncio.start_server(connected, "127.0.0.1", 0)
    try:
        async with over(simulated, f"ws://127.0.0.1:{server.sockets[0].getsockname()[1]}/ws") as url:
            port = int(url.rsplit(":", 1)[1].split("/")[0])
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            try:
                return await use(reader, writer)
            finally:
                writer.close()
                await asyncio.gather(*tasks, return_exceptions=True)
    finally:
        server.close()


async def echo(reader, writer):
    while data := await reader.read(65536):
        writer.write(data)
        await writer.drain()


def test_the_round_trip_takes_as_long_as_the_link_says(run):
    async def use(reader, writer):
        times = []
        for _ in range(8):
            start = now()
            writer.write(b"ping")
            assert await reader.readexactly(4) == b"ping"
            times.append((now() - start) * 1e3)
        return times

    assert run(far(echo, Link(40, 100), use)) == pytest.approx([40] * 8, abs=0.1)
    assert run(far(echo, Link(0, 1000), use)) == pytest.approx([0] * 8, abs=0.1)


def test_a_megabyte_takes_its_time_and_arrives_whole(run):
    data = np.random.default_rng(0).bytes(500_000)

    async def send(reader, writer):
        writer.write(data)
        await writer.drain()

    async def use(reader, writer):
        start = now()
        assert await reader.read(-1) == data  # to the end: that the server closed comes through
        return now() - start

    took = run(far(send, Link(20, 20), use))
    assert took == pytest.approx(0.21, abs=0.001)  # 4 Mbit at 20 Mbit/s, and 10 ms one way


def test_a_fast_sender_is_held_back(run):
    """The link takes what it can deliver and a queue; more stays with the sender, as with TCP."""
    state = {"written": 0}

    async def send(reader, writer):
        writer.transport.set_write_buffer_limits(high=16384)
        for _ in range(1000):
            writer.write(b"\0" * 16384)
            await writer.drain()
            state["written"] += 16384

    async def use(reader, writer):
        await asyncio.sleep(0.5)
        return state["written"]

    # 8 Mbit/s pass 0.5 MB in that time; the queue is 128 kB; the sockets' own buffers hold a few hundred kB
    assert run(far(send, Link(10, 8), use)) < 4e6


def test_links_are_checked():
    assert str(link("20,100")) == "20 ms, 100 Mbit/s" and str(link("20,100,1.5")) == "20 ms, 100 Mbit/s, 1.5 % lost"
    for text in ("", "20", "20,", "a,b", "-1,10", "10,0", "nan,10", "10,inf", "1,2,-1", "1,2,51", "1,2,3,4", "1,2,"):
        with pytest.raises(argparse.ArgumentTypeError, match=r"a link is RTT,MBIT\[,LOSS\], for example 20,100"):
            link(text)


def test_a_lost_packet_comes_a_round_trip_later():
    """One in ten of 5,000, and of those one in ten twice; without loss none."""
    chance = Random(4)
    late = np.array([Link(40, 10, 10).held_back(1448, chance) for _ in range(5000)])
    assert set(np.round(late / 0.04).tolist()) <= {0, 1, 2, 3, 4, 5}
    assert abs(np.mean(late >= 0.04) - 0.1) < 0.02 and abs(np.mean(late >= 0.08) - 0.01) < 0.006
    assert np.mean([Link(40, 10, 10).held_back(4096, chance) > 0 for _ in range(2000)]) > 0.2  # three packets
    assert not any(Link(40, 10).held_back(10**6, chance) for _ in range(20))
