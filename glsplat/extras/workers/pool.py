"""The pool: several workers behind one face, which is a render loop's.

Each worker has a render loop. A client belongs to one of them, and changes over when its worker is lost or too busy;
its pictures keep their order, because it changes between two of them, and because a picture whose worker is lost keeps
its place in the line while another worker draws it.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections.abc import Callable, Sequence
from typing import Any

from glsplat.errors import ContextError, ContextLostError, GlsplatError
from glsplat.extras.workers.placement import PlacedClient, better, choose
from glsplat.extras.workers.remote_loop import RemoteLoop
from glsplat.net.backend import AvatarInfo, PoseSolver
from glsplat.net.client_stream import ANYTHING, ClientStream, Frame
from glsplat.net.guard.fault_tracker import FaultTracker
from glsplat.net.messages import Request
from glsplat.net.pace.stages import StageTimes
from glsplat.net.session import Session
from glsplat.net.worker.launcher import WorkerLauncher

__all__ = ["WorkerPool"]

log: logging.Logger = logging.getLogger("glsplat.net")

_TRIES = 3  # attempts to start each worker, while none lives, before the pool may give up
_MOVES = 64  # clients that change over at once, at most, for the sake of balance


class WorkerPool:
    """Draws with a worker in each of ``launchers``.

    ``rate`` is what each client's pictures are held at (pace/adaptive_quality.py), ``seconds`` what a picture may take.
    ``patience``: seconds without any worker after which ``ended`` raises, if none can be started either. ``close`` is
    called, on a thread, when all have ended.
    """

    codecs: tuple[str, ...] = ()
    """Of video: workers code none."""

    def __init__(
        self,
        launchers: Sequence[WorkerLauncher],
        rate: float | None = None,
        seconds: float = 5.0,
        patience: float = 0.0,
        clock: Callable[[], float] = time.perf_counter,
        close: Callable[[], None] | None = None,
    ) -> None:
        if not launchers:
            raise GlsplatError("a pool needs a worker at least")
        self.stages: StageTimes = StageTimes()
        self.should_yield: Callable[[], bool] = lambda: False  # ignored: workers have processors of their own
        self._clock, self._patience, self._close = clock, patience, close
        self._blame = FaultTracker()
        self._render_loops = [
            RemoteLoop(one, self, clock, rate, seconds, self.stages, self._blame) for one in launchers
        ]
        self._clients: dict[int, tuple[ClientStream, RemoteLoop | None]] = {}  # None: waits for a worker
        self._since = 0.0  # when the last worker was lost
        self._over: asyncio.Future[None]
        self._restarting: asyncio.Task[None] | None = None

    # --------------------------------------------------------------------------------------------- a render loop's face

    @property
    def driver(self) -> str:
        """What draws; of several different ones each once."""
        return "; ".join(dict.fromkeys(render_loop.driver for render_loop in self._render_loops if render_loop.driver))

    @property
    def healthy(self) -> bool:
        """False once no worker lives, or all that do are ill."""
        return any(render_loop.living and render_loop.healthy for render_loop in self._render_loops)

    @property
    def rebuilds(self) -> int:
        """Workers lost so far."""
        return sum(render_loop.rebuilds for render_loop in self._render_loops)

    @property
    def drawing_for(self) -> float:
        """Seconds that the newest of the pictures in hand has taken so far; 0: none is."""
        return min(
            (render_loop.drawing_for for render_loop in self._render_loops if render_loop.drawing_for), default=0.0
        )

    async def start(self) -> None:
        """Start all workers at once; those that fail are tried again. Raises GlsplatError if none can be started."""
        self._over = asyncio.get_running_loop().create_future()
        self._over.add_done_callback(lambda over: over.cancelled() or over.exception())  # perhaps nobody asks
        results = await asyncio.gather(
            *(render_loop.start() for render_loop in self._render_loops), return_exceptions=True
        )
        errors = [error for error in results if isinstance(error, BaseException)]
        if len(errors) == len(results) or any(not isinstance(error, GlsplatError) for error in errors):
            await self.stop()
            raise errors[0]
        for error in errors:
            log.warning("a worker could not be started: %s", error)

    async def ended(self) -> None:
        """Wait until no worker lives and none can be started. Raises ContextError then."""
        await asyncio.shield(self._over)

    async def stop(self) -> None:
        """End all workers; the pictures in hand get half a second."""
        if self._restarting is not None:
            self._restarting.cancel()
            await asyncio.gather(self._restarting, return_exceptions=True)
        await asyncio.gather(*(render_loop.stop() for render_loop in self._render_loops))
        self._over.cancel()
        if self._close is not None:
            await asyncio.to_thread(self._close)

    def open(
        self,
        number: int,
        session: Session,
        solver: PoseSolver | None = None,
        address: str = "",
        shown: AvatarInfo = ANYTHING,
    ) -> ClientStream:
        """Return a client that is ``shown`` an avatar; ``add`` lets it take part."""
        return self._render_loops[0].open(number, session, solver, address, shown)

    def add(self, channel: ClientStream) -> None:
        """Let a client take part, on the worker that suits it."""
        self._put(channel)

    def remove(self, channel: ClientStream) -> None:
        """Forget a client."""
        self._clients.pop(channel.number, None)
        for render_loop in self._render_loops:  # it may be on its way from one to another
            render_loop.remove(channel)
        self._balance()

    def received(self, channel: ClientStream, request: Request | None) -> None:
        """A message of this client was taken, as a render loop's."""
        (self._loop_of(channel) or self._render_loops[0]).received(channel, request)

    def wake(self, channel: ClientStream) -> None:
        """Its window has room again."""
        render_loop = self._loop_of(channel)
        if render_loop is not None:
            render_loop.wake(channel)

    async def pack(self, channel: ClientStream, frame: Frame) -> list[bytes] | str:
        """The messages of a frame, as a render loop's; one whose worker was lost is drawn by another first."""
        while await _has_to_move(frame):
            frame.moved, frame.encoded = False, None
            frame.again = asyncio.get_running_loop().create_future()
            channel.again = frame
            self.wake(channel)
            await frame.again
            frame.again = None
        return await self._render_loops[0].pack(channel, frame)

    # ------------------------------------------------------------------------------------------------ the operator's

    def workers(self) -> list[dict[str, Any]]:
        """For /stats: what each worker is and does."""
        return [
            {
                "name": render_loop.launcher.name,
                "driver": render_loop.driver,
                "alive": render_loop.living,
                "clients": len(render_loop.channels),
                "lost": render_loop.rebuilds,
            }
            for render_loop in self._render_loops
        ]

    def restart(self) -> asyncio.Task[None]:
        """Start all workers anew, one after the other; their clients are drawn for by the others meanwhile.

        With one worker they wait for it. A restart under way goes on.
        """
        if self._restarting is None or self._restarting.done():
            self._restarting = asyncio.create_task(self._restart(), name="rolling restart")
        return self._restarting

    async def _restart(self) -> None:
        for render_loop in self._render_loops:
            if not render_loop.living:  # it is being started anew as it is
                continue
            render_loop.living = False
            for channel in list(render_loop.channels.values()):
                self._move(channel)
            while not render_loop.empty:
                await asyncio.sleep(0.01)
            render_loop.renew()
            while not render_loop.living:
                await asyncio.sleep(0.05)
            log.info("%s is started anew", render_loop.launcher.name)

    # -------------------------------------------------------------------------------------------- what render loops ask

    def alone(self, render_loop: RemoteLoop) -> bool:
        """Whether no other worker lives."""
        return not any(other.living for other in self._render_loops if other is not render_loop)

    def elsewhere(self, render_loop: RemoteLoop, channel: ClientStream) -> bool:
        """Move a client, and who has to stay with it, to a worker that may be able to load its avatar."""
        avatar = channel.shown.name
        if all(other.refuses(avatar) for other in self._render_loops if other.living):
            return False
        for other in list(render_loop.channels.values()):
            if other is channel or other.place_key == channel.place_key:
                self._move(other)
        return True

    def lost(self, render_loop: RemoteLoop) -> None:
        """Its clients go to the others at once."""
        self._since = self._clock()
        for channel in list(render_loop.channels.values()):
            self._move(channel)
        render_loop.channels.clear()

    def opened(self, render_loop: RemoteLoop) -> None:
        """Those who wait are drawn for, then the others spread."""
        for channel, place in list(self._clients.values()):
            if place is None:
                self._put(channel)
        self._balance()

    def failed(self, render_loop: RemoteLoop, error: GlsplatError) -> None:
        """Give up where no worker lives and none can be started."""
        hopeless = all(not other.living and other.attempts >= _TRIES for other in self._render_loops)
        if hopeless and self._clock() - self._since >= self._patience and not self._over.done():
            self._over.set_exception(ContextError(f"no worker lives, and none can be started: {error}"))

    # ------------------------------------------------------------------------------------------------ places

    def _loop_of(self, channel: ClientStream) -> RemoteLoop | None:
        return self._clients.get(channel.number, (channel, None))[1]

    def _put(self, channel: ClientStream) -> None:
        """On the worker that suits it, or on none where there is none for it yet."""
        living = [render_loop for render_loop in self._render_loops if render_loop.living]
        if self._blame.suspects(channel.address, self._clock()) and len(living) < min(2, len(self._render_loops)):
            living = []  # the last one is for those whose pictures are survived
        able = [render_loop for render_loop in living if not render_loop.refuses(channel.shown.name)] or living
        index = choose(
            PlacedClient(channel.number, channel.place_key, channel.cost), [render_loop.state() for render_loop in able]
        )
        render_loop = None if index is None else able[index]
        self._clients[channel.number] = channel, render_loop
        if render_loop is not None:
            render_loop.add(channel)

    def _move(self, channel: ClientStream, to: RemoteLoop | None = None) -> None:
        """To that worker, or to the one that suits, once the picture in hand is drawn."""
        render_loop = self._loop_of(channel)
        if render_loop is None:
            return
        self._clients[channel.number] = channel, None
        if to is not None:
            to.channels[channel.number] = channel  # counts as there from now on

        def arrive() -> None:
            if to is not None:
                to.channels.pop(channel.number, None)
            if channel.number not in self._clients:
                return
            if to is not None and to.living:
                self._clients[channel.number] = channel, to
                to.add(channel)
            else:
                self._put(channel)

        render_loop.release(channel, arrive)

    def _balance(self) -> None:
        """Clients of busy workers change over to idle ones, where that helps a good deal."""
        living = [render_loop for render_loop in self._render_loops if render_loop.living]
        for _ in range(_MOVES):
            found = better([render_loop.state() for render_loop in living])
            if found is None:
                return
            numbers, to = found
            for number in numbers:
                self._move(self._clients[number][0], living[to])


async def _has_to_move(frame: Frame) -> bool:
    """Whether nobody draws it any more: its worker was lost while it drew, or while it encoded."""
    if frame.moved or frame.encoded is None:
        return frame.moved
    with contextlib.suppress(Exception):
        try:
            await frame.encoded
        except ContextLostError:
            return True
    return False
