"""WorkerPool: several workers behind the face of one render loop.

Each worker has a render loop. A client belongs to one of them, and moves when its worker is lost or too busy; its
pictures keep their order, because it moves between two of them, and because a picture whose worker is lost keeps its
place in the queue of answers while another worker draws it.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from glsplat.errors import ContextError, GlsplatError
from glsplat.extras.workers.placement import PlacedClient, PlacedWorker, better, choose
from glsplat.net.client_stream import Answer, ClientStream, Outgoing
from glsplat.net.guard.fault_tracker import FaultTracker
from glsplat.net.pace.stages import StageTimes
from glsplat.net.render_loop import RenderLoop
from glsplat.net.worker.encoding import PictureEncoder
from glsplat.net.worker.remote import RemoteWorker, WorkerLauncher

__all__ = ["WorkerPool"]

log: logging.Logger = logging.getLogger("glsplat.net")

_TRIES = 3  # attempts to start each worker, while none lives, before the pool may give up
_MAX_MOVES = 64  # clients that move at once for the sake of balance
_REFUSED_S = 60.0  # time for which an avatar is not tried again on a worker that could not load it


class WorkerPool:
    """Draws with a worker of each of ``launchers``, at ``rate`` pictures a second for each client.

    ``seconds`` limits the time of a picture. After ``patience`` seconds without any worker ``ended`` raises, if none
    can be started either. ``close`` is called on a thread once all have ended. ``video`` lets clients have video.
    """

    def __init__(
        self,
        launchers: Sequence[WorkerLauncher],
        rate: float | None = None,
        seconds: float = 5.0,
        patience: float = 0.0,
        clock: Callable[[], float] = time.perf_counter,
        close: Callable[[], None] | None = None,
        video: bool = False,
    ) -> None:
        if not launchers:
            raise GlsplatError("a pool needs a worker at least")
        self.clock: Callable[[], float] = clock
        self.stages: StageTimes = StageTimes()
        self.faults: FaultTracker = FaultTracker()
        self.encoder: PictureEncoder = PictureEncoder(video)
        self.should_yield: Callable[[], bool] = lambda: False  # ignored: workers have processors of their own
        self._patience, self._close = patience, close
        self._workers = [
            RemoteWorker(launcher, seconds, partial(self._is_alone, index)) for index, launcher in enumerate(launchers)
        ]
        self._render_loops = [RenderLoop(worker, clock, rate, owner=self) for worker in self._workers]
        self._clients: dict[int, tuple[ClientStream, RenderLoop | None]] = {}  # None: waits for a worker
        self._refused: dict[tuple[RenderLoop, str], float] = {}  # avatars that it could not load, and until when
        self._last_lost = 0.0  # clock seconds
        self._over: asyncio.Future[None]
        self._restarting: asyncio.Task[None] | None = None

    @property
    def driver(self) -> str:
        """The drivers, each once."""
        return "; ".join(dict.fromkeys(render_loop.driver for render_loop in self._render_loops if render_loop.driver))

    @property
    def healthy(self) -> bool:
        """False once no render loop is healthy."""
        return any(render_loop.healthy for render_loop in self._render_loops)

    @property
    def rebuilds(self) -> int:
        """Workers lost so far."""
        return sum(render_loop.rebuilds for render_loop in self._render_loops)

    @property
    def drawing_for(self) -> float:
        """Seconds that the newest of the pictures in hand has taken so far; 0: none is drawn."""
        return min(filter(None, (render_loop.drawing_for for render_loop in self._render_loops)), default=0.0)

    async def start(self) -> None:
        """Start all workers at once; those that fail are tried again. Raises GlsplatError if none can be started."""
        self._over = asyncio.get_running_loop().create_future()
        self._over.add_done_callback(lambda over: over.cancelled() or over.exception())  # perhaps nobody awaits it
        try:
            results = await asyncio.gather(
                *(render_loop.start() for render_loop in self._render_loops), return_exceptions=True
            )
        except BaseException:  # cancelled: all loops have returned
            await self.stop()
            raise
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
        self.encoder.close()
        self._over.cancel()
        if self._close is not None:
            await asyncio.to_thread(self._close)

    def add(self, client: ClientStream) -> None:
        """Draw for a client from now on, with the worker that suits it."""
        self._place(client)

    def remove(self, client: ClientStream) -> None:
        """Forget a client."""
        self._clients.pop(client.number, None)
        for render_loop in self._render_loops:  # it may be moving from one to another
            render_loop.remove(client)
        self._balance()

    async def pack(self, client: ClientStream, answer: Answer) -> Outgoing:
        """Return an answer as it is sent; a picture whose worker was lost is drawn by another one first."""
        render_loop = self._clients.get(client.number, (client, None))[1] or self._render_loops[0]
        return await render_loop.pack(client, answer)

    def workers(self) -> list[dict[str, Any]]:
        """Return ``workers`` of /stats."""
        return [
            {
                "name": render_loop.worker.name,
                "driver": render_loop.driver,
                "alive": render_loop.living,
                "clients": len(render_loop.clients),
                "lost": render_loop.rebuilds,
            }
            for render_loop in self._render_loops
        ]

    def restart(self) -> asyncio.Task[None]:
        """Start all workers anew, one by one; the others draw for their clients meanwhile, who wait for a single one.

        A restart under way goes on.
        """
        if self._restarting is None or self._restarting.done():
            self._restarting = asyncio.create_task(self._restart(), name="rolling restart")
        return self._restarting

    async def _restart(self) -> None:
        for render_loop in self._render_loops:
            if not render_loop.living:  # it is just being started anew
                continue
            render_loop.drain()
            for client in list(render_loop.clients.values()):
                self._move(client)
            while not (render_loop.empty or render_loop.living):
                await asyncio.sleep(0.01)
            if not render_loop.living:  # else it was lost and started anew meanwhile
                render_loop.renew()
            while not render_loop.living:
                await asyncio.sleep(0.05)
            log.info("%s is started anew", render_loop.worker.name)

    # ----------------------------------------------------------------------------------------- calls of render loops

    def lost(self, render_loop: RenderLoop) -> None:
        """Move the clients of a loop whose worker is lost."""
        self._last_lost = self.clock()
        for client in list(render_loop.clients.values()):
            self._move(client)

    def opened(self, render_loop: RenderLoop) -> None:
        """Place the clients that wait, then balance."""
        for client, place in list(self._clients.values()):
            if place is None:
                self._place(client)
        self._balance()

    def failed(self, render_loop: RenderLoop, error: GlsplatError) -> None:
        """Give up where no worker lives and none can be started."""
        hopeless = all(not other.living and other.attempts >= _TRIES for other in self._render_loops)
        if hopeless and self.clock() - self._last_lost >= self._patience and not self._over.done():
            self._over.set_exception(ContextError(f"no worker lives, and none can be started: {error}"))

    def elsewhere(self, render_loop: RenderLoop, client: ClientStream) -> bool:
        """Move a client, and all that have to stay with it, to a worker that may be able to load its avatar."""
        avatar = client.shown.name
        self._refused[render_loop, avatar] = self.clock() + _REFUSED_S
        if all(self._refuses(other, avatar) for other in self._render_loops if other.living):
            return False
        for other in list(render_loop.clients.values()):
            if other is client or other.place_key == client.place_key:
                self._move(other)
        return True

    # ---------------------------------------------------------------------------------------------------- placement

    def _is_alone(self, index: int) -> bool:
        """Return whether no other worker lives."""
        return not any(other.living for i, other in enumerate(self._render_loops) if i != index)

    def _refuses(self, render_loop: RenderLoop, avatar: str) -> bool:
        """Return whether a worker could not load an avatar a moment ago."""
        return self._refused.get((render_loop, avatar), 0.0) > self.clock()

    def _state(self, render_loop: RenderLoop) -> PlacedWorker:
        clients = (PlacedClient(one.number, one.place_key, one.cost) for one in render_loop.clients.values())
        loaded = self._workers[self._render_loops.index(render_loop)].loaded
        return PlacedWorker(tuple(clients), frozenset(f"avatar:{name}" for name in loaded))

    def _place(self, client: ClientStream) -> None:
        """Give a client to the worker that suits it; it waits where there is none."""
        living = [render_loop for render_loop in self._render_loops if render_loop.living]
        suspect = self.faults.suspects(client.address, self.clock())
        if suspect and len(living) < min(2, len(self._render_loops)):
            living = []  # the last one is for clients whose pictures are survived
        able = [one for one in living if not self._refuses(one, client.shown.name)] or living
        placed = PlacedClient(client.number, client.place_key, client.cost)
        index = choose(placed, [self._state(render_loop) for render_loop in able])
        render_loop = None if index is None else able[index]
        self._clients[client.number] = client, render_loop
        if render_loop is not None:
            render_loop.add(client)

    def _move(self, client: ClientStream, to: RenderLoop | None = None) -> None:
        """Move a client to that loop, or to the one that suits it, once its picture in hand is drawn."""
        render_loop = self._clients.get(client.number, (client, None))[1]
        if render_loop is None:
            return
        self._clients[client.number] = client, None
        if to is not None:
            to.reserve(client)

        def arrive() -> None:
            if to is not None:
                to.cancel_reservation(client)
            if client.number not in self._clients:
                return
            if to is not None and to.living:
                self._clients[client.number] = client, to
                to.add(client)
            else:
                self._place(client)

        render_loop.release(client, arrive)

    def _balance(self) -> None:
        """Move clients from busy workers to idle ones, where that helps a good deal."""
        living = [render_loop for render_loop in self._render_loops if render_loop.living]
        for _ in range(_MAX_MOVES):
            found = better([self._state(render_loop) for render_loop in living])
            if found is None:
                return
            numbers, to = found
            for number in numbers:
                self._move(self._clients[number][0], living[to])
