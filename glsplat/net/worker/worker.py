"""Worker: the interface between a render loop and a renderer. All methods are called on one event loop."""

from __future__ import annotations

import asyncio
import logging
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Protocol, TypeVar, runtime_checkable

from glsplat.net.backend import POLL_S, Backend, Rendered, RenderJob, begin


@runtime_checkable
class Worker(Protocol):
    """Draws one picture after the other: on a thread of this process, or in another process on any machine."""

    name: str
    """For the log and /stats."""

    async def open(self, lost: Callable[[], None]) -> str:
        """Start; return the driver string. ``lost`` is called when the worker ends by itself. Raises GlsplatError."""

    async def draw(
        self, job: RenderJob, pixels: bool = False, submitted: Callable[[], None] = lambda: None
    ) -> Rendered:
        """Draw a picture. The result has ``images``; or ``encoded``, where the worker encodes, except with ``pixels``.

        One call at a time, and another one after ``submitted`` was called: the GPU still draws then. Raises the errors
        of ``Backend.render``; after ContextLostError call ``rebuild``.
        """

    def cancel(self) -> None:
        """Cancel the picture that was ordered last."""

    async def rebuild(self) -> str:
        """Restart; return the driver string. Raises GlsplatError."""

    async def close(self) -> None:
        """End, after the present picture or without it; harmless where ``open`` failed."""


R = TypeVar("R")
log: logging.Logger = logging.getLogger("glsplat.net")


class ThreadWorker:
    """Draws on a thread. The driver holds Python's lock meanwhile, so other threads wait (see ``process_worker``)."""

    def __init__(self, backend: Backend) -> None:
        self.name: str = "the OpenGL context"
        self._backend = backend
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="render")
        self._cancelled = threading.Event()

    async def open(self, lost: Callable[[], None]) -> str:
        """Open the backend; a lost context shows in ``draw``."""
        return await self._run(self._backend.open)

    async def draw(
        self, job: RenderJob, pixels: bool = False, submitted: Callable[[], None] = lambda: None
    ) -> Rendered:
        """Draw. The result has pixels whatever ``pixels`` is."""
        cancelled = self._cancelled = threading.Event()
        drawn = await self._run(partial(begin, self._backend, job, cancelled.is_set))
        if isinstance(drawn, Rendered):
            return drawn
        submitted()
        while not await self._run(partial(drawn.ready, POLL_S)):
            pass  # the thread may have begun another picture
        return await self._run(drawn.collect)

    def cancel(self) -> None:
        """Cancel the picture that was ordered last, if the backend is interruptible."""
        self._cancelled.set()

    async def rebuild(self) -> str:
        """Close the backend and open it again."""
        return await self._run(self._reopen)

    async def close(self) -> None:
        """Close the backend after the present picture."""
        try:
            await self._run(self._backend.close)
        finally:
            self._thread.shutdown(wait=False)

    async def _run(self, work: Callable[[], R]) -> R:
        return await asyncio.get_running_loop().run_in_executor(self._thread, work)

    def _reopen(self) -> str:
        try:
            self._backend.close()
        except Exception:
            log.debug("the rest of the lost context cannot be released", exc_info=True)
        return self._backend.open()
