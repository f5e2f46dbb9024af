"""A simulated network link: a TCP relay on loopback that delays and throttles what passes, for ``glsplat replay``.

Each direction has its own rate and half of the round trip. Bytes wait in a queue of bounded length, as in a router; a
sender that is faster than the link is held back, as by TCP. A lost packet holds back all behind it for a round trip, or
for two where it is lost again, as TCP has it; TCP's slowing down after it is not there, nor is jitter.
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

__all__ = ["Link", "link", "over"]

_PACKET = 1448  # bytes
_CHUNK = 4096  # bytes read at once: 0.7 ms at 50 Mbit/s
_QUEUE = 128 * 1024  # bytes that may wait before the sender is held back


@dataclass(frozen=True, slots=True)
class Link:
    """What a link does to a stream."""

    round_trip: float  # ms
    rate: float  # Mbit/s, each way
    loss: float = 0.0  # of the packets, percent

    def __str__(self) -> str:
        return f"{self.round_trip:g} ms, {self.rate:g} Mbit/s" + (f", {self.loss:g} % lost" if self.loss else "")

    def held_back(self, nbytes: int, chance: Random) -> float:
        """Seconds by which so many bytes come later because of packets that were lost, once or several times."""
        times, lost = 0, 1 - (1 - self.loss / 100) ** -(-nbytes // _PACKET)
        while chance.random() < lost:
            times, lost = times + 1, self.loss / 100
        return times * self.round_trip / 1e3


def link(text: str) -> Link:
    """argparse type: RTT,MBIT or RTT,MBIT,LOSS, for example 20,100 and 20,100,1."""
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
    """An address that leads to ``url`` over the link, on this machine; ``url`` itself without one.

    Raises GlsplatError for wss://, whose certificate names another address, and where there is no server.
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
    server = await asyncio.start_server(relay.connected, "127.0.0.1", 0, limit=_CHUNK)
    port = server.sockets[0].getsockname()[1]
    try:
        yield urlunsplit(parts._replace(netloc=f"127.0.0.1:{port}"))
    finally:
        server.close()
        await relay.close()


class _Relay:
    """The connections of one link."""

    def __init__(self, simulated: Link, host: str, port: int) -> None:
        self.host, self.port = host, port
        self._link = simulated
        self._tasks: set[asyncio.Task[None]] = set()

    def connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """One client: its own connection to the server, and a pipe each way."""
        task = asyncio.create_task(self._relay(reader, writer))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _relay(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            there = await asyncio.open_connection(self.host, self.port, limit=_CHUNK)
        except OSError:
            writer.transport.abort()
            return
        try:
            async with asyncio.TaskGroup() as group:
                group.create_task(self._pipe(reader, there[1]))
                group.create_task(self._pipe(there[0], writer))
        except* OSError:  # either end is gone: so is the other
            pass
        finally:
            for end in (writer, there[1]):
                end.transport.abort()

    async def close(self) -> None:
        """End all connections."""
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def _pipe(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        queue: deque[tuple[float, bytes]] = deque()  # when to hand over, and what
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
            free = 0.0  # when the link has sent what it was given
            while True:
                data = await reader.read(_CHUNK)
                free = max(free, time.perf_counter()) + len(data) * 8e-6 / self._link.rate
                queue.append((free + self._link.round_trip / 2e3 + self._link.held_back(len(data), chance), data))
                filled.set()
                if not data:
                    break
                waiting += len(data)
                while waiting > self._capacity:
                    room.clear()
                    await room.wait()

    @property
    def _capacity(self) -> float:
        """Bytes under way on the link and waiting for it."""
        return _QUEUE + self._link.rate * 1e6 / 8 * self._link.round_trip / 2e3
