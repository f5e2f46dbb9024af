"""A UDP socket on the event loop: read in batches, only while a client is expected, and shut during a flood.

asyncio's transport reads one datagram a turn of the loop and cannot be paused: a sender of 30,000 datagrams a second
would block the server.
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable
from typing import Any

from glsplat.net.guard.limits import Bucket
from glsplat.net.guard.listener import bind

_BATCH = 64  # datagrams a turn of the loop
_LARGEST = 2048  # bytes of a datagram; QUIC's are below 1,500
_BUFFER = 1 << 20  # requested bytes of the system's buffer
_STALE = 4096  # queued datagrams: more than a buffer of small ones holds
_STRAYS, _AT_ONCE = 1000.0, 3000.0  # datagrams of no client that shut the socket: a second, and at once
_SHUT = 20.0  # seconds for which it is shut


class UdpSocket:
    """Calls ``received``, which returns whether a datagram belongs to a client, and at a flood ``shut``."""

    def __init__(
        self, listening: socket.socket, received: Callable[[bytes, Any], bool], shut: Callable[[], None]
    ) -> None:
        self._socket, self._received, self._flooded = listening, received, shut
        self._loop = asyncio.get_running_loop()
        self._strays = Bucket.full(_STRAYS, _AT_ONCE, self._loop.time())
        self._reads = self._closed = False
        self._until = 0.0  # end of the shut time, seconds

    @property
    def shut(self) -> bool:
        """Whether the socket is shut, because too many datagrams belong to no client."""
        return self._loop.time() < self._until

    def listen(self) -> None:
        """Start reading; drop queued datagrams."""
        if self._reads or self._closed or self.shut:
            return
        for _ in range(_STALE):
            if self._next() is None:
                break
        self._reads = True
        self._loop.add_reader(self._socket.fileno(), self._read)

    def rest(self) -> None:
        """Stop reading, so that datagrams cost nothing."""
        if self._reads:
            self._reads = False
            self._loop.remove_reader(self._socket.fileno())

    def sendto(self, data: bytes, addr: Any) -> None:
        """Send a datagram, or drop it."""
        if not self._closed:
            try:
                self._socket.sendto(data, addr)
            except OSError:  # buffer full or no route: lost, as on any link
                return

    def close(self) -> None:
        """Close the port."""
        self.rest()
        if not self._closed:
            self._closed = True
            self._socket.close()

    def _next(self) -> tuple[bytes, Any] | None:
        try:
            return self._socket.recvfrom(_LARGEST)
        except BlockingIOError:
            return None
        except OSError:  # the system reports an error of an earlier send
            return b"", None

    def _read(self) -> None:
        for _ in range(_BATCH):
            found = self._next()
            if found is None or not self._reads:
                return
            data, addr = found
            if data and not self._received(data, addr) and not self._strays.take(self._loop.time()):
                self._until = self._loop.time() + _SHUT
                self.rest()
                self._flooded()
                return


def bind_udp(host: str, port: int) -> socket.socket:
    """Return a bound UDP socket. Raises GlsplatError (port in use, no such address)."""
    listening = bind(host, port, socket.SOCK_DGRAM)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
    listening.setblocking(False)
    return listening
