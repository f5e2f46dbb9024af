"""WorkerPool: several workers with the interface of one render loop.

Each worker has a render loop. A client belongs to one of them, and moves when its worker is lost or too busy. Pictures
keep their order: a client moves between two pictures, and a picture whose worker is lost keeps its place in the queue
of answers while another worker draws it.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from glsplat.errors import ContextError, GlsplatError
from glsplat.extras.workers.cluster import RayCluster
from glsplat.extras.workers.placement import PlacedClient, PlacedWorker, better, choose
from glsplat.net.backend import Backend
from glsplat.net.client_stream import Answer, ClientStream, Outgoing
from glsplat.net.guard.addresses import FaultTracker
from glsplat.net.pace.stages import StageTimes
from glsplat.net.render_loop import RenderLoop
from glsplat.net.worker.connection import WorkerLauncher
from glsplat.net.worker.encoding import PictureEncoder
from glsplat.net.worker.process import ProcessLauncher
from glsplat.net.worker.remote import RemoteWorker

log: logging.Logger = logging.getLogger("glsplat.net")

_MAX_ATTEMPTS = 3  # to start each worker, while none is alive, before the pool may give up
_MAX_MOVES = 64  # clients moved at once for balance
_REFUSED_S = 60.0  # before an avatar is tried again on a worker that could not load it


class WorkerPool:
    """Draws with a worker of each of ``launchers``, at ``rate`` pictures per second for each client.

    ``seconds`` limits the time of a picture. ``ended`` raises after ``patience`` seconds without any worker, if none
    can be started. ``close`` is called on a thread once all have ended. ``video`` permits video.
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
            raise GlsplatError("a pool needs at least one worker")
        self.clock: Callable[[], float] = clock
        self.stages: StageTimes = StageTimes()
        self.faults: FaultTracker = FaultTracker()
        self.encoder: PictureEncoder = PictureEncoder(video)
        self.should_yield: Callable[[], bool] = lambda: False  # unused: workers have CPUs of their own
        self._patience, self._close = patience, close
        self._workers = [
            RemoteWorker(launcher, seconds, partial(self._is_alone, index)) for index, launcher in enumerate(launchers)
        ]
        self._render_loops = [RenderLoop(worker, clock, rate, owner=self) for worker in self._workers]
        self._clients: dict[int, tuple[ClientStream, RenderLoop | None]] = {}  # None: waiting for a worker
        self._refused: dict[tuple[RenderLoop, str], float] = {}  # avatars that cannot be loaded, until clock seconds
        self._last_lost = 0.0  # clock seconds
        self._over: asyncio.Future[None]
        self._restarting: asyncio.Task[None] | None = None

    @property
    def driver(self) -> str:
        """The distinct drivers."""
        return "; ".join(dict.fromkeys(render_loop.driver for render_loop in self._render_loops if render_loop.driver))

    @property
    def healthy(self) -> bool:
        """Whether any render loop is healthy."""
        return any(render_loop.healthy for render_loop in self._render_loops)

    @property
    def rebuilds(self) -> int:
        """Workers lost so far."""
        return sum(render_loop.rebuilds for render_loop in self._render_loops)

    @property
    def drawing_for(self) -> float:
        """Seconds since the newest picture in work began; 0: none."""
        return min(filter(None, (render_loop.drawing_for for render_loop in self._render_loops)), default=0.0)

    async def start(self) -> None:
        """Start all workers in parallel; failed ones are retried. Raises GlsplatError if none starts."""
        self._over = asyncio.get_running_loop().create_future()
        self._over.add_done_callback(lambda over: over.cancelled() or over.exception())  # no warning if not awaited
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
            log.warning("a worker failed to start: %s", error)

    async def ended(self) -> None:
        """Wait until no worker is alive and none can be started; then raise ContextError."""
        await asyncio.shield(self._over)

    async def stop(self) -> None:
        """End all workers; pictures in work get half a second."""
        if self._restarting is not None:
            self._restarting.cancel()
            await asyncio.gather(self._restarting, return_exceptions=True)
        await asyncio.gather(*(render_loop.stop() for render_loop in self._render_loops))
        self.encoder.close()
        self._over.cancel()
        if self._close is not None:
            await asyncio.to_thread(self._close)

    def add(self, client: ClientStream) -> None:
        """Start drawing for a client."""
        self._place(client)

    def remove(self, client: ClientStream) -> None:
        """Forget a client."""
        self._clients.pop(client.number, None)
        for render_loop in self._render_loops:  # it may be moving from one to another
            render_loop.remove(client)
        self._balance()

    async def pack(self, client: ClientStream, answer: Answer) -> Outgoing:
        """Return the messages of an answer; a picture whose worker was lost is drawn by another one first."""
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
        """Restart the workers one by one while the others draw for their clients. A running restart continues."""
        if self._restarting is None or self._restarting.done():
            self._restarting = asyncio.create_task(self._restart(), name="rolling restart")
        return self._restarting

    async def _restart(self) -> None:
        for render_loop in self._render_loops:
            if not render_loop.living:  # being restarted already
                continue
            render_loop.drain()
            for client in list(render_loop.clients.values()):
                self._move(client)
            while not (render_loop.empty or render_loop.living):
                await asyncio.sleep(0.01)
            if not render_loop.living:  # else it was lost and restarted meanwhile
                render_loop.renew()
            while not render_loop.living:
                await asyncio.sleep(0.05)
            log.info("%s was restarted", render_loop.worker.name)

    # ----------------------------------------------------------------------------------------- calls of render loops

    def lost(self, render_loop: RenderLoop) -> None:
        """Move the clients of a lost worker."""
        self._last_lost = self.clock()
        for client in list(render_loop.clients.values()):
            self._move(client)

    def opened(self, render_loop: RenderLoop) -> None:
        """Place the waiting clients, then balance."""
        for client, place in list(self._clients.values()):
            if place is None:
                self._place(client)
        self._balance()

    def failed(self, render_loop: RenderLoop, error: GlsplatError) -> None:
        """Give up if no worker is alive and none can be started."""
        hopeless = all(not other.living and other.attempts >= _MAX_ATTEMPTS for other in self._render_loops)
        if hopeless and self.clock() - self._last_lost >= self._patience and not self._over.done():
            self._over.set_exception(ContextError(f"no worker lives, and none can be started: {error}"))

    def elsewhere(self, render_loop: RenderLoop, client: ClientStream) -> bool:
        """Move a client, with those that have to stay with it, to a worker that may be able to load its avatar."""
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
        """Return whether no other worker is alive."""
        return not any(other.living for i, other in enumerate(self._render_loops) if i != index)

    def _refuses(self, render_loop: RenderLoop, avatar: str) -> bool:
        """Return whether a worker recently failed to load an avatar."""
        return self._refused.get((render_loop, avatar), 0.0) > self.clock()

    def _state(self, render_loop: RenderLoop) -> PlacedWorker:
        clients = (PlacedClient(one.number, one.place_key, one.cost) for one in render_loop.clients.values())
        loaded = self._workers[self._render_loops.index(render_loop)].loaded
        return PlacedWorker(tuple(clients), frozenset(f"avatar:{name}" for name in loaded))

    def _place(self, client: ClientStream) -> None:
        """Assign a client to the best worker, or let it wait for one."""
        living = [render_loop for render_loop in self._render_loops if render_loop.living]
        suspect = self.faults.suspects(client.address, self.clock())
        if suspect and len(living) < min(2, len(self._render_loops)):
            living = []  # spare the last worker: a suspect client's pictures may end it
        able = [one for one in living if not self._refuses(one, client.shown.name)] or living
        placed = PlacedClient(client.number, client.place_key, client.cost)
        index = choose(placed, [self._state(render_loop) for render_loop in able])
        render_loop = None if index is None else able[index]
        self._clients[client.number] = client, render_loop
        if render_loop is not None:
            render_loop.add(client)

    def _move(self, client: ClientStream, to: RenderLoop | None = None) -> None:
        """Move a client to a loop (None: the best one) once its picture in work is drawn."""
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
        """Move clients from busy to idle workers if it helps enough."""
        living = [render_loop for render_loop in self._render_loops if render_loop.living]
        for _ in range(_MAX_MOVES):
            found = better([self._state(render_loop) for render_loop in living])
            if found is None:
                return
            numbers, to = found
            for number in numbers:
                self._move(self._clients[number][0], living[to])


_HEADLESS_S = 120.0  # for which a gateway without workers waits for Ray to return


@dataclass(frozen=True, slots=True, kw_only=True)
class Workers:
    """``count`` processes on this machine, or with ``ray`` that many actors (None: as many as fit)."""

    count: int | None = 1
    ray: bool = False
    cpus: float = 1.0  # per actor
    gpus: float = 0.0
    address: str | None = None  # as for ray.init; None: RAY_ADDRESS, a cluster on this machine, or a new one

    def pool(
        self, makes: Sequence[Callable[[], Backend]], rate: float | None, seconds: float, video: bool = False
    ) -> WorkerPool:
        """Return a pool whose workers run ``makes`` in turn; Ray's all run the first. The rest is as for WorkerPool.

        Raises GlsplatError if Ray is not installed or cannot be reached.
        """
        if not self.ray:
            count = self.count or 1
            launchers = [ProcessLauncher(makes[i % len(makes)], f"worker {i + 1}") for i in range(count)]
            return WorkerPool(launchers, rate, seconds, video=video)
        cluster = RayCluster(makes[0], self.address, self.cpus, self.gpus)
        try:
            count = cluster.room() if self.count is None else self.count
            return WorkerPool(cluster.launchers(count), rate, seconds, _HEADLESS_S, close=cluster.close, video=video)
        except BaseException:
            cluster.close()
            raise
