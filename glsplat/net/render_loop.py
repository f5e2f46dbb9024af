"""RenderLoop: takes the clients' requests in fair turns; one worker draws them, one after the other.

It runs on the event loop. Each client gets its pictures in order, with at most its window of them under way. While a
GPU draws a picture, the worker begins the next one: at most two turns overlap. A lost worker is restarted, and its
picture drawn again by another worker, if there is one. A picture that fails with other people of a room in it is drawn
again without them.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import chain, repeat
from typing import Any, Protocol

from glsplat.errors import BudgetError, ContextLostError, FormatError, GlsplatError, PoseError
from glsplat.gl.software import is_software
from glsplat.net.backend import RenderJob, Solved
from glsplat.net.client_stream import Answer, ClientStream, Drawn, Outgoing, Refused, Taken
from glsplat.net.codec.encoded import Encoded
from glsplat.net.guard.addresses import FaultTracker
from glsplat.net.messages import Request
from glsplat.net.pace.adaptive_quality import AdaptiveQuality
from glsplat.net.pace.fair_queue import FairQueue
from glsplat.net.pace.stages import StageTimes
from glsplat.net.reply import pack_reply, pack_single
from glsplat.net.worker.encoding import PictureEncoder
from glsplat.net.worker.worker import Worker

log: logging.Logger = logging.getLogger("glsplat.net")

_ROOM_FPS = 6.0  # pictures a second for each member of a room, by less detail, where pictures may be fitted to links
_UNHEALTHY_FAILURES = 3  # failed pictures in a row before /healthz reports it
_MAX_LOSSES = 2  # lost workers after which a picture is not drawn again
_STUCK_S = 10.0  # time of a picture before /healthz reports it
_YIELD_FACTOR = 9.0  # of a pause to the picture before it, while others need the processor
_MAX_YIELD_S = 1.0
_REVIVE_PAUSES_S = (0.0, 0.5, 1.0)  # before the attempts to restart a worker; without an owner the loop then ends ...
_REVIVE_PERIOD_S = 5.0  # ... and before each further one


class LoopOwner(Protocol):
    """The pool that a render loop belongs to, and what its loops share."""

    stages: StageTimes
    faults: FaultTracker
    encoder: PictureEncoder

    def lost(self, render_loop: RenderLoop) -> None:
        """Move the clients of a loop whose worker is lost."""

    def opened(self, render_loop: RenderLoop) -> None:
        """Give clients to a loop whose worker was restarted."""

    def failed(self, render_loop: RenderLoop, error: GlsplatError) -> None:
        """Note a failed attempt to restart a worker; more will follow."""

    def elsewhere(self, render_loop: RenderLoop, client: ClientStream) -> bool:
        """Move a client whose avatar the loop's worker cannot load; return False where no worker can."""


class RenderLoop:
    """Draws for its clients with ``worker``, at ``rate`` pictures a second for each (None: no target).

    ``owner`` is the pool of this loop, if any. ``encoder`` encodes the pixels of workers that do not encode.
    """

    restart: None = None  # only pools restart workers

    def __init__(
        self,
        worker: Worker,
        clock: Callable[[], float] = time.perf_counter,
        rate: float | None = None,
        encoder: PictureEncoder | None = None,
        owner: LoopOwner | None = None,
    ) -> None:
        self.worker: Worker = worker
        self.clock: Callable[[], float] = clock
        self.driver: str = ""
        self.clients: dict[int, ClientStream] = {}  # by number
        self.living: bool = False  # accepts clients
        self.attempts: int = 0  # failed attempts in a row to restart the worker
        self.failures: int = 0  # failed pictures in a row
        self.rebuilds: int = 0  # workers lost so far
        self.should_yield: Callable[[], bool] = lambda: False  # returns whether others need the processor that draws
        self.stages: StageTimes = StageTimes() if owner is None else owner.stages
        self.encoder: PictureEncoder = (encoder or PictureEncoder()) if owner is None else owner.encoder
        self._faults = FaultTracker() if owner is None else owner.faults
        self._owner = owner
        self._adaptive_quality = AdaptiveQuality(rate)
        self._turning: dict[asyncio.Task[None], ClientStream] = {}  # at most two turns, the oldest first
        self._ordered: Taken | None = None  # the picture that was ordered last, until it is drawn
        self._drawing_since: float | None = None
        self._finished = 0.0  # when the last picture was
        self._next = asyncio.Event()  # the worker takes another order
        self._broken: Exception | None = None  # ends the loop
        self._gone = False  # the worker has to be restarted
        self._stopping = False
        self._turns: FairQueue[ClientStream] = FairQueue()
        self._leaving: dict[int, Callable[[], None]] = {}  # by client: called after its present picture
        self._wake = asyncio.Event()
        self._loop: asyncio.AbstractEventLoop
        self._task: asyncio.Task[None] | None = None

    @property
    def drawing_for(self) -> float:
        """Seconds that the oldest picture has taken so far, not counting the one before; 0: none is drawn."""
        return 0.0 if self._drawing_since is None else self.clock() - self._drawing_since

    @property
    def healthy(self) -> bool:
        """False while there is no worker, once several pictures in a row failed, or one takes far too long."""
        running = self._task is not None and not self._task.done()
        return self.living and running and self.failures < _UNHEALTHY_FAILURES and self.drawing_for <= _STUCK_S

    @property
    def empty(self) -> bool:
        """True while it has no clients."""
        return not self.clients and not self._leaving

    def workers(self) -> list[dict[str, Any]] | None:
        """Return None for ``workers`` of /stats: there is no pool."""
        return None

    async def start(self) -> None:
        """Open the worker. Raises GlsplatError; a loop that has an owner keeps trying in the background."""
        self._loop = asyncio.get_running_loop()
        self.encoder.on_capacity.append(self._wake_up)
        try:
            self.driver = await self.worker.open(self._worker_lost)
            self.living = True
        except GlsplatError:
            self._gone = True
            raise
        finally:
            if self.living or (self._gone and self._owner is not None):
                self._task = asyncio.create_task(self._run(), name=f"render loop of {self.worker.name}")
            else:
                await self._close()

    async def ended(self) -> None:
        """Wait until the render loop gives up. Raises ContextError: the worker cannot be restarted."""
        assert self._task is not None
        await asyncio.wait([self._task])
        if not self._task.cancelled():
            self._task.result()

    async def stop(self) -> None:
        """Close the worker and end the threads; the present picture gets half a second."""
        if self._task is None:
            return
        self._stopping = True
        for task in (self._task, *self._turning):
            task.cancel()
        await asyncio.gather(self._task, *self._turning, return_exceptions=True)
        self._task = None
        await self._close()

    async def _close(self) -> None:
        self.worker.cancel()
        try:
            await self.worker.close()
        except Exception:  # its driver is gone, or its objects are: the process ends anyway
            log.exception("%s could not be closed", self.worker.name)
        if self._owner is None:
            self.encoder.close()

    # -------------------------------------------------------------------------------------------------------- clients

    def add(self, client: ClientStream) -> None:
        """Draw for a client from now on."""
        self.clients[client.number] = client
        client.join(self._wake.set)
        self._turns.add(client.address, client, client.cost or None)
        kept = client.session.kept
        if kept is not None and client.solving is not None:  # another render loop has waited for it until now
            client.solving.begin(kept.frame_id, self._wake_up)
        self._wake.set()

    def remove(self, client: ClientStream) -> None:
        """Remove a client; its present picture is cancelled."""
        self.clients.pop(client.number, None)
        self._turns.remove(client.address, client)
        self._leaving.pop(client.number, None)
        if client.solving is not None:
            client.solving.clear()
        if self._ordered is not None and self._ordered.client is client:
            self.worker.cancel()

    def release(self, client: ClientStream, then: Callable[[], None]) -> None:
        """Stop drawing for a client after its present pictures; then call ``then``."""
        self.clients.pop(client.number, None)
        if client in self._turning.values():
            self._leaving[client.number] = then
        else:
            self._turns.remove(client.address, client)
            then()

    def reserve(self, client: ClientStream) -> None:
        """Count a client that moves here once another loop has drawn its present picture."""
        self.clients[client.number] = client

    def cancel_reservation(self, client: ClientStream) -> None:
        """Stop counting a client that was not added."""
        self.clients.pop(client.number, None)

    def drain(self) -> None:
        """Accept no clients until the worker is restarted."""
        self.living = False

    def renew(self) -> None:
        """End the worker in order, and restart it."""
        self.living, self._gone = False, True
        self._wake.set()

    async def pack(self, client: ClientStream, answer: Answer) -> Outgoing:
        """Return the packed reply once its picture is drawn and encoded, and mark it as being sent."""
        session, found = client.session, await self._encoded(client, answer)
        if isinstance(found, Refused):
            request = found.request
            return Outgoing(request, error=session.failed(request, found.code, found.message), ends=found.ends)
        drawn, encoded = found
        request = drawn.taken.request
        client.picture_sent(encoded)
        total = (self.clock() - drawn.taken.arrived) * 1e3
        times = {**drawn.times, "encode": encoded.ms, "total": total}
        self.stages.add(times)
        if request.form == "single-legacy":
            packed = pack_single(request.eyes[0], encoded.pictures[0])
        else:
            assert request.frame_id is not None
            eyes = request.eyes if encoded.video is None else request.eyes[:1]
            depth = [grid.data for grid in drawn.rendered.depth]
            info = drawn.info(encoded, times)
            if client.datagrams is not None and (offer := client.datagrams.offer()) is not None:
                info["datagrams"] = offer
            packed = pack_reply(request.frame_id, eyes, encoded.pictures, info, encoded.alphas, depth)
        nbytes = len(packed) if client.datagrams is None else client.datagrams.link_bytes(len(packed))
        session.sending(request, nbytes, self.clock())
        return Outgoing(request, [packed])

    async def _encoded(self, client: ClientStream, answer: Answer) -> tuple[Drawn, Encoded] | Refused:
        """Return a picture once it is drawn and encoded; it is drawn again where its worker is lost."""
        while not isinstance(answer, Refused):
            if isinstance(answer, Taken):
                answer = await client.redraw(answer)
                continue
            assert isinstance(answer, Drawn)
            taken = answer.taken
            try:
                return answer, await answer.encoded
            except Exception as error:
                taken = replace(taken, losses=taken.losses + 1)
                if isinstance(error, ContextLostError) and taken.losses < _MAX_LOSSES:
                    answer = taken
                else:
                    log.exception("frame %s of client %d could not be encoded", taken.request.frame_id, client.number)
                    answer = Refused(taken.request, "encode", "the picture could not be encoded")
        return answer

    # ---------------------------------------------------------------------------------------------------------- turns

    async def _run(self) -> None:
        while True:
            if self._broken is not None:
                raise self._broken
            if len(self._turning) > 1 or (self._turning and self._gone):
                await asyncio.wait(self._turning, return_when=asyncio.FIRST_COMPLETED)
                continue
            if self._gone:
                await self._revive()
            start = self.clock()
            rests: list[float] = []  # seconds until links take another picture
            client = self._turns.next(partial(self._ready, start, rests), start)
            if client is None:
                self._wake.clear()
                rests += filter(None, [self._turns.rest(start)])
                with suppress(TimeoutError):
                    async with asyncio.timeout(min(rests, default=None)):
                        await self._wake.wait()
                continue
            redraw = client.take_redraw()
            taken = self._take(client) if redraw is None else redraw[0]
            turn = self._turn(taken, None if redraw is None else redraw[1], start, next(reversed(self._turning), None))
            if not self._turning:
                self._drawing_since = start
            self._next.clear()
            self._turning[asyncio.create_task(turn, name="turn")] = client
            await self._next.wait()
            if self.should_yield() and is_software(self.driver):
                await asyncio.sleep(min(_MAX_YIELD_S, _YIELD_FACTOR * (self.clock() - start)))

    async def _turn(
        self, taken: Taken, redraw: asyncio.Future[Answer] | None, start: float, before: asyncio.Task[None] | None
    ) -> None:
        """Answer a request, to ``redraw`` if there is one, after the turn ``before``; charge the client."""
        client = taken.client
        try:
            answer = await self._answer(taken)
            if before is not None:
                await asyncio.wait([before])
            if redraw is None:
                if (client.address, client) in self._turns:
                    client.answers.put_nowait(answer)
            elif not redraw.done():
                redraw.set_result(answer)
            now = self.clock()
            seconds = now - max(start, self._finished)
            own = None if client.member is None else client.member.fair_cost(seconds)
            self._turns.charge(client.address, client, seconds, now, own)
        except Exception as error:
            self._broken = error
        finally:
            self._finished = self.clock()
            self._turning.pop(asyncio.current_task())  # type: ignore[arg-type]
            self._drawing_since = self._finished if self._turning else None
            self._next.set()
            self._wake.set()
        if client not in self._turning.values() and (then := self._leaving.pop(client.number, None)) is not None:
            self._turns.remove(client.address, client)
            then()

    def _ready(self, now: float, rests: list[float], client: ClientStream) -> bool:
        """Return whether a client's picture can be drawn, and its link and the encoder have room for it."""
        session = client.session
        if client.video is not None and self.encoder.full:
            requests = filter(None, (session.newest, session.kept))
            if any(one.options.video is not None for one in requests):
                return False
        if not client.redraws and session.waits_for_picture and (rest := session.rest(now)) > 0:
            rests.append(rest)
            return False
        return client.ready(self._wake_up)

    def _wake_up(self) -> None:
        """Check again whether a picture can be drawn. From any thread."""
        with suppress(RuntimeError):  # the server has stopped
            self._loop.call_soon_threadsafe(self._wake.set)

    def _take(self, client: ClientStream) -> Taken:
        now = self.clock()
        request, waited, solution = client.take(now)
        taken = Taken(client, request, now - waited, request.cameras, client.notice(), solution=solution)
        if request.form != "native" or not client.number:  # older clients know one size; 0 is the server itself
            return taken
        least = _ROOM_FPS if client.member is not None and client.session.config.adapt else None
        timely = self._adaptive_quality.detail(client.number, now, least)
        rung = client.session.rung(request, now)
        detail = timely if rung is None else timely.within(rung)
        cameras = detail.resized(request.cameras)
        return replace(taken, detail=detail, smaller=detail.scale < timely.scale, cameras=cameras)

    # -------------------------------------------------------------------------------------------------------- drawing

    async def _answer(self, taken: Taken) -> Drawn | Taken | Refused:
        job = None
        try:
            if taken.solution is not None and not taken.solution.done():
                await asyncio.wait([asyncio.wrap_future(taken.solution)])
            solved, times = taken.solved()
            job = self._job(taken, solved)
            return await self._draw(taken, job, solved, times)
        except Exception as error:
            others = job is not None and _shows_others(job)
            if not (others and _others_may_be_at_fault(error)):
                return self._failed(taken, error, others)
            taken = self._without_others(taken, error)
        self._drawing_since = self.clock()
        return await self._answer(taken)

    def _job(self, taken: Taken, solved: Solved | None) -> RenderJob:
        """Return the job of a picture: the avatar at its pose, or all people of the room."""
        client, request = taken.client, taken.request
        pose, to_user, cameras, room, words = request.pose, None, taken.cameras, None, [taken.notice, client.label]
        if client.member is not None:
            pose = None
            cameras, room = client.member.look(request, cameras, solved, taken.arrived, self.clock())
            words = [room.words(bool(client.label)) or taken.notice]
        elif solved is not None:
            pose, to_user = solved.pose, solved.to_user
        return RenderJob(
            cameras=cameras,
            pose=pose,
            to_user=to_user,
            frame_id=request.frame_id,
            options=taken.options,
            avatar=client.shown.name,
            room=room,
            viewer=client.number,
            detail=taken.detail.bias,
            notice=", ".join(filter(None, words)),
            mark=client.session.mark,
            others=0.0 if taken.alone else self._faults.others(client.address, self.clock()),
        )

    async def _draw(self, taken: Taken, job: RenderJob, solved: Solved | None, times: dict[str, float]) -> Drawn:
        """Draw a picture and start its encoding. Raises the worker's errors."""
        client, start = taken.client, self.clock()
        if (client.address, client) not in self._turns:
            raise BudgetError("the picture is no longer wanted", "abandoned")
        video = client.video if job.options.video is not None else None
        self._ordered = taken
        try:
            pixels = video is not None or bool(client.observers)
            rendered = await self.worker.draw(job, pixels, submitted=self._next.set)
        finally:
            if self._ordered is taken:
                self._ordered = None
        now = self.clock()
        took = now - max(start, self._finished)
        encoded = rendered.encoded
        if encoded is None:
            if len(rendered.images) == len(taken.request.eyes):
                submitted = self.encoder.submit(rendered, job.options, video, client.picture_drawn)
                encoded = asyncio.wrap_future(submitted)
                if video is not None:
                    encoded.add_done_callback(partial(self._charge_coding, client))
            elif rendered.done is not None:
                rendered.done()
        self._adaptive_quality.drawn(client.number, took, rendered.coarsest, now, taken.smaller)
        client.picture_took(took)
        if encoded is None or len(rendered.images) != len(taken.request.eyes):
            raise RuntimeError(f"{len(taken.request.eyes)} pictures were requested, {len(rendered.images)} drawn")
        if client.member is not None:
            client.member.posed(rendered.posed)
        self.failures = 0
        times = {
            "wait": (start - taken.arrived) * 1e3 - times.get("ik", 0.0),  # solving does not count as waiting
            **times,
            "render": (now - start) * 1e3,
            **{name: ms for name, ms in rendered.timings.items() if name not in ("render", "total")},
        }
        return Drawn(taken, job, rendered, encoded, times, self.driver, solved)

    def _charge_coding(self, client: ClientStream, coding: asyncio.Future[Encoded]) -> None:
        """Charge a client for a picture of its video, which took as long as drawing; not once it has left this loop."""
        done = not coding.cancelled() and coding.exception() is None
        if done and coding.result().video is not None and (client.address, client) in self._turns:
            self._turns.charge(client.address, client, coding.result().ms / 1e3, self.clock())

    # -------------------------------------------------------------------------------------------------------- failures

    def _without_others(self, taken: Taken, error: Exception) -> Taken:
        """Return the picture without the room's other people, and suspect them for a while."""
        number, client = taken.request.frame_id, taken.client
        log.warning("frame %s of client %d is drawn alone, without other people: %s", number, client.number, error)
        self._faults.suspect_others(client.address, self.clock(), slow=isinstance(error, BudgetError))
        return replace(taken, alone=True)

    def _failed(self, taken: Taken, error: Exception, others: bool) -> Taken | Refused:
        """Return the answer to a request whose picture failed; ``others``: it had other people of a room in it."""
        client, request, again, ends = taken.client, taken.request, None, ""
        if isinstance(error, PoseError):
            return Refused(request, "bad_pose", str(error))
        if isinstance(error, BudgetError):
            self._adaptive_quality.refused(client.number, self.clock())
            return Refused(request, error.code, str(error), self._over_budget(client, request, error))
        if isinstance(error, FormatError) and self._owner is not None and self._owner.elsewhere(self, client):
            again = taken
        elif isinstance(error, ContextLostError):
            again, ends = self._lost_while_drawing(taken, error, others)
            self._worker_lost()
        number = request.frame_id
        if again is not None:
            log.warning("frame %s of client %d is drawn again: %s: %s", number, client.number, self.worker.name, error)
            return again
        self.failures += 1
        trace = None if isinstance(error, GlsplatError) else error
        log.error("frame %s of client %d could not be drawn: %s", number, client.number, error, exc_info=trace)
        return Refused(request, "render", "the picture could not be drawn", ends)  # no details: they may name files

    def _lost_while_drawing(self, taken: Taken, error: ContextLostError, others: bool) -> tuple[Taken | None, str]:
        """Return the picture to redraw or None, and the reason to disconnect or "".

        Clients whose pictures repeatedly crash workers are disconnected.
        """
        address, now = taken.client.address, self.clock()
        taken, ends, again = replace(taken, losses=taken.losses + 1), "", self._owner is not None
        blames = error.blames or self._owner is None  # a single worker: every loss stops all clients
        if blames or taken.losses > 1 or self._faults.suspects(address, now):
            if others:
                taken, again = self._without_others(taken, error), True
            elif self._faults.again(address, now):
                ends = "pictures that the renderer does not survive"
        return (taken if again and not ends and taken.losses < _MAX_LOSSES else None), ends

    def _over_budget(self, client: ClientStream, request: Request, error: BudgetError) -> str:
        """Return why a picture over its budget ends the connection; "" if it does not."""
        if error.code == "too_slow":
            log.warning("frame %s of client %d took too long and was dropped", request.frame_id, client.number)
            return "pictures that take too long" if self._faults.again(client.address, self.clock()) else ""
        if error.code == "too_costly":
            return "too many pictures that cost too much" if client.session.overspent(self.clock()) else ""
        return ""

    def _worker_lost(self) -> None:
        """Restart the worker as soon as the present picture is answered."""
        if self._stopping or self._gone:
            return
        self._gone, self.living = True, False
        self.rebuilds += 1
        log.warning("%s is lost; starting a new one", self.worker.name)
        if self._owner is not None:
            self._owner.lost(self)
            self.clients.clear()  # and the reservations
        self._wake.set()

    async def _revive(self) -> None:
        """Restart the worker, with any number of attempts; without an owner raise the last of a few errors."""
        for pause in chain(_REVIVE_PAUSES_S, repeat(_REVIVE_PERIOD_S)):
            await asyncio.sleep(pause)
            try:
                self.driver = await self.worker.rebuild()
                break
            except GlsplatError as error:
                self.attempts += 1
                log.warning("%s cannot be restarted: %s", self.worker.name, error)
                if self._owner is not None:
                    self._owner.failed(self, error)
                elif self.attempts >= len(_REVIVE_PAUSES_S):
                    raise
        self.attempts = self.failures = 0
        self._gone, self.living = False, True
        if self._owner is not None:
            self._turns = FairQueue()  # its clients have left: nobody is charged for the time of the loss
            self._owner.opened(self)


def _shows_others(job: RenderJob) -> bool:
    """Return whether a picture has other people of a room in it."""
    room = job.room if job.others else None
    return room is not None and any(person.key != room.viewer and person.opacity > 0 for person in room.people)


def _others_may_be_at_fault(error: Exception) -> bool:
    """Return whether to draw a picture again without the other people in it.

    The cost of their splats is limited beforehand (``others_share``), so ``too_costly`` is the viewer's own fault.
    """
    own = isinstance(error, PoseError | FormatError | ContextLostError)
    return not own and getattr(error, "code", "") not in ("too_costly", "abandoned")
