"""Simulated network link: a TCP relay on loopback that delays and throttles data, for ``glsplat replay``.

Each direction has its own rate and half of the round trip. Bytes wait in a bounded queue, as in a router, which blocks
a faster sender, as TCP does. A lost packet delays all later ones by a round trip per loss. TCP's congestion control and
jitter are not simulated.
"""

from __future__ import annotations

import argparse
import asyncio
import time
from collections import deque
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from random import Random
from urllib.parse import urlsplit, urlunsplit

from glsplat.errors import GlsplatError

from ..usage import UsageError

_PACKET_BYTES = 1448
_CHUNK_BYTES = 4096  # per read: 0.7 ms at 50 Mbit/s
_QUEUE_BYTES = 128 * 1024  # queued before the sender is blocked


@dataclass(frozen=True, slots=True)
class Link:
    """Properties of a link."""

    round_trip: float  # ms
    rate: float  # Mbit/s, each way
    loss: float = 0.0  # percent of packets

    def __str__(self) -> str:
        return f"{self.round_trip:g} ms, {self.rate:g} Mbit/s" + (f", {self.loss:g} % lost" if self.loss else "")

    def loss_delay(self, nbytes: int, chance: Random) -> float:
        """Return the delay in seconds of ``nbytes`` by packets that were lost, once or repeatedly."""
        times, lost = 0, 1 - (1 - self.loss / 100) ** -(-nbytes // _PACKET_BYTES)
        while chance.random() < lost:
            times, lost = times + 1, self.loss / 100
        return times * self.round_trip / 1e3


def link(text: str) -> Link:
    """Parse RTT,MBIT[,LOSS], for example 20,100 or 20,100,1 (argparse type)."""
    try:
        round_trip, rate, loss = (float(part) for part in (text if text.count(",") > 1 else f"{text},0").split(","))
        if not (0 <= round_trip <= 10_000 and 0.01 <= rate <= 100_000 and 0 <= loss <= 50):
            raise ValueError
    except ValueError:
        message = f"a link is RTT,MBIT[,LOSS], for example 20,100 (ms there and back, Mbit/s, % lost), not {text!r}"
        raise argparse.ArgumentTypeError(message) from None
    return Link(round_trip, rate, loss)


@asynccontextmanager
async def over(simulated: Link | None, url: str) -> AsyncIterator[str]:
    """Yield a local address that leads to ``url`` over the link; ``url`` itself without a link.

    Raises UsageError for wss://, whose certificate has another address, and GlsplatError if there is no server.
    """
    if simulated is None:
        yield url
        return
    parts = urlsplit(url)
    if parts.scheme != "ws" or parts.hostname is None:
        raise UsageError(f"--link goes with ws://HOST:PORT/ws, not {url}")
    relay = _Relay(simulated, parts.hostname, parts.port or 80)
    try:
        _, writer = await asyncio.open_connection(relay.host, relay.port)
    except OSError:
        raise GlsplatError(f"no server at {url}: start one with `glsplat serve`") from None
    writer.close()
    server = await asyncio.start_server(relay.connected, "127.0.0.1", 0, limit=_CHUNK_BYTES)
    port = server.sockets[0].getsockname()[1]
    try:
        yield urlunsplit(parts._replace(netloc=f"127.0.0.1:{port}"))
    finally:
        server.close()
        await relay.close()


class _Relay:
    """Relays the connections of one link."""

    def __init__(self, simulated: Link, host: str, port: int) -> None:
        self.host, self.port = host, port
        self._link = simulated
        self._tasks: set[asyncio.Task[None]] = set()

    def connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Relay a client: open its own connection to the server, and a pipe each way."""
        task = asyncio.create_task(self._relay(reader, writer))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _relay(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            there = await asyncio.open_connection(self.host, self.port, limit=_CHUNK_BYTES)
        except OSError:
            writer.transport.abort()
            return
        try:
            async with asyncio.TaskGroup() as group:
                group.create_task(self._pipe(reader, there[1]))
                group.create_task(self._pipe(there[0], writer))
        except* OSError:  # an end is closed: close the other
            pass
        finally:
            for end in (writer, there[1]):
                end.transport.abort()

    async def close(self) -> None:
        """Close all connections."""
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def _pipe(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        queue: deque[tuple[float, bytes]] = deque()  # time of delivery, data
        room, filled = asyncio.Event(), asyncio.Event()
        waiting = 0  # bytes

        async def deliver() -> None:
            nonlocal waiting
            while True:
                while not queue:
                    filled.clear()
                    await filled.wait()
                at, data = queue.popleft()
                await asyncio.sleep(max(0.0, at - time.perf_counter()))
                if not data:
                    writer.write_eof()
                    return
                waiting -= len(data)
                room.set()
                writer.write(data)
                await writer.drain()

        async with asyncio.TaskGroup() as group:
            group.create_task(deliver())
            chance = Random(1)
            free = 0.0  # time at which the link is idle
            while True:
                data = await reader.read(_CHUNK_BYTES)
                free = max(free, time.perf_counter()) + len(data) * 8e-6 / self._link.rate
                queue.append((free + self._link.round_trip / 2e3 + self._link.loss_delay(len(data), chance), data))
                filled.set()
                if not data:
                    break
                waiting += len(data)
                while waiting > self._capacity:
                    room.clear()
                    await room.wait()

    @property
    def _capacity(self) -> float:
        """Maximum bytes in transit and queued."""
        return _QUEUE_BYTES + self._link.rate * 1e6 / 8 * self._link.round_trip / 2e3
