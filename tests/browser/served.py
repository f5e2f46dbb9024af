"""A server in a thread, driven from tests without a loop of their own, restarted on its port at will."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from glsplat.net.backend import Backend
from glsplat.net.served_scene import server_of
from glsplat.net.server import Server, ServerConfig

__all__ = ["Quiet", "Served", "hosted"]


class Served:
    """``with Served(backend) as served``; ``make(config)`` replaces ``server_of(backend, config)``.

    ``port`` stays the same over ``stop()`` and ``start()``.
    """

    def __init__(
        self,
        backend: Backend | None = None,
        config: ServerConfig | None = None,
        make: Callable[[ServerConfig], Server] | None = None,
        offered: Any = None,  # of Server, if not its own
    ) -> None:
        assert (backend is None) != (make is None)
        self._config = config or ServerConfig(port=0)
        self._make = make or (lambda config: server_of(backend, config, *([] if offered is None else [offered])))  # type: ignore[arg-type]
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread: threading.Thread | None = None
        self.server: Server | None = None

    @property
    def port(self) -> int:
        return self._config.port

    @property
    def origin(self) -> str:
        """What the page's address begins with. localhost, because only that or TLS has WebXR."""
        return f"{'https' if self._config.tls else 'http'}://localhost:{self.port}"

    @property
    def page(self) -> str:
        """The page's address."""
        return f"{self.origin}/vr"

    def start(self) -> None:
        """Returns once clients can connect; raises what the server raises."""
        assert self._thread is None, "it runs"
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, args=(self._loop,), name="served", daemon=True)
        self._thread.start()
        self.server = self._make(self._config)
        try:
            self.call(self.server.start())
        except BaseException:
            self._end()
            raise
        self._config = replace(self._config, port=self.server.port)

    def stop(self) -> None:
        """In order, as after a signal: clients hear 1001."""
        if self.server is not None and self._thread is not None:
            try:
                self.call(self.server.stop())
            finally:
                self._end()

    def call(self, coroutine: Any, timeout: float = 60.0) -> Any:
        """The result of a coroutine that ran on the server's loop."""
        assert self._loop is not None
        return asyncio.run_coroutine_threadsafe(coroutine, self._loop).result(timeout)

    def stats(self) -> dict[str, Any]:
        """The numbers of /stats, taken on the server's loop."""
        assert self.server is not None
        return self.call(_value(self.server.stats))

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def _end(self) -> None:
        assert self._loop is not None and self._thread is not None
        if self._config.tls:
            self.call(_all_closed())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(60.0)
        self._thread = self._loop = self.server = None

    @staticmethod
    def _run(loop: asyncio.AbstractEventLoop) -> None:
        asyncio.set_event_loop(loop)
        loop.run_forever()
        loop.close()


class Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_: Any) -> None: ...


@contextmanager
def hosted(folder: Path, handler: type[Quiet] = Quiet) -> Iterator[str]:
    """The address of a plain file server of a folder."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(handler, directory=str(folder)))
    thread = threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True)
    thread.start()
    try:
        yield f"http://localhost:{server.server_port}/"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


async def _all_closed() -> None:
    """TLS ends with an answer, for which the server does not wait: nothing but the loop's own pipe is left then."""
    loop: Any = asyncio.get_running_loop()
    end = loop.time() + 50
    while len(loop._selector.get_map()) > 1 and loop.time() < end:
        await asyncio.sleep(0.01)
    for _ in range(10):  # and is told that it is closed: one turn of the loop after another
        await asyncio.sleep(0)


async def _value(function: Callable[[], Any]) -> Any:
    return function()
