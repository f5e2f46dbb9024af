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
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING

from glsplat.errors import GlsplatError
from glsplat.net.backend import Backend, Interruptible, MemoryTarget, Rendered
from glsplat.net.worker.slot_writer import SlotWriter
from glsplat.net.worker.wire import Kind, Order, Reader, RenderResult, failure_of, greet, pack

if TYPE_CHECKING:
    from glsplat.net.codec.encoded import Encoded
    from glsplat.net.worker.encoding import PictureEncoder

__all__ = ["GREETING_S", "work", "work_in_process"]

GREETING_S = 10.0  # limit of the handshake


def work_in_process(
    connection: socket.socket, secret: bytes, make: Callable[[], Backend], memory: tuple[str, int] | None
) -> None:
    """Run a worker as a process of its own. ``memory``: path and bytes of the slots."""
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):  # sent to the whole process group; the server ends its workers
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    with suppress(EOFError, OSError):
        work(connection, secret, make, slots=None if memory is None else SlotWriter(*memory))


def work(
    connection: socket.socket,
    secret: bytes,
    make: Callable[[], Backend],
    known: Callable[[], object] = lambda: None,
    slots: SlotWriter | None = None,
) -> None:
    """Draw for the server at the other end with the backend of ``make()``, on this thread, until it orders the end.

    ``known`` is called once the server has proved that it knows the secret; before that, GlsplatError, EOFError or
    OSError may be raised. The process ends when the server leaves: nothing else stops a picture that is being drawn.
    """
    connection.settimeout(GREETING_S)
    key = greet(connection, secret, worker=True)
    connection.settimeout(None)
    known()
    _Worker(connection, key, make, slots).run()


class _Worker:
    def __init__(
        self, connection: socket.socket, key: bytes, make: Callable[[], Backend], slots: SlotWriter | None
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
        except Exception as error:
            self._send(pack(Kind.REFUSED, 0, failure_of(error)))
            return
        self._send(pack(Kind.OPENED, 0, driver))
        while (order := self._orders.get()) is not None:
            self._draw(backend, *order)
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

    def _draw(self, backend: Backend, number: int, order: Order) -> None:
        job, slots = order.job, self._slots if order.slot is not None else None
        if isinstance(backend, Interruptible):
            backend.abandoned = lambda: self._abandoned == number
        shape = (len(job.cameras), job.cameras[0].height, job.cameras[0].width, 4)
        try:
            if isinstance(backend, MemoryTarget):
                backend.out = None if slots is None else slots.place(order.slot or 0, shape)
            rendered = backend.render(job)
            if slots is not None:
                slots.put(order.slot or 0, rendered, shape)
        except Exception as error:
            self._send(pack(Kind.FAILED, number, failure_of(error)))
            return
        self._send(pack(Kind.DRAWN, number, _result(rendered)))
        if order.pixels:
            x, y, w, h = rendered.covered or (0, 0, *reversed(rendered.images.shape[1:3]))
            self._send(pack(Kind.PIXELS, number, rendered.images[:, y : y + h, x : x + w].tobytes()))
        if order.pixels or slots is not None:
            if rendered.done is not None:
                rendered.done()
            return
        if self._encoder is None:
            from glsplat.net.worker.encoding import PictureEncoder  # loaded late: not every worker encodes

            self._encoder = PictureEncoder()
        self._encoder.submit(rendered, job.options).add_done_callback(partial(self._encoded, number))

    def _encoded(self, number: int, encoded: Future[Encoded]) -> None:
        error = encoded.exception()
        if error is None:
            self._send(pack(Kind.ENCODED, number, encoded.result()))
        else:
            self._send(pack(Kind.FAILED, number, failure_of(error)))

    def _send(self, message: bytes) -> None:
        with suppress(OSError), self._sending:  # the reading thread notices the end
            self._connection.sendall(message)


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
