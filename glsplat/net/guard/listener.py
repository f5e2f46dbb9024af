"""The listening socket: accepts connections at a bounded rate, and keeps a bounded number that are not clients (yet).

asyncio's own server accepts without bound, and logs a traceback for each attempt once no file descriptor is left.
"""

from __future__ import annotations

import asyncio
import errno
import os
import socket
import ssl
from collections import Counter
from collections.abc import Callable

from glsplat.errors import GlsplatError
from glsplat.net.guard.addresses import Addresses
from glsplat.net.guard.connection import GuardedConnection
from glsplat.net.guard.forwarded import TrustedProxies
from glsplat.net.guard.limits import address_key
from glsplat.net.guard.notices import Notices

_BACKLOG = 64
_PAUSE_S = 1.0  # without accepting when no descriptor is left and none can be freed
_RESERVED = 12  # descriptors for the server itself: a restarted renderer, files, wake-ups
_MIN_WAITING = 2  # connections, however few descriptors there are
_EXHAUSTED = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM)

Make = Callable[[str, bool, Callable[[GuardedConnection], None]], GuardedConnection]
"""Makes the protocol of a connection: its peer's key, whether that is a trusted proxy, a callback when it closes."""


class Listener:
    """Accept connections for ``make``. ``clients`` descriptors are reserved for clients."""

    def __init__(
        self,
        listening: socket.socket,
        make: Make,
        addresses: Addresses,
        notices: Notices,
        clock: Callable[[], float],
        *,
        clients: int,
        proxies: TrustedProxies,
        tls: ssl.SSLContext | None = None,
        handshake: float = 10.0,  # seconds
    ) -> None:
        self._socket, self._make, self._addresses, self._notices = listening, make, addresses, notices
        self._clock, self._clients, self._tls, self._handshake = clock, clients, tls, handshake
        self._proxies = proxies
        # not clients: in the handshake, loading a page, idle, closing; oldest first, with the tasks that open them
        self._waiting: dict[GuardedConnection, asyncio.Task[None] | None] = {}
        self._task: asyncio.Task[None] | None = None
        self.room: int = 0  # connections that may wait
        self.turned_away = 0  # connections closed unanswered

    @property
    def waiting(self) -> int:
        """Number of connections that are not clients."""
        return len(self._waiting)

    def start(self) -> None:
        """Begin to accept."""
        self.room = self._room()
        self._socket.setblocking(False)
        self._task = asyncio.create_task(self._accept(), name="accept")

    async def stop(self) -> None:
        """Accept nothing more and close the socket; open connections stay."""
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)
        self._socket.close()
        for connection, opening in list(self._waiting.items()):
            if not connection.open and opening is not None:
                opening.cancel()

    def release(self, connection: GuardedConnection) -> None:
        """Stop counting a connection, or closing it to make room: it is an accepted client's, or closed."""
        self._waiting.pop(connection, None)

    def take_back(self, connection: GuardedConnection) -> None:
        """Count a connection until its socket is closed: its client has left, but may not read unsent data."""
        if connection.open:
            self._waiting.setdefault(connection, None)

    async def _accept(self) -> None:
        loop = asyncio.get_running_loop()
        while True:
            try:
                accepted, peer = await loop.sock_accept(self._socket)
            except ConnectionAbortedError:
                continue
            except OSError as error:
                kind = "are used up" if error.errno in _EXHAUSTED else f"cannot be had ({error.strerror})"
                self._notices("descriptors", f"file descriptors {kind}: idle connections are closed first")
                await asyncio.sleep(0 if self._make_room() else _PAUSE_S)
                continue
            self._admit(accepted, peer[0])
            await asyncio.sleep(0)  # sock_accept does not yield while connections are pending

    def _admit(self, accepted: socket.socket, host: str) -> None:
        # a trusted proxy's connections carry requests of many addresses, which are counted one by one
        key, proxied = address_key(host), self._proxies.trusts(host)
        if not proxied and not self._addresses.visit(key, self._clock()):
            self._notices("visits", "an address connects too often; closed unanswered")
        elif len(self._waiting) < self.room or self._make_room():
            connection = self._make(key, proxied, self.release)
            self._waiting[connection] = asyncio.create_task(self._open(accepted, connection), name="open")
            return
        else:
            self._notices("waiting", "too many connections that are no clients; closed unanswered")
        self.turned_away += 1
        accepted.close()

    async def _open(self, accepted: socket.socket, connection: GuardedConnection) -> None:
        """Hand the socket to a protocol, after the TLS handshake where there is one."""
        try:
            await asyncio.get_running_loop().connect_accepted_socket(
                lambda: connection,
                accepted,
                ssl=self._tls,
                ssl_handshake_timeout=self._handshake if self._tls else None,
            )
        except (OSError, asyncio.CancelledError):  # no TLS, or gone
            self._waiting.pop(connection, None)
            accepted.close()

    def _make_room(self) -> bool:
        """Close the oldest idle connection of the address with most; return False where there is none.

        A busy one is closed where none is idle and its address has more than half of all.
        """
        most = Counter(connection.key for connection in self._waiting)
        found = [connection for connection in self._waiting if not connection.busy] or [
            connection for connection in self._waiting if most[connection.key] > len(self._waiting) / 2
        ]
        if not found:
            return False
        victim = max(found, key=lambda connection: most[connection.key])  # the first of the largest: the oldest
        opening = self._waiting.pop(victim)
        if victim.open:
            victim.abort()
        elif opening is not None:
            opening.cancel()  # in the TLS handshake
        self.turned_away += 1
        return True

    def _room(self) -> int:
        limit = _descriptors_left()
        wanted = self._addresses.limits.waiting
        if limit is None or limit - self._clients - _RESERVED >= wanted:
            return wanted
        room = max(_MIN_WAITING, limit - self._clients - _RESERVED)
        self._notices("few", f"few file descriptors (ulimit -n): {room} connections may wait, not {wanted}")
        return room


def bind(host: str, port: int, kind: int = socket.SOCK_STREAM) -> socket.socket:
    """Return a listening socket, or one of datagrams. Raises GlsplatError (port in use, no such address)."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listening = socket.socket(family, kind)
    try:
        if kind == socket.SOCK_STREAM:
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind((host, port))
        if kind == socket.SOCK_STREAM:
            listening.listen(_BACKLOG)
    except (OSError, OverflowError) as error:
        listening.close()
        if getattr(error, "errno", None) == errno.EADDRINUSE:
            if kind == socket.SOCK_DGRAM:
                hint = "choose another with --port, or leave webtransport out"
                raise GlsplatError(f"UDP port {port} is in use; {hint}") from None
            raise GlsplatError(f"port {port} is in use; choose another with --port") from None
        reason = getattr(error, "strerror", None) or str(error)
        raise GlsplatError(f"cannot listen on {host} port {port} ({reason}); choose --host and --port") from None
    return listening


def _descriptors_left() -> int | None:
    """Return the number of files that this process may still open; None where that is unknown."""
    try:
        import resource  # not on Windows
    except ImportError:
        return None
    soft = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    if soft == resource.RLIM_INFINITY:
        return None
    try:
        return soft - len(os.listdir("/proc/self/fd"))
    except OSError:  # no /proc: most of them are free right after the start
        return soft - 32
