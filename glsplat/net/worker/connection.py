"""WorkerConnection: the server's side of a worker's socket; sends orders and detects a worker that is lost.

It runs on the event loop, without threads: a gateway forwards a thousand pictures a second, and a change of threads
takes 0.1 ms, or 5 ms while another thread holds Python's lock.
"""

from __future__ import annotations

import asyncio
import logging
import socket
import time
from collections.abc import Callable
from typing import Any, Protocol

import msgspec

from glsplat.errors import ContextError, GlsplatError
from glsplat.net.worker.slots import Slots
from glsplat.net.worker.wire import (
    HEAD,
    MAX_ANSWER_BYTES,
    Kind,
    Order,
    RenderResult,
    WorkerLostError,
    Writer,
    error_of,
    read_encoded,
    read_failed,
    read_result,
)

log: logging.Logger = logging.getLogger("glsplat.net")
clock: Callable[[], float] = time.perf_counter

HANG_S = 10.0
"""Seconds beyond the limit of a picture after which its worker counts as hung."""

_BEAT_S = 0.25  # between two checks, and between pings of a worker that is silent
_SILENT_S = 1.0  # limit of the answer to a ping, while the worker is idle
_BUSY_S = 3.0  # the same while it draws: the driver may hold Python's lock for a second (backends/gl.py, _SLICE_S)


class WorkerLauncher(Protocol):
    """Starts, reaches and ends one worker at a time."""

    name: str
    """For the log and /stats."""

    @property
    def slots(self) -> Slots | None:
        """Memory for pixels that the worker shares with this process; None: it sends JPEGs."""

    async def start(self) -> tuple[socket.socket, bytes]:
        """Start a worker; return its connection after the handshake, and its key. Raises GlsplatError."""

    async def cause(self) -> tuple[str, bool]:
        """Return why the worker's connection ended, in a line, and whether its picture is likely to be at fault."""

    def stopped(self) -> bool:
        """Return whether the worker's process is stopped, as by SIGSTOP: then its picture is not why it is silent."""

    async def end(self, seconds: float) -> None:
        """Wait ``seconds`` for the worker to end, then end it by force. Harmless where there is none."""


class WorkerConnection(asyncio.Protocol):
    """One connection, after the handshake. ``lost`` is called once it has ended, whatever the reason.

    ``alone`` returns whether there is no other worker: then a longer wait costs nothing. ``seconds`` limits the time of
    a picture.
    """

    def __init__(
        self,
        key: bytes,
        launcher: WorkerLauncher,
        lost: Callable[[], None],
        alone: Callable[[], bool],
        seconds: float,
    ) -> None:
        loop = asyncio.get_running_loop()
        self.opened: asyncio.Future[str] = loop.create_future()
        """The driver string, or the error that kept the worker from opening."""
        self.opened.add_done_callback(_retrieve)  # its opening may have been cancelled
        self._writer, self._launcher, self._on_lost = Writer(key), launcher, lost
        self._alone, self._seconds = alone, seconds
        self._transport: asyncio.Transport
        self._buffer = bytearray()
        self._number = 0
        self._drawing: dict[int, asyncio.Future[RenderResult]] = {}
        self._encoding: dict[int, asyncio.Future[Any]] = {}
        self._submitted: Callable[[], None]
        self._since = 0.0  # when the newest picture was ordered
        self._patient = False  # its avatar has to be loaded first
        self._begun = False  # the worker has received the order
        self._pinged: float | None = None  # when the unanswered ping was sent
        self._beating: asyncio.Task[None] | None = None
        self._ending: asyncio.Task[None] | None = None
        self._why: tuple[str, bool] | None = None  # the reason, where this side ends the connection
        self._closing = False

    @property
    def alive(self) -> bool:
        """False once it has ended, or is about to."""
        return self._ending is None and not self._closing

    @property
    def busy(self) -> bool:
        """True while a picture is drawn."""
        return bool(self._drawing)

    def draw(
        self, order: Order, patient: bool = False, submitted: Callable[[], None] = lambda: None
    ) -> tuple[asyncio.Future[RenderResult], asyncio.Future[Any] | None]:
        """Order a picture; return its result, and its JPEGs (Encoded) or pixels (bytes), None with a slot.

        Both futures may raise a renderer's errors and WorkerLostError. Order the next picture once ``submitted`` is
        called or the first future is done. ``patient``: the picture may take longer than usual.
        """
        if not self.alive:
            raise WorkerLostError("the worker has stopped")
        loop = asyncio.get_running_loop()
        self._number = number = self._number % 0xFFFFFFFF + 1
        drawn = self._drawing[number] = loop.create_future()
        content = None
        if order.slot is None:
            content = self._encoding[number] = loop.create_future()
            content.add_done_callback(_retrieve)  # the client may have left
        self._since, self._patient, self._begun, self._submitted = clock(), patient, False, submitted
        self._transport.write(self._writer.pack(Kind.DRAW, number, order))
        return drawn, content

    def cancel(self) -> None:
        """Cancel the picture that was ordered last."""
        if self._number in self._drawing and self.alive:
            self._transport.write(self._writer.pack(Kind.CANCEL, self._number))

    def close(self) -> None:
        """Order the worker to end after the present picture."""
        if self.alive:
            self._closing = True
            self._transport.write(self._writer.pack(Kind.CLOSE))

    def end(self, why: str, blames: bool = False) -> None:
        """End the connection; all orders without an answer fail with WorkerLostError."""
        self._why = self._why or (why, blames)
        self._transport.abort()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Start the heartbeat."""
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        self._beating = asyncio.create_task(self._beat(), name="heartbeat")

    def data_received(self, data: bytes) -> None:
        """Handle all complete messages."""
        self._pinged = None
        buffer = self._buffer
        buffer += data
        place = 0
        try:
            while len(buffer) - place >= HEAD.size:
                length, kind, number = HEAD.unpack_from(buffer, place)
                if length > MAX_ANSWER_BYTES:
                    raise ValueError(f"a message of {length} bytes")
                end = place + HEAD.size + length
                if len(buffer) < end:
                    break
                self._take(kind, number, bytes(memoryview(buffer)[place + HEAD.size : end]))
                place = end
        except (ValueError, msgspec.MsgspecError) as error:
            self.end(f"the worker sent a malformed message: {error}")
        del buffer[:place]

    def connection_lost(self, error: Exception | None) -> None:
        """Find the cause, then fail the orders without an answer."""
        if self._beating is not None:
            self._beating.cancel()
        if self._ending is None:
            self._ending = asyncio.create_task(self._end(), name="worker lost")

    def _take(self, kind: int, number: int, body: bytes) -> None:
        if kind == Kind.ENCODED:
            _answer(self._encoding.pop(number, None), read_encoded(body))
        elif kind == Kind.PIXELS:
            _answer(self._encoding.pop(number, None), body)
        elif kind == Kind.DRAWN:
            _answer(self._drawing.pop(number, None), read_result(body))
        elif kind == Kind.BEGUN:
            self._begun = self._begun or number == self._number
        elif kind == Kind.SUBMITTED:
            if number == self._number:
                self._submitted()
        elif kind == Kind.FAILED:
            error = error_of(read_failed(body))
            content = self._encoding.pop(number, None)
            if number not in self._drawing:
                _answer(content, error)
                return
            if content is not None:
                content.cancel()
            _answer(self._drawing.pop(number), error)
        elif kind == Kind.OPENED:
            _answer(self.opened, body.decode("utf-8", "replace"))
        elif kind == Kind.REFUSED:
            failed = read_failed(body)
            found = error_of(failed)
            if not isinstance(found, GlsplatError):
                log.error("a worker failed to start: %s", failed.text)
                found = ContextError("the worker's renderer could not be made; the log has its error")
            _answer(self.opened, found)

    async def _beat(self) -> None:
        last = clock()
        while True:
            await asyncio.sleep(_BEAT_S)
            now = clock()
            late, last = now - last - _BEAT_S, now
            if not self.opened.done():
                continue
            self._since += max(0.0, late)  # this event loop was blocked: answers may wait to be read
            if self._drawing and now - self._since > self._seconds + HANG_S:
                self.end(f"the worker did not draw within {self._seconds + HANG_S:g} s", True)
            elif self._pinged is None:
                self._pinged = now
                self._transport.write(self._writer.pack(Kind.PING))
            else:
                self._pinged += max(0.0, late)
                silent, most = now - self._pinged, self._patience()
                if silent > most:
                    blames = self.busy and self._begun and not self._launcher.stopped()
                    self.end(f"the worker did not answer within {most:g} s", blames)

    def _patience(self) -> float:
        drawing = self.busy and self._begun
        if self._alone() or (drawing and self._patient):
            return self._seconds + HANG_S
        return _BUSY_S if drawing else _SILENT_S

    async def _end(self) -> None:
        why, blames = self._why or await self._launcher.cause()
        drawing, encoding, self._drawing, self._encoding = self._drawing, self._encoding, {}, {}
        self._on_lost()
        _answer(self.opened, WorkerLostError(why))
        for future in drawing.values():
            _answer(future, WorkerLostError(why, blames))
        for number, other in encoding.items():
            if number not in drawing:
                _answer(other, WorkerLostError(why))
            else:
                other.cancel()


def _answer(future: asyncio.Future[Any] | None, found: Any) -> None:
    """Set the result, or the error, of a future that is still awaited."""
    if future is None or future.done():
        return
    if isinstance(found, Exception):
        future.set_exception(found)
    else:
        future.set_result(found)


def _retrieve(future: asyncio.Future[Any]) -> None:
    """Mark an error as seen, or asyncio logs it."""
    if not future.cancelled():
        future.exception()
