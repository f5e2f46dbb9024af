"""The worker's program: draws the pictures that the server orders, and encodes each while it draws the next one.

One thread draws (an OpenGL context belongs to a thread), one reads, some encode. A worker serves one server and ends
with it. This module imports little, so that a worker starts quickly.
"""

from __future__ import annotations

import os
import queue
import signal
import socket
import threading
import traceback
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING

from glsplat.errors import GlsplatError
from glsplat.net.backend import POLL_S, Backend, MemoryTarget, Rendered, RenderJob, Submitted, begin
from glsplat.net.worker.slot_writer import SlotWriter, slot_writers
from glsplat.net.worker.wire import Kind, Order, Reader, RenderResult, failure_of, greet, pack

if TYPE_CHECKING:
    from glsplat.net.codec.encoded import Encoded
    from glsplat.net.worker.encoding import PictureEncoder

GREETING_S = 10.0  # limit of the handshake


def work_in_process(
    connection: socket.socket, secret: bytes, make: Callable[[], Backend], memory: tuple[str, int] | None
) -> None:
    """Run a worker as a process of its own. ``memory``: path and bytes of the slots."""
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):  # sent to the whole process group; the server ends its workers
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    slots = [] if memory is None else slot_writers(*memory)  # the server unlinks the file after the handshake
    try:
        key = greet_server(connection, secret)
    except (EOFError, OSError):  # the server has left
        return
    work(connection, key, make, slots)


def greet_server(connection: socket.socket, secret: bytes) -> bytes:
    """Return the connection's key once the server has proved that it knows the secret.

    Raises GlsplatError where it does not know it, EOFError, OSError.
    """
    connection.settimeout(GREETING_S)
    key = greet(connection, secret, worker=True)
    connection.settimeout(None)
    return key


def work(connection: socket.socket, key: bytes, make: Callable[[], Backend], slots: Sequence[SlotWriter] = ()) -> None:
    """Draw for the server at the other end with the backend of ``make()``, on this thread, until it orders the end.

    The process ends when the server leaves: nothing else stops a picture that is being drawn.
    """
    _Worker(connection, key, make, slots).run()


class _Worker:
    def __init__(
        self, connection: socket.socket, key: bytes, make: Callable[[], Backend], slots: Sequence[SlotWriter]
    ) -> None:
        self._connection, self._reader = connection, Reader(connection, key)
        self._make, self._slots = make, slots
        self._orders: queue.SimpleQueue[tuple[int, Order] | None] = queue.SimpleQueue()
        self._sending = threading.Lock()
        self._abandoned = 0  # number of the newest picture that is not needed
        self._encoder: PictureEncoder | None = None

    def run(self) -> None:
        threading.Thread(target=self._read, name="read", daemon=True).start()
        try:
            backend = self._make()
            driver = backend.open()
            if not self._slots:
                from glsplat.net.worker.encoding import PictureEncoder  # loaded late: not every worker encodes

                self._encoder = PictureEncoder()
        except Exception as error:
            self._send(pack(Kind.REFUSED, 0, failure_of(error)))
            return
        self._send(pack(Kind.OPENED, 0, driver))
        self._serve(backend)
        if self._encoder is not None:
            self._encoder.close(wait=True)
        backend.close()

    def _read(self) -> None:
        """Read messages, on a thread of its own: pings are answered while a picture is drawn."""
        try:
            while True:
                kind, number, content = self._reader.receive()
                if kind == Kind.DRAW:
                    self._send(pack(Kind.BEGUN, number))
                    self._orders.put((number, content))
                elif kind == Kind.CANCEL:
                    self._abandoned = number
                elif kind == Kind.PING:
                    self._send(pack(Kind.PONG))
                elif kind == Kind.CLOSE:
                    self._orders.put(None)
        except GlsplatError:
            traceback.print_exc()  # the connection is tampered with
        except (EOFError, OSError):
            pass
        os._exit(0)

    def _serve(self, backend: Backend) -> None:
        """Draw until the end is ordered. While the GPU draws a picture, begin the next one if its order comes."""
        before: _Begun | None = None
        running = True
        while running or before is not None:
            begun: _Begun | None = None
            if before is None or (running and self._ordered_before(before[0])):
                order = self._orders.get()
                running = order is not None
                begun = None if order is None else self._begin(backend, *order)
            if before is not None:
                before[1]()
            before = begun

    def _ordered_before(self, ready: Callable[[float], bool]) -> bool:
        """Wait for the GPU; return whether an order came first."""
        while self._orders.empty():
            if ready(POLL_S):
                return False
        return True

    def _begin(self, backend: Backend, number: int, order: Order) -> _Begun | None:
        """Begin a picture; answer its order unless the GPU still draws."""
        slot = None if order.slot is None else self._slots[order.slot]
        try:
            if isinstance(backend, MemoryTarget):
                backend.out = None if slot is None else slot.place(_shape(order.job))
            drawn = begin(backend, order.job, lambda: self._abandoned == number)
        except Exception as error:
            self._send(pack(Kind.FAILED, number, failure_of(error)))
            return None
        if isinstance(drawn, Submitted):
            self._send(pack(Kind.SUBMITTED, number))
            return drawn.ready, partial(self._answer, number, order, drawn.collect)
        self._answer(number, order, lambda: drawn)
        return None

    def _answer(self, number: int, order: Order, collect: Callable[[], Rendered]) -> None:
        job, slot = order.job, None if order.slot is None else self._slots[order.slot]
        try:
            rendered = collect()
            if slot is not None:
                slot.put(rendered, _shape(job))
        except Exception as error:
            self._send(pack(Kind.FAILED, number, failure_of(error)))
            return
        self._send(pack(Kind.DRAWN, number, _result(rendered)))
        if order.pixels:
            x, y, w, h = rendered.covered or (0, 0, *reversed(rendered.images.shape[1:3]))
            self._send(pack(Kind.PIXELS, number, rendered.images[:, y : y + h, x : x + w].tobytes()))
        if order.pixels or slot is not None:
            if rendered.done is not None:
                rendered.done()
            return
        assert self._encoder is not None  # every order to a worker with slots names one
        self._encoder.submit(rendered, job.options).add_done_callback(partial(self._encoded, number))

    def _encoded(self, number: int, encoded: Future[Encoded]) -> None:
        try:
            message = pack(Kind.ENCODED, number, encoded.result())
        except Exception as error:
            message = pack(Kind.FAILED, number, failure_of(error))
        self._send(message)

    def _send(self, message: bytes) -> None:
        with suppress(OSError), self._sending:  # the reading thread notices the end
            self._connection.sendall(message)


_Begun = tuple[Callable[[float], bool], Callable[[], None]]
"""Submitted.ready of a picture, and what answers its order."""


def _shape(job: RenderJob) -> tuple[int, ...]:
    return len(job.cameras), job.cameras[0].height, job.cameras[0].width, 4


def _result(rendered: Rendered) -> RenderResult:
    covered = None if rendered.covered is None else tuple(map(int, rendered.covered))
    return RenderResult(
        views=len(rendered.images),
        timings={name: float(ms) for name, ms in rendered.timings.items()},
        covered=covered,  # type: ignore[arg-type]
        levels=tuple(map(int, rendered.levels)),
        coarsest=rendered.coarsest,
        posed=rendered.posed,
        places=rendered.places,
        depth=rendered.depth,
    )
