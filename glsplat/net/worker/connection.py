"""The gateway's side of a worker: what was asked and not answered yet, and whether the worker still lives.

All of it on the event loop, without a thread: the gateway passes on a thousand pictures a second, and each change of
threads costs a tenth of a millisecond, or five where another one holds Python's lock.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Awaitable, Callable
from typing import Any

import msgspec

from glsplat.errors import ContextError, GlsplatError
from glsplat.net.backend import RenderJob
from glsplat.net.codec.encode import Encoded
from glsplat.net.worker.wire import (
    HEAD,
    MAX_ANSWER,
    Drawn,
    Kind,
    WorkerLostError,
    Writer,
    error_of,
    read_drawn,
    read_encoded,
    read_failed,
)

__all__ = ["HANG", "WorkerConnection"]

log: logging.Logger = logging.getLogger("glsplat.net")
clock: Callable[[], float] = time.perf_counter

HANG = 10.0
"""Seconds beyond what a picture may take after which it will not come any more."""

_BEAT = 0.25  # seconds between two looks, and between pings of a worker that is silent
_SILENT = 1.0  # seconds without an answer while it draws nothing
_BUSY = 3.0  # the same while it draws: its driver holds Python's lock for a second at most (backends/gl.py, _SLICE)


class WorkerConnection(asyncio.Protocol):
    """One connection, after the handshake. ``lost`` is called once it has ended, whatever the reason.

    ``cause`` and ``stopped`` are its place's: why it ended or is silent. ``alone`` says whether no other worker could
    take over: then patience costs nothing. ``seconds`` is what a picture may take.
    """

    def __init__(
        self,
        key: bytes,
        cause: Callable[[], Awaitable[tuple[str, bool]]],
        stopped: Callable[[], bool],
        lost: Callable[[], None],
        alone: Callable[[], bool],
        seconds: float,
    ) -> None:
        loop = asyncio.get_running_loop()
        self.opened: asyncio.Future[str] = loop.create_future()
        """The driver string, or the error that kept it from opening."""
        self._writer, self._cause, self._stopped, self._on_lost = Writer(key), cause, stopped, lost
        self._alone, self._seconds = alone, seconds
        self._transport: asyncio.Transport
        self._buffer = bytearray()
        self._number = 0
        self._drawing: dict[int, asyncio.Future[Drawn]] = {}
        self._encoding: dict[int, asyncio.Future[Encoded]] = {}
        self._since = 0.0  # when the picture in hand was asked for
        self._patient = False  # it needs what has to be loaded first
        self._begun = False  # the worker has heard of it
        self._asked: float | None = None  # when the ping went out that is not answered
        self._beating: asyncio.Task[None] | None = None
        self._ending: asyncio.Task[None] | None = None
        self._why: tuple[str, bool] | None = None  # known here: the worker is ended for it
        self._closing = False

    # ------------------------------------------------------------------------------------------------ the gateway asks

    @property
    def alive(self) -> bool:
        """False once it has ended, or is about to."""
        return self._ending is None and not self._closing

    def draw(self, job: RenderJob, patient: bool = False) -> tuple[asyncio.Future[Drawn], asyncio.Future[Encoded]]:
        """Ask for a picture; both futures may raise what a renderer raises, and WorkerLostError.

        One at a time: the next after the first future is done. ``patient``: it may take longer than usual.
        """
        if not self.alive:
            raise WorkerLostError("the worker has ended")
        loop = asyncio.get_running_loop()
        self._number = number = self._number % 0xFFFFFFFF + 1
        drawn, encoded = self._drawing[number], self._encoding[number] = loop.create_future(), loop.create_future()
        encoded.add_done_callback(_look)  # perhaps nobody waits for it any more
        self._since, self._patient, self._begun = clock(), patient, False
        self._transport.write(self._writer.pack(Kind.DRAW, number, job))
        return drawn, encoded

    def cancel(self) -> None:
        """Nobody wants the picture in hand any more."""
        if self._drawing and self.alive:
            self._transport.write(self._writer.pack(Kind.CANCEL, self._number))

    def close(self) -> None:
        """Ask the worker to end after what it has in hand."""
        if self.alive:
            self._closing = True
            self._transport.write(self._writer.pack(Kind.CLOSE))

    def end(self, why: str, blames: bool = False) -> None:
        """End the connection: who waits gets a WorkerLostError."""
        self._why = self._why or (why, blames)
        self._transport.abort()

    # ---------------------------------------------------------------------------------------- asyncio calls

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begin to look whether it lives."""
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        self._beating = asyncio.create_task(self._beat(), name="heartbeat")

    def data_received(self, data: bytes) -> None:
        """Take the messages that are complete."""
        self._asked = None
        buffer = self._buffer
        buffer += data
        place = 0
        try:
            while len(buffer) - place >= HEAD.size:
                length, kind, number = HEAD.unpack_from(buffer, place)
                if length > MAX_ANSWER:
                    raise ValueError(f"a message of {length} bytes")
                end = place + HEAD.size + length
                if len(buffer) < end:
                    break
                self._take(kind, number, bytes(memoryview(buffer)[place + HEAD.size : end]))
                place = end
        except (ValueError, msgspec.MsgspecError) as error:
            self.end(f"the worker says what no worker says: {error}")
        del buffer[:place]

    def connection_lost(self, error: Exception | None) -> None:
        """Find out why, then tell who waits."""
        if self._beating is not None:
            self._beating.cancel()
        if self._ending is None:
            self._ending = asyncio.create_task(self._end(), name="worker lost")

    # ------------------------------------------------------------------------------------------------

    def _take(self, kind: int, number: int, body: bytes) -> None:
        if kind == Kind.ENCODED:
            _answer(self._encoding.pop(number, None), read_encoded(body))
        elif kind == Kind.DRAWN:
            _answer(self._drawing.pop(number, None), read_drawn(body))
        elif kind == Kind.BEGUN:
            self._begun = self._begun or number == self._number
        elif kind == Kind.FAILED:
            error = error_of(read_failed(body))
            if number in self._drawing:
                self._encoding.pop(number).cancel()
                _answer(self._drawing.pop(number), error)
            else:
                _answer(self._encoding.pop(number, None), error)
        elif kind == Kind.OPENED:
            _answer(self.opened, body.decode("utf-8", "replace"))
        elif kind == Kind.REFUSED:
            failed = read_failed(body)
            found = error_of(failed)
            if not isinstance(found, GlsplatError):
                log.error("a worker could not be opened: %s", failed.text)
                found = ContextError("the worker's renderer could not be made")
            _answer(self.opened, found)

    async def _beat(self) -> None:
        last = clock()
        while True:
            await asyncio.sleep(_BEAT)
            now = clock()
            late, last = now - last - _BEAT, now
            if not self.opened.done():
                continue
            if self._asked is None:
                self._asked = now
                self._transport.write(self._writer.pack(Kind.PING))
                continue
            self._asked += max(0.0, late)  # the gateway itself stood still: what was answered is not read yet
            silent, most = now - self._asked, self._patience()
            if silent > most:
                self.end(
                    f"the worker did not answer within {most:g} s",
                    bool(self._drawing) and self._begun and not self._stopped(),
                )
            elif self._drawing and now - self._since > self._seconds + HANG:
                self.end(f"the worker did not draw within {self._seconds + HANG:g} s", True)

    def _patience(self) -> float:
        drawing = bool(self._drawing) and self._begun
        if self._alone() or (drawing and self._patient):
            return self._seconds + HANG
        return _BUSY if drawing else _SILENT

    async def _end(self) -> None:
        why, blames = self._why or await self._cause()
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
    """Nothing where nobody asked, or nobody waits any more."""
    if future is None or future.done():
        return
    if isinstance(found, Exception):
        future.set_exception(found)
    else:
        future.set_result(found)


def _look(future: asyncio.Future[Encoded]) -> None:
    if not future.cancelled():
        future.exception()
