"""A worker: draws what the gateway asks for, and encodes each picture while it draws the next one.

Three kinds of threads: one draws (an OpenGL context belongs to a thread), one reads, some encode. A worker serves one
gateway and ends with it.
"""

from __future__ import annotations

import os
import queue
import socket
import threading
import traceback
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress

from glsplat.errors import GlsplatError
from glsplat.net.backend import Backend, Interruptible, Rendered, RenderJob
from glsplat.net.codec.encode import Encoder
from glsplat.net.worker.encoding import encode
from glsplat.net.worker.wire import Drawn, Kind, Reader, failure_of, greet, pack

__all__ = ["GREETING", "work"]

GREETING = 10.0
"""Seconds for the handshake."""


def work(
    connection: socket.socket, secret: bytes, make: Callable[[], Backend], known: Callable[[], object] = lambda: None
) -> None:
    """Serve the gateway at the other end with what ``make()`` returns, on this thread, until it says or leaves.

    ``known`` is called once the other end has shown that it knows the secret; before, GlsplatError, EOFError or OSError
    may be raised. Where the gateway leaves, the process ends: a picture in hand cannot be stopped otherwise.
    """
    connection.settimeout(GREETING)
    key = greet(connection, secret, worker=True)
    connection.settimeout(None)
    known()
    _Worker(connection, key, make).run()


class _Worker:
    def __init__(self, connection: socket.socket, key: bytes, make: Callable[[], Backend]) -> None:
        self._connection, self._reader, self._make = connection, Reader(connection, key), make
        self._orders: queue.SimpleQueue[tuple[int, RenderJob] | None] = queue.SimpleQueue()
        self._sending = threading.Lock()
        self._abandoned = 0  # the newest picture that nobody wants
        self._encoder = Encoder()
        self._encode_threads = ThreadPoolExecutor(2, thread_name_prefix="frame")

    def run(self) -> None:
        threading.Thread(target=self._read, name="read", daemon=True).start()
        try:
            backend = self._make()
            driver = backend.open()
        except Exception as error:
            text = "" if isinstance(error, GlsplatError) else traceback.format_exc()
            self._send(pack(Kind.REFUSED, 0, failure_of(error, text)))
            return
        self._send(pack(Kind.OPENED, 0, driver))
        while (order := self._orders.get()) is not None:
            self._draw(backend, *order)
        self._encode_threads.shutdown()
        self._encoder.close()
        backend.close()

    def _read(self) -> None:
        """The reading thread. A ping is answered while a picture is drawn, whenever that lets go of Python's lock."""
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
            traceback.print_exc()  # somebody meddles with the connection
        except (EOFError, OSError):
            pass
        os._exit(0)

    def _draw(self, backend: Backend, number: int, job: RenderJob) -> None:
        if isinstance(backend, Interruptible):
            backend.abandoned = lambda: self._abandoned == number
        try:
            rendered = backend.render(job)
        except Exception as error:
            text = "" if isinstance(error, GlsplatError) else traceback.format_exc()  # for the gateway's log
            self._send(pack(Kind.FAILED, number, failure_of(error, text)))
            return
        timings = {name: float(ms) for name, ms in rendered.timings.items()}
        levels, said = tuple(map(int, rendered.levels)), (rendered.places, rendered.depth)
        drawn = Drawn(len(rendered.images), timings, levels, rendered.coarsest, rendered.posed, *said)
        self._send(pack(Kind.DRAWN, number, drawn))
        self._encode_threads.submit(self._encode, number, rendered, job)

    def _encode(self, number: int, rendered: Rendered, job: RenderJob) -> None:
        try:
            message = pack(Kind.ENCODED, number, encode(self._encoder, rendered, job.options))
        except Exception as error:
            message = pack(Kind.FAILED, number, failure_of(error, traceback.format_exc()))
        finally:
            if rendered.done is not None:
                rendered.done()
        self._send(message)

    def _send(self, message: bytes) -> None:
        with suppress(OSError), self._sending:  # the reading thread hears of the end
            self._connection.sendall(message)
