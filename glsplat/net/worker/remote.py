"""RemoteWorker: draws in another process, which a WorkerLauncher starts on this machine or elsewhere."""

from __future__ import annotations

import asyncio
import math
from collections import OrderedDict
from collections.abc import Callable

import msgspec
import numpy as np

from glsplat.errors import BudgetError, ContextError, GlsplatError
from glsplat.net.backend import Rendered, RenderJob
from glsplat.net.worker.connection import WorkerConnection, WorkerLauncher
from glsplat.net.worker.wire import MAX_ANSWER_BYTES, Order, WorkerLostError

_OPEN_S = 60.0  # to make a context and load a scene
_CLOSE_S = 5.0  # to end in order ...
_GRACE_S = 0.5  # ... and in the middle of a picture
_MAX_LOADED = 4  # avatars that a worker keeps loaded (backends/renderer_pool.py, MAX_RENDERERS)


class RemoteWorker:
    """Draws in another process. Pixels come through the launcher's shared memory, if any; else the worker encodes.

    ``seconds`` limits the time of a picture: a worker that takes far longer is ended. ``alone`` returns whether there
    is no other worker: then a longer wait costs nothing.
    """

    def __init__(
        self, launcher: WorkerLauncher, seconds: float = 5.0, alone: Callable[[], bool] = lambda: True
    ) -> None:
        self.name: str = launcher.name
        self.launcher: WorkerLauncher = launcher
        self._seconds, self._alone = seconds, alone
        self._link: WorkerConnection | None = None
        self._lost: Callable[[], None]
        self._cancelled = False
        self._loaded: OrderedDict[tuple[str, tuple[str, ...]], None] = OrderedDict()  # the newest last

    @property
    def loaded(self) -> frozenset[str]:
        """Names of the avatars that the worker keeps loaded."""
        return frozenset(avatar for avatar, _ in self._loaded)

    async def open(self, lost: Callable[[], None]) -> str:
        """Start the process; return the driver string. Raises GlsplatError; WorkerLostError if it ends at once."""
        self._lost = lost
        return await self._start()

    async def draw(
        self, job: RenderJob, pixels: bool = False, submitted: Callable[[], None] = lambda: None
    ) -> Rendered:
        """Draw. Pixels in shared memory stay valid until ``done`` of the result is called, once."""
        link, slots, slot = self._link, self.launcher.slots, None
        if link is None:
            raise WorkerLostError("the worker has stopped")
        self._cancelled = False
        shape = (len(job.cameras), job.cameras[0].height, job.cameras[0].width, 4)
        if slots is not None:
            slot = await slots.take(shape)
        elif pixels and math.prod(shape) > MAX_ANSWER_BYTES:  # the answer would end the connection
            raise GlsplatError(f"{shape[2]}x{shape[1]} pixels are more than a worker can send")
        try:
            if self._cancelled:
                raise BudgetError("the picture is no longer wanted", "abandoned")
            shown = job.avatar, job.options.hide
            order = Order(job, None if slot is None else slot.number, pixels and slot is None)
            drawn, content = link.draw(order, shown not in self._loaded, submitted)
            result = await drawn
            images = np.empty((result.views, 0, 0, 4), np.uint8) if slot is None else slot.picture
            if order.pixels and content is not None:
                images = np.zeros((result.views, *shape[1:]), np.uint8)
                x, y, w, h = result.covered or (0, 0, shape[2], shape[1])
                images[:, y : y + h, x : x + w] = np.frombuffer(await content, np.uint8).reshape(result.views, h, w, 4)
                content = None
        except BaseException:
            if slot is not None:
                slot.give_back()
            raise
        self._loaded[shown] = None
        self._loaded.move_to_end(shown)
        if len(self._loaded) > _MAX_LOADED:
            self._loaded.popitem(last=False)
        fields = msgspec.structs.asdict(result)
        del fields["views"]
        return Rendered(images, **fields, done=None if slot is None else slot.give_back, encoded=content)

    def cancel(self) -> None:
        """Cancel the picture that was ordered last."""
        self._cancelled = True
        if self._link is not None:
            self._link.cancel()

    async def rebuild(self) -> str:
        """End the process, lost or not, and start a new one."""
        await self.close()
        return await self._start()

    async def close(self) -> None:
        """End the process, by force if it hangs."""
        link, self._link = self._link, None
        seconds = 0.0
        if link is not None and link.alive:
            seconds = _GRACE_S if link.busy else _CLOSE_S
            link.cancel()
            link.close()
        await self.launcher.end(seconds)
        if link is not None:
            link.end("the server has ended it")

    async def _start(self) -> str:
        connection, key = await self.launcher.start()
        link = WorkerConnection(key, self.launcher, lambda: self._ended(link), self._alone, self._seconds)
        await asyncio.get_running_loop().create_connection(lambda: link, sock=connection)
        try:
            async with asyncio.timeout(_OPEN_S):
                driver = await link.opened
        except BaseException as error:
            link.end("it could not be opened")
            await self.launcher.end(0.0)
            if isinstance(error, TimeoutError):
                raise ContextError(f"{self.name} was not ready within {_OPEN_S:g} s") from None
            raise
        self._link = link
        self._loaded.clear()
        return driver

    def _ended(self, link: WorkerConnection) -> None:
        if self._link is link:
            self._lost()
