"""Messages between the server and a worker over a stream socket: a handshake, then messages with their length.

In the handshake each side proves that it knows the secret, without sending it: HMAC-SHA256 over both sides' random
numbers and its role, so that no answer can be reflected. The server's messages are pickles; each has a keyed hash over
itself and its sequence number (BLAKE2b, RFC 7693), so that nobody can add, change or repeat one. The worker's messages
are MessagePack of fixed fields, JPEG and pixels, which execute nothing. Neither is encrypted: the network between them
is the operator's.
"""

from __future__ import annotations

import hashlib
import hmac
import os
import pickle
import socket
import struct
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import msgspec

from glsplat.errors import BudgetError, ContextError, ContextLostError, FormatError, GlsplatError, PoseError
from glsplat.net.backend import RenderJob
from glsplat.net.codec.encoded import Box, DepthGrid, Encoded

MAX_ANSWER_BYTES = 2 * 8192**2 * 4  # of a worker's message: two eyes of the largest --max-size as pixels
_MAX_ORDER_BYTES = 2**24  # of a server's message, which has up to 64 KiB for each person of a room
_MAGIC = b"glsplat worker 4"
_NONCE = _TAG = 32
_SEAL = 16  # bytes of the hash behind a server's message
HEAD = struct.Struct("<IBI")
"""Number of bytes that follow, kind, number of the picture; little endian."""

_COUNT = struct.Struct("<Q")


class Kind(IntEnum):
    """Kind of a message. The server sends the first four."""

    DRAW = 1  # an Order
    CANCEL = 2  # the picture is not needed any more
    PING = 3
    CLOSE = 4
    OPENED = 16  # the driver string, UTF-8
    REFUSED = 17  # a Failed: the renderer cannot be opened
    PONG = 18
    BEGUN = 19  # the order has arrived and is drawn next
    DRAWN = 20  # a RenderResult
    ENCODED = 21  # an Encoded
    FAILED = 22  # a Failed
    PIXELS = 23  # bytes of the covered part of the images, [V, h, w, 4]
    SUBMITTED = 24  # the GPU still draws the picture: the next order may come


@dataclass(frozen=True, slots=True, eq=False)
class Order:
    """A picture to draw, and how to return it: as JPEGs, as pixels over the socket, or in a slot."""

    job: RenderJob
    slot: int | None = None  # of shared memory, for the pixels
    pixels: bool = False  # send them over the socket


class WorkerLostError(ContextLostError):
    """A worker has ended or does not answer."""

    def __init__(self, message: str, blames: bool = False) -> None:
        super().__init__(message)
        self.blames = blames


class RenderResult(msgspec.Struct, array_like=True, frozen=True):
    """The fields of Rendered without pixels."""

    views: int
    timings: dict[str, float]
    covered: Box | None
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


# the first class that fits; all other errors are "other"
_KINDS: tuple[tuple[str, type[Exception]], ...] = (
    ("lost", ContextLostError),
    ("context", ContextError),
    ("budget", BudgetError),
    ("pose", PoseError),
    ("format", FormatError),
    ("glsplat", GlsplatError),
)


def failure_of(error: BaseException) -> Failed:
    """Return the message for an error. An OSError counts as a FormatError; an unexpected one has its traceback."""
    if isinstance(error, OSError):
        return Failed("format", str(error))
    kind = next((name for name, one in _KINDS if isinstance(error, one)), "other")
    text = "".join(traceback.format_exception(error)) if kind == "other" else str(error)
    return Failed(kind, text, error.code if isinstance(error, BudgetError) else "")


def error_of(failed: Failed) -> Exception:
    """Return the error to raise for a message."""
    if failed.kind == "budget":
        return BudgetError(failed.text, failed.code)
    if failed.kind == "lost":
        return WorkerLostError(failed.text, blames=True)
    one = dict(_KINDS).get(failed.kind, RuntimeError)
    return one(failed.text)


def pack(kind: Kind, number: int = 0, content: Any = None) -> bytes:
    """Return a worker's message; ``content`` is None, text, bytes, a struct or an Encoded."""
    if isinstance(content, str):
        body = content.encode()
    elif content is None or isinstance(content, bytes):
        body = content or b""
    else:
        body = msgspec.msgpack.encode(content)
    return HEAD.pack(len(body), kind, number) + body


# these raise msgspec.DecodeError
read_result: Callable[[bytes], RenderResult] = msgspec.msgpack.Decoder(RenderResult).decode
read_failed: Callable[[bytes], Failed] = msgspec.msgpack.Decoder(Failed).decode
read_encoded: Callable[[bytes], Encoded] = msgspec.msgpack.Decoder(Encoded).decode


class Writer:
    """Packs the server's messages, sealed with the key of the handshake."""

    def __init__(self, key: bytes) -> None:
        self._key, self._count = key, 0

    def pack(self, kind: Kind, number: int = 0, content: Any = None) -> bytes:
        """Return the bytes of a message; ``content`` is pickled."""
        body = b"" if content is None else pickle.dumps(content, pickle.HIGHEST_PROTOCOL)
        head = HEAD.pack(len(body), kind, number)
        self._count += 1
        return head + body + _seal(self._key, self._count, head, body)


class Reader:
    """Reads the server's messages. The seal is verified before anything is unpickled."""

    def __init__(self, connection: socket.socket, key: bytes) -> None:
        self._connection, self._key, self._count = connection, key, 0

    def receive(self) -> tuple[Kind, int, Any]:
        """Wait for the next message. Raises EOFError at the end, GlsplatError for a message with a wrong seal."""
        head = receive(self._connection, HEAD.size)
        length, kind, number = HEAD.unpack(head)
        if length > _MAX_ORDER_BYTES:
            raise GlsplatError(f"a request to a worker needs at most {_MAX_ORDER_BYTES} bytes, not {length}")
        body = receive(self._connection, length)
        self._count += 1
        if not hmac.compare_digest(receive(self._connection, _SEAL), _seal(self._key, self._count, head, body)):
            raise GlsplatError("a worker received a request that its gateway did not send")
        return Kind(kind), number, pickle.loads(body) if body else None


def greet(connection: socket.socket, secret: bytes, *, worker: bool) -> bytes:
    """Prove on both sides that they know the secret; return the key of this connection. Blocks.

    Raises GlsplatError where the other side does not know it, EOFError where it leaves, TimeoutError.
    """
    own = os.urandom(_NONCE)
    connection.sendall(_MAGIC + own)
    greeting = receive(connection, len(_MAGIC) + _NONCE)
    if greeting[: len(_MAGIC)] != _MAGIC:
        raise GlsplatError("the other end is not a glsplat worker, or has another version")
    other = greeting[len(_MAGIC) :]
    both = other + own if worker else own + other  # the gateway's first
    tags = {role: hmac.digest(secret, role + both, "sha256") for role in (b"gateway", b"worker", b"key")}
    mine, theirs = (b"worker", b"gateway") if worker else (b"gateway", b"worker")
    if worker:  # the server proves itself first: a stranger gets no hash to test guesses on
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
    """Receive ``count`` bytes. Raises EOFError where the connection ends before."""
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
