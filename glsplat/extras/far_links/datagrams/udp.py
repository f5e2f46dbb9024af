"""A UDP socket on the event loop: read in batches, only while somebody is expected, and shut while it is flooded.

asyncio's own transport takes one datagram a turn of the loop and cannot be told to stop, so that whoever sends 30,000 a
second would have the server to himself.
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable
from typing import Any

from glsplat.net.guard.limits import Bucket
from glsplat.net.guard.listener import bind

_BATCH = 64  # datagrams a turn of the loop
_LARGEST = 2048  # bytes of one; QUIC's are below 1,500
_BUFFER = 1 << 20  # bytes that the system keeps, if it lets us
_STALE = 4096  # datagrams that may wait there: more than a buffer of small ones
_STRAYS, _AT_ONCE = 1000.0, 3000.0  # datagrams a second, and at once, that are for nobody, before it is shut ...
_SHUT = 20.0  # ... for so many seconds


class UdpSocket:
    """``received`` says of a datagram and its address whether it was for somebody. ``shut`` is called at a flood."""

    def __init__(
        self, listening: socket.socket, received: Callable[[bytes, Any], bool], shut: Callable[[], None]
    ) -> None:
        self._socket, self._received, self._flooded = listening, received, shut
        self._loop = asyncio.get_running_loop()
        self._strays = Bucket.full(_STRAYS, _AT_ONCE, self._loop.time())
        self._reads = self._closed = False
        self._until = 0.0  # shut

    @property
    def shut(self) -> bool:
        """Whether nobody is let in now, because too many datagrams come that are for nobody."""
        return self._loop.time() < self._until

    def listen(self) -> None:
        """Read from now on; what came before is thrown away."""
        if self._reads or self._closed or self.shut:
            return
        for _ in range(_STALE):
            if self._next() is None:
                break
        self._reads = True
        self._loop.add_reader(self._socket.fileno(), self._read)

    def rest(self) -> None:
        """Read nothing: it costs nothing then, whoever sends."""
        if self._reads:
            self._reads = False
            self._loop.remove_reader(self._socket.fileno())

    def sendto(self, data: bytes, addr: Any) -> None:
        """Send it, or lose it."""
        if not self._closed:
            try:
                self._socket.sendto(data, addr)
            except OSError:  # no room, no way there: as on any link
                return

    def close(self) -> None:
        """Give the port back."""
        self.rest()
        if not self._closed:
            self._closed = True
            self._socket.close()

    def _next(self) -> tuple[bytes, Any] | None:
        try:
            return self._socket.recvfrom(_LARGEST)
        except BlockingIOError:
            return None
        except OSError:  # told by the system of one that was sent before
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
    """A UDP socket. Raises GlsplatError (port in use, no such address)."""
    listening = bind(host, port, socket.SOCK_DGRAM)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
    listening.setblocking(False)
    return listening
