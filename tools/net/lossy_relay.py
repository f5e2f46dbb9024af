"""A relay in user space for one TCP and one UDP port of the same number: delay, rate and loss, each way.

    python -m tools.net.lossy_relay 9000 8000 --link 60,20,1     # listens on 9000, for a server on 8000

TCP is relayed as ``glsplat replay --link`` does it (a lost packet holds back all behind it for a round trip; TCP's
slowing down after a loss is not there, so its rows are better than a real link's). A lost UDP datagram is lost, and so
is one for which the queue before the link has no room.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import heapq
import socket
import time
from collections.abc import Callable
from itertools import count
from random import Random
from typing import Any

from apps.replay.link import _QUEUE_BYTES, Link, _Relay, link

__all__ = ["DatagramRelay", "relay", "roomy"]

_HEADERS = 28  # bytes of IP and UDP


def roomy(transport: Any) -> None:
    """Let the system keep more than a picture and a half, where it lets us: a process that waits loses none then."""
    sock = transport.get_extra_info("socket")
    for option in (33, socket.SO_RCVBUF):  # SO_RCVBUFFORCE, of Linux, for root
        with contextlib.suppress(OSError):
            sock.setsockopt(socket.SOL_SOCKET, option, 1 << 22)
            return


class _Pipe:
    """One direction."""

    def __init__(self, simulated: Link, seed: int) -> None:
        self._link, self._chance = simulated, Random(seed)
        self._free = 0.0  # when the link has sent what it was given
        self._heap: list[tuple[float, int, Callable[[], None]]] = []
        self._order = count()
        self._timer: asyncio.TimerHandle | None = None

    def put(self, nbytes: int, deliver: Callable[[], None]) -> None:
        now = time.perf_counter()
        if self._link.rate < 1e5:
            if (max(self._free, now) - now) * self._link.rate * 1e6 / 8 > _QUEUE_BYTES:
                return
            self._free = max(self._free, now) + (nbytes + _HEADERS) * 8e-6 / self._link.rate
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
    """UDP, for any number of clients."""

    def __init__(self, simulated: Link, there: tuple[str, int]) -> None:
        self._link, self._there = simulated, there
        self._up, self._down = _Pipe(simulated, 1), _Pipe(simulated, 2)
        self._ends: dict[Any, asyncio.Future[asyncio.DatagramTransport]] = {}
        self._transport: Any = None

    def connection_made(self, transport: Any) -> None:
        self._transport = transport
        roomy(transport)

    def datagram_received(self, data: bytes, addr: Any) -> None:
        end = self._ends.get(addr)
        if end is None:
            end = self._ends[addr] = asyncio.ensure_future(self._open(addr))
        end.add_done_callback(lambda done: self._up.put(len(data), lambda: done.result().sendto(data)))

    async def _open(self, addr: Any) -> asyncio.DatagramTransport:
        relay = self

        class Back(asyncio.DatagramProtocol):
            def connection_made(self, transport: Any) -> None:
                roomy(transport)

            def datagram_received(self, data: bytes, _: Any) -> None:
                relay._down.put(len(data), lambda: relay._transport.sendto(data, addr))

        loop = asyncio.get_running_loop()
        return (await loop.create_datagram_endpoint(Back, remote_addr=self._there))[0]


async def relay(simulated: Link, there: int, port: int = 0) -> int:
    """Begin; the port it listens on, TCP and UDP."""
    pipe = _Relay(simulated, "127.0.0.1", there)
    server = await asyncio.start_server(pipe.connected, "127.0.0.1", port, limit=4096)
    here: int = server.sockets[0].getsockname()[1]
    loop = asyncio.get_running_loop()
    await loop.create_datagram_endpoint(
        lambda: DatagramRelay(simulated, ("127.0.0.1", there)), local_addr=("127.0.0.1", here)
    )
    return here


async def _main(simulated: Link, port: int, there: int) -> None:
    print(await relay(simulated, there, port), flush=True)
    await asyncio.Event().wait()


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("port", type=int)
    parser.add_argument("there", type=int)
    parser.add_argument("--link", type=link, required=True)
    arguments = parser.parse_args()
    asyncio.run(_main(arguments.link, arguments.port, arguments.there))
