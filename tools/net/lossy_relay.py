"""Relay one TCP and one UDP port of the same number in user space, with delay, rate and loss in each direction.

TCP is relayed as by ``glsplat replay --link``: a lost packet delays all later ones by a round trip, but TCP does not
slow down after a loss, so its rows are better than a real link's. UDP datagrams are dropped by loss, and when the
queue before the link is full.
"""

from __future__ import annotations

import asyncio
import contextlib
import heapq
import socket
import time
from collections.abc import Callable
from itertools import count
from random import Random
from typing import Any

from apps.replay.link import _QUEUE_BYTES, Link, _Relay

__all__ = ["DatagramRelay", "enlarge_buffer", "relay"]

_HEADER_BYTES = 28  # of IP and UDP
_SO_RCVBUFFORCE = 33  # Linux, for root


def enlarge_buffer(transport: Any) -> None:
    """Let the socket buffer several pictures, where the system allows it, so a busy process loses no datagram."""
    sock = transport.get_extra_info("socket")
    for option in (_SO_RCVBUFFORCE, socket.SO_RCVBUF):
        with contextlib.suppress(OSError):
            sock.setsockopt(socket.SOL_SOCKET, option, 1 << 22)
            return


class _Pipe:
    """One direction of the link."""

    def __init__(self, simulated: Link, seed: int) -> None:
        self._link, self._chance = simulated, Random(seed)
        self._free = 0.0  # time at which the link has sent all it was given
        self._heap: list[tuple[float, int, Callable[[], None]]] = []
        self._order = count()
        self._timer: asyncio.TimerHandle | None = None

    def put(self, nbytes: int, deliver: Callable[[], None]) -> None:
        now = time.perf_counter()
        if self._link.rate < 1e5:
            if (max(self._free, now) - now) * self._link.rate * 1e6 / 8 > _QUEUE_BYTES:
                return
            self._free = max(self._free, now) + (nbytes + _HEADER_BYTES) * 8e-6 / self._link.rate
        if self._chance.random() * 100 < self._link.loss:
            return
        heapq.heappush(self._heap, (max(self._free, now) + self._link.round_trip / 2e3, next(self._order), deliver))
        if self._timer is None:
            self._run()

    def _run(self) -> None:
        self._timer = None
        now = time.perf_counter()
        while self._heap and self._heap[0][0] <= now + 2e-4:
            heapq.heappop(self._heap)[2]()
        if self._heap:
            self._timer = asyncio.get_running_loop().call_later(max(0.0, self._heap[0][0] - now), self._run)


class DatagramRelay(asyncio.DatagramProtocol):
    """Relay UDP for any number of clients."""

    def __init__(self, simulated: Link, there: tuple[str, int]) -> None:
        self._link, self._there = simulated, there
        self._up, self._down = _Pipe(simulated, 1), _Pipe(simulated, 2)
        self._ends: dict[Any, asyncio.Future[asyncio.DatagramTransport]] = {}
        self._transport: Any = None

    def connection_made(self, transport: Any) -> None:
        self._transport = transport
        enlarge_buffer(transport)

    def datagram_received(self, data: bytes, addr: Any) -> None:
        end = self._ends.get(addr)
        if end is None:
            end = self._ends[addr] = asyncio.ensure_future(self._open(addr))
        end.add_done_callback(lambda done: self._up.put(len(data), lambda: done.result().sendto(data)))

    async def _open(self, addr: Any) -> asyncio.DatagramTransport:
        relay = self

        class Back(asyncio.DatagramProtocol):
            def connection_made(self, transport: Any) -> None:
                enlarge_buffer(transport)

            def datagram_received(self, data: bytes, _: Any) -> None:
                relay._down.put(len(data), lambda: relay._transport.sendto(data, addr))

        loop = asyncio.get_running_loop()
        return (await loop.create_datagram_endpoint(Back, remote_addr=self._there))[0]


async def relay(simulated: Link, there: int, port: int = 0) -> int:
    """Start relaying to the local port ``there``; return the port that it listens on, TCP and UDP."""
    pipe = _Relay(simulated, "127.0.0.1", there)
    server = await asyncio.start_server(pipe.connected, "127.0.0.1", port, limit=4096)
    here: int = server.sockets[0].getsockname()[1]
    loop = asyncio.get_running_loop()
    await loop.create_datagram_endpoint(
        lambda: DatagramRelay(simulated, ("127.0.0.1", there)), local_addr=("127.0.0.1", here)
    )
    return here
