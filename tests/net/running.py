"""Servers and backends that run for the length of a block."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager
from typing import Protocol, TypeVar

from glsplat.net.server import Server
from glsplat.net.worker.worker import Worker


class Opens(Protocol):
    def open(self) -> object: ...
    def close(self) -> None: ...


B = TypeVar("B", bound=Opens)


@contextmanager
def opened(backend: B) -> Iterator[B]:
    """Open a backend; close it in the end."""
    backend.open()
    try:
        yield backend
    finally:
        backend.close()


@asynccontextmanager
async def working(worker: Worker) -> AsyncIterator[Worker]:
    """Open a worker; close it in the end."""
    await worker.open(lambda: None)
    try:
        yield worker
    finally:
        await worker.close()


@asynccontextmanager
async def running(server: Server) -> AsyncIterator[Server]:
    """Start a server; stop it in the end."""
    await server.start()
    try:
        yield server
    finally:
        await server.stop()
