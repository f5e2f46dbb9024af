"""What gateway and worker say to each other over a stream socket: a handshake, then messages with their length.

Each side proves first that it knows the secret, without sending it: HMAC-SHA256 over both sides' random numbers
(challenge and response; the roles are in it, so that nothing can be sent back as it came). What the gateway sends
after that is a pickle, so every message of it carries a keyed hash over itself and its place in the order (BLAKE2b,
RFC 7693): nobody on the way can add, change or repeat one. What the worker sends is MessagePack of fixed fields, and
JPEG: nothing that could be executed. Neither is encrypted: the network between them is the operator's own.
"""

from __future__ import annotations

import hashlib
import hmac
import os
import pickle
import socket
import struct
from enum import IntEnum
from typing import Any

import msgspec

from glsplat.errors import BudgetError, ContextError, ContextLostError, FormatError, GlsplatError, PoseError
from glsplat.net.codec.depth import DepthGrid
from glsplat.net.codec.encode import Encoded

__all__ = [
    "HEAD",
    "MAX_ANSWER",
    "Drawn",
    "Failed",
    "Kind",
    "Reader",
    "WorkerLostError",
    "Writer",
    "error_of",
    "failure_of",
    "greet",
    "pack",
    "read_drawn",
    "read_encoded",
    "read_failed",
    "receive",
]

MAX_ANSWER = 256 * 2**20
"""Bytes of a worker's message at most."""

_MAX_ORDER = 2**24  # bytes of a gateway's message; a room's people bring up to 64 KiB of names and numbers each
_MAGIC = b"glsplat worker 3"
_NONCE = _TAG = 32
_SEAL = 16  # bytes of the hash behind a gateway's message
HEAD = struct.Struct("<IBI")
"""Bytes that follow, kind, number of the picture; little endian."""

_COUNT = struct.Struct("<Q")


class Kind(IntEnum):
    """Of a message. The first four are the gateway's."""

    DRAW = 1
    CANCEL = 2  # nobody wants that picture any more
    PING = 3
    CLOSE = 4
    OPENED = 16  # the driver string, UTF-8
    REFUSED = 17  # it cannot be opened, and why
    PONG = 18
    BEGUN = 19  # the request is there, and drawn next
    DRAWN = 20
    ENCODED = 21
    FAILED = 22


class WorkerLostError(ContextLostError):
    """A worker is gone, or does not answer. ``blames``: what it drew is likely to be at fault."""

    def __init__(self, message: str, blames: bool = False) -> None:
        super().__init__(message)
        self.blames = blames


class Drawn(msgspec.Struct, array_like=True, frozen=True):
    """A picture is drawn: what Rendered says of it, but for the pixels."""

    views: int
    timings: dict[str, float]
    levels: tuple[int, ...]
    coarsest: bool
    posed: int
    places: dict[str, list[float]]
    depth: tuple[DepthGrid, ...] = ()


class Failed(msgspec.Struct, array_like=True, frozen=True):
    """An error: a name of _KINDS, its text, a BudgetError's code."""

    kind: str
    text: str
    code: str = ""


class _Jpegs(msgspec.Struct, array_like=True, frozen=True):
    pictures: list[bytes]
    boxes: list[tuple[int, int, int, int]] | None
    ms: float
    alphas: list[bytes] | None


# the first that fits; errors that no class here is known for are "other"
_KINDS: tuple[tuple[str, type[Exception]], ...] = (
    ("lost", ContextLostError),
    ("context", ContextError),
    ("budget", BudgetError),
    ("pose", PoseError),
    ("format", FormatError),
    ("glsplat", GlsplatError),
)


def failure_of(error: Exception, text: str = "") -> Failed:
    """What is sent of an error; files that cannot be read count as those that hold something else."""
    if isinstance(error, OSError):
        return Failed("format", str(error))
    kind = next((name for name, one in _KINDS if isinstance(error, one)), "other")
    return Failed(kind, text or str(error), error.code if isinstance(error, BudgetError) else "")


def error_of(failed: Failed) -> Exception:
    """What to raise for it."""
    if failed.kind == "budget":
        return BudgetError(failed.text, failed.code)
    if failed.kind == "lost":
        return WorkerLostError(failed.text, blames=True)
    one = dict(_KINDS).get(failed.kind, RuntimeError)
    return one(failed.text)


def pack(kind: Kind, number: int = 0, content: Any = None) -> bytes:
    """A worker's message. ``content``: None, text, or one of the structs; an Encoded goes as it is."""
    if content is None:
        body = b""
    elif isinstance(content, str):
        body = content.encode()
    else:
        if isinstance(content, Encoded):
            content = _Jpegs(content.pictures, content.boxes, content.ms, content.alphas)
        body = msgspec.msgpack.encode(content)
    return HEAD.pack(len(body), kind, number) + body


_drawn, _failed = msgspec.msgpack.Decoder(Drawn), msgspec.msgpack.Decoder(Failed)
_jpegs = msgspec.msgpack.Decoder(_Jpegs)


def read_drawn(body: bytes) -> Drawn:
    """Raises msgspec.DecodeError for anything else."""
    return _drawn.decode(body)


def read_failed(body: bytes) -> Failed:
    """Raises msgspec.DecodeError for anything else."""
    return _failed.decode(body)


def read_encoded(body: bytes) -> Encoded:
    """Raises msgspec.DecodeError for anything else."""
    one = _jpegs.decode(body)
    return Encoded(one.pictures, one.boxes, one.ms, one.alphas)


class Writer:
    """The gateway's messages, sealed with the key of the handshake."""

    def __init__(self, key: bytes) -> None:
        self._key, self._count = key, 0

    def pack(self, kind: Kind, number: int = 0, content: Any = None) -> bytes:
        """The bytes of one; ``content`` is pickled."""
        body = b"" if content is None else pickle.dumps(content, pickle.HIGHEST_PROTOCOL)
        head = HEAD.pack(len(body), kind, number)
        self._count += 1
        return head + body + _seal(self._key, self._count, head, body)


class Reader:
    """The worker's side of it: nothing is looked at before its seal is."""

    def __init__(self, connection: socket.socket, key: bytes) -> None:
        self._connection, self._key, self._count = connection, key, 0

    def receive(self) -> tuple[Kind, int, Any]:
        """Wait for the next message. Raises EOFError at the end, GlsplatError for what is not the gateway's."""
        head = receive(self._connection, HEAD.size)
        length, kind, number = HEAD.unpack(head)
        if length > _MAX_ORDER:
            raise GlsplatError(f"a request to a worker needs at most {_MAX_ORDER} bytes, not {length}")
        body = receive(self._connection, length)
        self._count += 1
        if not hmac.compare_digest(receive(self._connection, _SEAL), _seal(self._key, self._count, head, body)):
            raise GlsplatError("a request to a worker came that its gateway has not sent")
        return Kind(kind), number, pickle.loads(body) if body else None


def greet(connection: socket.socket, secret: bytes, *, worker: bool) -> bytes:
    """Both sides show that they know the secret; returns the key for this connection. Blocks up to its time-out.

    Raises GlsplatError where the other side does not know it, EOFError where it leaves, TimeoutError.
    """
    own = os.urandom(_NONCE)
    connection.sendall(_MAGIC + own)
    said = receive(connection, len(_MAGIC) + _NONCE)
    if said[: len(_MAGIC)] != _MAGIC:
        raise GlsplatError("what is at the other end is no glsplat worker, or of another version")
    other = said[len(_MAGIC) :]
    both = other + own if worker else own + other  # the gateway's first
    tags = {role: hmac.digest(secret, role + both, "sha256") for role in (b"gateway", b"worker", b"key")}
    mine, theirs = (b"worker", b"gateway") if worker else (b"gateway", b"worker")
    if worker:  # the gateway shows first: a stranger who asks learns nothing to try secrets on
        known = hmac.compare_digest(receive(connection, _TAG), tags[theirs])
        if known:
            connection.sendall(tags[mine])
    else:
        connection.sendall(tags[mine])
        known = hmac.compare_digest(receive(connection, _TAG), tags[theirs])
    if not known:
        raise GlsplatError("gateway and worker do not have the same secret")
    return tags[b"key"]


def receive(connection: socket.socket, count: int) -> bytes:
    """So many bytes. Raises EOFError where fewer come."""
    parts, left = [], count
    while left:
        part = connection.recv(min(left, 2**20))
        if not part:
            raise EOFError
        parts.append(part)
        left -= len(part)
    return b"".join(parts)


def _seal(key: bytes, count: int, head: bytes, body: bytes) -> bytes:
    sealed = hashlib.blake2b(_COUNT.pack(count), key=key, digest_size=_SEAL)
    sealed.update(head)
    sealed.update(body)
    return sealed.digest()
