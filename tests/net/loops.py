"""Tests that are coroutines; servers and backends that run for the length of a block."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator
from contextlib import asynccontextmanager, contextmanager
from functools import wraps
from typing import Any, ParamSpec, Protocol, TypeVar

from glsplat.net.server import Server

P = ParamSpec("P")


def in_a_loop(test: Callable[P, Coroutine[Any, Any, None]]) -> Callable[P, None]:
    """Run a coroutine test in an event loop of its own."""

    @wraps(test)
    def run(*args: P.args, **kwargs: P.kwargs) -> None:
        asyncio.run(test(*args, **kwargs))

    return run


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
async def running(server: Server) -> AsyncIterator[Server]:
    """Start a server; stop it in the end."""
    await server.start()
    try:
        yield server
    finally:
        await server.stop()
