"""A hostile connection: a plain blocking socket, because a client library would keep the rules."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from tests.net.wire import frame

__all__ = ["CHEAP", "Target", "abort", "again_and_again", "connect", "drain", "frame", "repeat", "upgrade"]

CHEAP = 0.02  # seconds between two bursts: attackers share the server's processors and must not be the load themselves


@dataclass(frozen=True, slots=True)
class Target:
    """Where the server listens, and the loopback address that the attacker comes from."""

    port: int
    source: str = "127.0.0.1"
    host: str = "127.0.0.1"
    token: str | None = None

    def to(self, source: str) -> Target:
        """The same server, seen from another address."""
        return replace(self, source=source)


Attack = Callable[[Target, int, threading.Event], None]
"""One connection's worth of hostility: ``attack(target, number of the connection, stop)`` returns soon after stop."""


def connect(target: Target, timeout: float = 2.0, receive_buffer: int | None = None) -> socket.socket:
    """A TCP connection from the target's source address. Raises OSError."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        if receive_buffer is not None:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)
        sock.settimeout(timeout)
        sock.bind((target.source, 0))
        sock.connect((target.host, target.port))
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    except BaseException:
        sock.close()
        raise
    return sock


def upgrade(target: Target, query: str = "", headers: str = "", receive_buffer: int | None = None) -> socket.socket:
    """A WebSocket. Raises OSError, ConnectionRefusedError for an answer other than 101."""
    sock = connect(target, receive_buffer=receive_buffer)
    try:
        sock.sendall(handshake(target, query, headers))
        head = b""
        while b"\r\n\r\n" not in head and (part := sock.recv(4096)):
            head += part
        if b" 101 " not in head.partition(b"\r\n")[0]:
            raise ConnectionRefusedError(head[:40].decode("latin-1"))
    except BaseException:
        sock.close()
        raise
    return sock


def handshake(target: Target, query: str = "", headers: str = "") -> bytes:
    """The bytes that ask for a WebSocket."""
    token = "" if target.token is None else f"Authorization: Bearer {target.token}\r\n"
    return (
        f"GET /ws{query} HTTP/1.1\r\nHost: {target.host}:{target.port}\r\nUpgrade: websocket\r\n"
        f"Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
        f"{token}{headers}\r\n"
    ).encode("latin-1")


def drain(sock: socket.socket) -> bytes:
    """What has arrived, at most 1 MB, without waiting. Raises ConnectionError at the end of the stream."""
    sock.setblocking(False)
    got = b""
    try:
        while len(got) < 2**20:
            part = sock.recv(65536)
            if not part:
                raise ConnectionResetError
            got += part
    except BlockingIOError:
        pass
    finally:
        sock.settimeout(0.5)
    return got


def repeat(
    sock: socket.socket, blobs: Callable[[], bytes], a_second: float, stop: threading.Event, read: bool = True
) -> None:
    """Send ``blobs()`` that many times a second until told to stop. Raises OSError when the server has had enough."""
    sock.settimeout(0.5)
    start, sent = time.monotonic(), 0
    while not stop.is_set():
        due = int((time.monotonic() - start) * a_second) + 1 - sent
        for _ in range(min(due, 1000)):
            sock.sendall(blobs())
        sent += due
        if read:
            drain(sock)
        stop.wait(max(CHEAP, (sent + 1) / a_second - (time.monotonic() - start)))


def abort(sock: socket.socket) -> None:
    """Close with a reset instead of an orderly end."""
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    sock.close()


def again_and_again(visit: Attack, pause: float = 0.05) -> Attack:
    """``visit`` anew whenever the server ends it or refuses, as somebody would who means harm."""

    def attack(target: Target, number: int, stop: threading.Event) -> None:
        while not stop.is_set():
            with contextlib.suppress(OSError):
                visit(target, number, stop)
            stop.wait(pause)

    return attack
