"""A render loop whose renderer is a worker: the event loop asks for a picture and gets JPEGs, no thread of its own."""

from __future__ import annotations

import asyncio
import logging
from collections import OrderedDict
from collections.abc import Awaitable, Callable
from itertools import chain, repeat
from typing import Protocol

import numpy as np

from glsplat.errors import ContextError, FormatError, GlsplatError
from glsplat.extras.workers.connection import WorkerConnection
from glsplat.extras.workers.launcher import WorkerLauncher
from glsplat.extras.workers.placement import PlacedClient, PlacedWorker
from glsplat.extras.workers.wire import WorkerLostError
from glsplat.net.backend import Rendered
from glsplat.net.client_stream import ClientStream, Frame
from glsplat.net.codec.encode import Encoded
from glsplat.net.guard.fault_tracker import FaultTracker
from glsplat.net.pace.fair_queue import FairQueue
from glsplat.net.pace.stages import StageTimes
from glsplat.net.render_loop import RenderLoop

__all__ = ["Others", "RemoteLoop"]

log: logging.Logger = logging.getLogger("glsplat.net")

_PAUSES = (0.0, 0.5, 1.0)  # seconds before each attempt to start a worker anew ...
_LATER = 5.0  # ... and before all further ones
_OPEN = 60.0  # seconds to make a context and load a scene
_CLOSE = 5.0  # seconds to end in order
_HAS = 4  # avatars that a worker keeps loaded (backends/renderer_pool.py, MAX_RENDERERS)
_LEARN = 0.1  # how far a picture moves what its client's are expected to take
_REFUSED = 60.0  # seconds for which an avatar is not tried again on a worker that could not load it


class Others(Protocol):
    """What a render loop needs of the pool it is one of."""

    def alone(self, render_loop: RemoteLoop) -> bool:
        """Whether there is no other worker to go on with."""
        ...

    def elsewhere(self, render_loop: RemoteLoop, channel: ClientStream) -> bool:
        """Have another worker draw for this client, if there is one that may be able to."""
        ...

    def lost(self, render_loop: RemoteLoop) -> None:
        """The worker is gone: its clients go elsewhere."""
        ...

    def opened(self, render_loop: RemoteLoop) -> None:
        """The worker is there."""
        ...

    def failed(self, render_loop: RemoteLoop, error: GlsplatError) -> None:
        """The worker could not be started anew; it will be tried again."""
        ...


class RemoteLoop(RenderLoop):
    """The clients of one worker, and the worker's life: started, lost, started anew."""

    def __init__(
        self,
        launcher: WorkerLauncher,
        others: Others,
        clock: Callable[[], float],
        rate: float | None,
        seconds: float,
        stages: StageTimes,
        blame: FaultTracker,
    ) -> None:
        super().__init__(clock, rate)
        self.launcher: WorkerLauncher = launcher
        self.living: bool = False  # takes clients
        self.attempts: int = 0  # to start it, in a row, that failed
        self.channels: dict[int, ClientStream] = {}  # of those it draws for, by number
        self.stages, self._blame = stages, blame
        self._others, self._seconds = others, seconds
        self._link: WorkerConnection | None = None
        self._gone = False  # the worker has ended, or is to be ended
        self._has: OrderedDict[tuple[str, tuple[str, ...]], None] = OrderedDict()  # drawn lately, the newest last
        self._refuses: dict[str, float] = {}  # avatars that it could not load, and until when that counts

    # ------------------------------------------------------------------------------------------------- what a pool asks

    async def start(self) -> None:
        """Open the worker. What keeps it from opening is raised, and tried again all the same."""
        self._loop = asyncio.get_running_loop()
        try:
            self.driver = await self._open()
            self.living = True
        except GlsplatError:
            self._gone = True
            raise
        finally:
            self._task = asyncio.create_task(self._run(), name=f"render loop of {self.launcher.name}")

    def add(self, channel: ClientStream) -> None:
        """Let a client take part."""
        self.channels[channel.number] = channel
        super().add(channel)

    def remove(self, channel: ClientStream) -> None:
        """Forget a client; a picture of it that is being drawn is given up."""
        self.channels.pop(channel.number, None)
        super().remove(channel)
        if self._drawing is channel and self._link is not None:
            self._link.cancel()

    def release(self, channel: ClientStream, then: Callable[[], None]) -> None:
        """Draw no more for a client; ``then`` is called once its picture in hand is drawn."""
        self.channels.pop(channel.number, None)
        super().release(channel, then)

    def renew(self) -> None:
        """Have the worker end in order, and start it anew."""
        self.living, self._gone = False, True
        self._wake.set()

    @property
    def empty(self) -> bool:
        """True while it draws for nobody."""
        return not self.channels and not self._leaving

    def state(self) -> PlacedWorker:
        """For placement."""
        clients = tuple(PlacedClient(one.number, one.place_key, one.cost) for one in self.channels.values())
        return PlacedWorker(clients, frozenset(f"avatar:{name}" for name, _ in self._has))

    def refuses(self, avatar: str) -> bool:
        """Whether it could not load that avatar a moment ago."""
        return self._refuses.get(avatar, 0.0) > self._clock()

    # ------------------------------------------------------------------------------------------ what a render loop does

    async def _open(self) -> str:
        connection, key = await self.launcher.start()
        alone = self._others.alone
        link = WorkerConnection(
            key, self.launcher.cause, self.launcher.stopped, self._left, lambda: alone(self), self._seconds
        )
        link.opened.add_done_callback(lambda opened: opened.cancelled() or opened.exception())
        await self._loop.create_connection(lambda: link, sock=connection)
        try:
            async with asyncio.timeout(_OPEN):
                driver = await link.opened
        except BaseException as error:
            link.end("it could not be opened")
            await self.launcher.end(0.0)
            if isinstance(error, TimeoutError):
                raise ContextError(f"{self.launcher.name} was not ready within {_OPEN:g} s") from None
            raise
        self._link = link
        self._has.clear()
        return driver

    async def _reopen(self) -> str:
        link, self._link = self._link, None
        if link is not None and link.alive:
            link.close()
            await self.launcher.end(_CLOSE)
            link.end("it is started anew")
        await self.launcher.end(0.0)
        return await self._open()

    async def _close(self) -> None:
        link, self._link = self._link, None
        seconds = 0.0
        if link is not None and link.alive:
            link.cancel()
            link.close()
            seconds = _CLOSE if self._drawing is None else 0.5
        await self.launcher.end(seconds)
        if link is not None:
            link.end("the server stops")

    async def _picture(self, frame: Frame) -> Awaitable[Encoded]:
        if frame.solution is not None and not frame.solution.done():
            await asyncio.wait([asyncio.wrap_future(frame.solution)])
        job = self._job(frame)
        start = self._begin(frame)
        channel, link = frame.channel, self._link
        if link is None:
            raise WorkerLostError("the worker has ended")
        what = job.avatar, job.options.hide
        drawn, encoded = link.draw(job, what not in self._has)
        said = await drawn
        self._has[what] = None
        self._has.move_to_end(what)
        if len(self._has) > _HAS:
            self._has.popitem(last=False)
        took = self._clock() - start
        channel.cost += (took - channel.cost) * (_LEARN if channel.cost else 1.0)
        nothing = np.empty((said.views, 0, 0, 4), np.uint8)
        rendered = Rendered(
            nothing,
            said.timings,
            levels=said.levels,
            coarsest=said.coarsest,
            posed=said.posed,
            places=said.places,
            depth=said.depth,
        )
        self._note(frame, rendered, start)
        return encoded

    def _suspects_others(self, frame: Frame, error: Exception) -> bool:
        """What ended its worker is drawn by another one, without the others."""
        return not isinstance(error, WorkerLostError) and super()._suspects_others(frame, error)

    def _failed(self, channel: ClientStream, frame: Frame, error: Exception) -> None:
        """A picture that its worker did not survive is drawn by another once; its client is not let kill them all."""
        avatar = channel.shown.name
        if isinstance(error, FormatError):
            self._refuses[avatar] = self._clock() + _REFUSED
            frame.moved = self._others.elsewhere(self, channel)
        elif isinstance(error, WorkerLostError):
            now = self._clock()
            frame.losses += 1
            suspect = error.blames or frame.losses > 1 or self._blame.suspects(channel.address, now)
            if suspect and frame.shows_others:
                self._suspect_others(frame, error)
            elif suspect and self._blame.again(channel.address, now):
                frame.ends = "pictures that the renderer does not survive"
            frame.moved = not frame.ends and frame.losses < 2
        if frame.moved:
            name, number = self.launcher.name, frame.request.frame_id
            log.warning("frame %s of client %d is drawn elsewhere: %s: %s", number, channel.number, name, error)
        else:
            self._refuse(channel, frame, error)

    async def _rebuild(self) -> None:
        self._left()

    def _left(self) -> None:
        """The worker is gone."""
        if self._stopping or self._gone or self._link is None:
            return
        self._gone, self.living = True, False
        self.rebuilds += 1
        log.warning("%s is lost; starting a new one", self.launcher.name)
        self._others.lost(self)
        self._wake.set()

    async def _stand_by(self) -> None:
        """Start the worker anew once it is gone, however often that takes."""
        if not self._gone:
            return
        for pause in chain(_PAUSES, repeat(_LATER)):
            await asyncio.sleep(pause)
            try:
                self.driver = await self._reopen()
                break
            except GlsplatError as error:
                self.attempts += 1
                log.warning("%s: %s", self.launcher.name, error)
                self._others.failed(self, error)
        self._turns = FairQueue()  # the time until the old one was given up is nobody's debt
        self.attempts = self.failures = 0
        self._gone, self.living = False, True
        self._others.opened(self)
