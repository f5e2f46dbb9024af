"""The render loop: takes the clients' requests in fair turns, has them drawn one by one, and says what each picture is.

The event loop only passes things on. Each client gets its pictures in order, at most its window of them under way.
What draws is local_loop.py's (threads of this process) or workers/remote_loop.py's (another process, anywhere).
"""

from __future__ import annotations

import asyncio
import logging
import time
from abc import ABC, abstractmethod
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from typing import Any

from glsplat.errors import BudgetError, ContextLostError, FormatError, GlsplatError, PoseError
from glsplat.gl.software import is_software
from glsplat.net.backend import AvatarInfo, PoseSolver, Rendered, RenderJob
from glsplat.net.client_stream import ANYTHING, ClientStream, Frame
from glsplat.net.codec.encode import Encoded
from glsplat.net.guard.fault_tracker import FaultTracker
from glsplat.net.messages import Request
from glsplat.net.pace.adaptive_quality import AdaptiveQuality
from glsplat.net.pace.fair_queue import FairQueue
from glsplat.net.pace.stages import StageTimes
from glsplat.net.pose_queue import PoseQueue
from glsplat.net.reply import pack_reply, pack_single
from glsplat.net.session import Session

__all__ = ["ClientStream", "RenderLoop"]

log: logging.Logger = logging.getLogger("glsplat.net")

_SICK = 3  # pictures in a row that failed before /healthz says so
_YIELD_FACTOR = 9.0  # pause after a picture while others need the processor, in times of what it took
_MAX_YIELD_S = 1.0
_STUCK = 10.0  # seconds a picture may take before /healthz says so


class RenderLoop(ABC):
    """The turns of the clients, and what is said with each picture. What draws is the subclass's."""

    restart: None = None  # there are no workers to restart
    codecs: tuple[str, ...] = ()  # of video

    def __init__(self, clock: Callable[[], float] = time.perf_counter, rate: float | None = None) -> None:
        self.driver: str = ""
        self.stages: StageTimes = StageTimes()
        self.failures: int = 0  # in a row
        self.rebuilds: int = 0  # contexts lost and made anew
        self.should_yield: Callable[[], bool] = lambda: False  # whether others need the processor that draws
        self._clock = clock
        self._adaptive_quality = AdaptiveQuality(rate)
        self._drawing: ClientStream | None = None
        self._drawing_since: float | None = None
        self._stopping = False
        self._turns: FairQueue[ClientStream] = FairQueue()
        self._leaving: dict[int, Callable[[], None]] = {}  # clients by their number, once their picture is drawn
        self._blame = FaultTracker()
        self._wake = asyncio.Event()
        self._loop: asyncio.AbstractEventLoop
        self._solve_thread = ThreadPoolExecutor(1, thread_name_prefix="solve")
        self._task: asyncio.Task[None] | None = None

    @abstractmethod
    async def _open(self) -> str:
        """Start what draws; returns the driver string. Raises GlsplatError."""

    @abstractmethod
    async def _rebuild(self) -> None:
        """Bring back what draws, which is lost; clients keep their connection. Raises ContextError if that fails."""

    @abstractmethod
    async def _close(self) -> None:
        """End it."""

    @abstractmethod
    async def _picture(self, frame: Frame) -> Awaitable[Encoded]:
        """Draw, and have it encoded meanwhile. Calls ``_job`` and ``_note``; raises what a renderer raises."""

    def workers(self) -> list[dict[str, Any]] | None:
        """Return ``workers`` of /stats."""
        return None

    @property
    def drawing_for(self) -> float:
        """Seconds the picture in hand has taken so far; 0: none is."""
        return 0.0 if self._drawing_since is None else self._clock() - self._drawing_since

    @property
    def healthy(self) -> bool:
        """False once several pictures in a row failed, one takes far too long, or the render loop has ended."""
        stuck = self.drawing_for > _STUCK
        return self.failures < _SICK and not stuck and self._task is not None and not self._task.done()

    async def start(self) -> None:
        """Open what draws. Raises what it raises, after ending the threads."""
        self._loop = asyncio.get_running_loop()
        try:
            self.driver = await self._open()
        except BaseException:
            self._end_threads()
            raise
        self._task = asyncio.create_task(self._run(), name="render loop")

    async def ended(self) -> None:
        """Wait until the render loop gives up. Raises ContextError: the context is lost and cannot be made again."""
        assert self._task is not None
        await asyncio.wait([self._task])
        if not self._task.cancelled():
            self._task.result()

    async def stop(self) -> None:
        """Close what draws, end the threads; the picture in hand gets half a second."""
        if self._task is None:
            return
        self._stopping = True
        self._task.cancel()
        await asyncio.gather(self._task, return_exceptions=True)
        self._task = None
        try:
            await self._close()
        except Exception:  # the driver is gone, or its objects are: the process ends anyway
            log.exception("the renderer could not be closed")
        finally:
            self._end_threads()

    def open(
        self,
        number: int,
        session: Session,
        solver: PoseSolver | None = None,
        address: str = "",
        shown: AvatarInfo = ANYTHING,
    ) -> ClientStream:
        """Return a client that is ``shown`` an avatar, with what solves its tracking; ``add`` lets it take part."""
        solving = None if solver is None else PoseQueue(solver, self._solve_thread, self._clock)
        return ClientStream(number, session, solving, address, shown)

    def add(self, channel: ClientStream) -> None:
        """Let a client take part."""
        self._turns.add(channel.address, channel, channel.cost or None)
        kept = channel.session.kept
        if kept is not None and channel.solving is not None:  # another render loop has waited for it until now
            channel.solving.begin(kept.frame_id, self._solved)
        self._wake.set()

    def remove(self, channel: ClientStream) -> None:
        """Forget a client; a picture of it that is being drawn is given up, or thrown away."""
        self._turns.remove(channel.address, channel)
        self._leaving.pop(channel.number, None)
        if channel.solving is not None:
            channel.solving.clear()

    def received(self, channel: ClientStream, request: Request | None) -> None:
        """A message of this client was taken: the tracking of a ``request`` is solved while others are drawn."""
        if request is not None and request.tracking is not None and channel.solving is not None:
            channel.solving.add(request if channel.member is None else channel.member.meeting(request))
        if request is not None and channel.member is not None:
            channel.member.received(request, self._clock())
        self.wake(channel)

    def release(self, channel: ClientStream, then: Callable[[], None]) -> None:
        """Draw no more for a client, whose picture in hand is drawn to its end first; ``then`` is called after it."""
        if self._drawing is channel:
            self._leaving[channel.number] = then
        else:
            self._turns.remove(channel.address, channel)
            then()

    def wake(self, channel: ClientStream) -> None:
        """Something came of it: a request, or room in its window."""
        if channel.again is not None or channel.session.waits_for_picture:
            self._wake.set()

    async def pack(self, channel: ClientStream, frame: Frame) -> list[bytes] | str:
        """The messages of a frame: binary ones to send, or the text of an error. Marks them as being sent."""
        request, session = frame.request, channel.session
        if frame.encoded is None:
            return session.failed(request, *frame.error)
        try:
            encoded = await frame.encoded
        except Exception:
            log.exception("frame %s of client %d could not be encoded", request.frame_id, channel.number)
            return session.failed(request, "encode", "the picture could not be encoded")
        frame.times["encode"] = encoded.ms
        if encoded.video is not None:  # which takes as long as drawing, of the cores that draw
            self._turns.charge(channel.address, channel, encoded.ms / 1e3, self._clock())
        if encoded.pictures:
            channel.newest = encoded if encoded.video is None else None
        frame.times["total"] = (self._clock() - frame.arrived) * 1e3
        self.stages.add(frame.times)
        if request.form == "single-legacy":
            packed = pack_single(request.eyes[0], encoded.pictures[0])
        else:
            assert request.frame_id is not None
            eyes = request.eyes if encoded.video is None else request.eyes[:1]
            depth = [grid.data for grid in frame.depth]
            info = frame.info(encoded)
            if channel.way is not None and (offer := channel.way.offer()) is not None:
                info["datagrams"] = offer
            packed = pack_reply(request.frame_id, eyes, encoded.pictures, info, encoded.alphas, depth)
        nbytes = len(packed) if channel.way is None else channel.way.on_the_way(len(packed))
        session.sending(request, nbytes, self._clock())
        return [packed]

    async def _run(self) -> None:
        while True:
            await self._stand_by()
            start = self._clock()
            rests: list[float] = []  # seconds that clients wait whose links take nothing yet
            channel = self._turns.next(partial(self._ready, start, rests), start)
            if channel is None:
                self._wake.clear()
                rests += filter(None, [self._turns.rest(start)])
                with suppress(TimeoutError):
                    async with asyncio.timeout(min(rests, default=None)):
                        await self._wake.wait()
                continue
            self._drawing, self._drawing_since = channel, start
            try:
                await self._draw_one(channel)
            finally:
                self._drawing = self._drawing_since = None
            now = self._clock()
            own = None if channel.member is None else channel.member.fair_cost(now - start)
            self._turns.charge(channel.address, channel, now - start, now, own)
            if (then := self._leaving.get(channel.number)) is not None:
                self._turns.remove(channel.address, channel)
                del self._leaving[channel.number]
                then()
            if self.should_yield() and is_software(self.driver):
                await asyncio.sleep(min(_MAX_YIELD_S, _YIELD_FACTOR * (now - start)))

    def _ready(self, now: float, rests: list[float], channel: ClientStream) -> bool:
        """Whether a client's picture can be drawn, and its link would take it."""
        if channel.again is None and channel.session.waits_for_picture and (rest := channel.session.rest(now)) > 0:
            rests.append(rest)
            return False
        return channel.ready(self._solved)

    async def _stand_by(self) -> None:
        """Wait until there is something to draw with."""
        return

    def _solved(self) -> None:
        """A request can be drawn. On the solving thread."""
        with suppress(RuntimeError):  # the server has stopped
            self._loop.call_soon_threadsafe(self._wake.set)

    def _abandoned(self) -> bool:
        """Nobody waits for the picture in hand any more. On any thread."""
        drawing = self._drawing
        return self._stopping or (drawing is not None and (drawing.address, drawing) not in self._turns)

    async def _draw_one(self, channel: ClientStream) -> None:
        frame, channel.again = channel.again or self._next_frame(channel), None
        error = await self._attempt(frame)
        if error is not None and self._suspects_others(frame, error):
            self._suspect_others(frame, error)
            if isinstance(error, ContextLostError):
                await self._rebuild()
            self._drawing_since = self._clock()
            error = await self._attempt(frame)
        if isinstance(error, PoseError):
            frame.error = ("bad_pose", str(error))
        elif isinstance(error, BudgetError):
            self._adaptive_quality.refused(channel.number, self._clock())
            frame.error = (error.code, str(error))
            frame.ends = self._over_budget(channel, frame.request, error)
        elif error is not None:
            self._failed(channel, frame, error)
        if frame.again is not None:
            if not frame.again.done():
                frame.again.set_result(None)
        elif (channel.address, channel) in self._turns:
            channel.frames.put_nowait(frame)
        if isinstance(error, ContextLostError):
            await self._rebuild()

    async def _attempt(self, frame: Frame) -> Exception | None:
        """Draw a frame; returns what kept it from being drawn."""
        frame.driver, frame.error = self.driver, ("", "")
        try:
            frame.encoded, self.failures = await self._picture(frame), 0
        except Exception as error:
            return error
        return None

    def _suspects_others(self, frame: Frame, error: Exception) -> bool:
        """Whether a picture may have gone wrong because of the others of a room in it: it is then drawn without them.

        What their splats cost is limited beforehand (backends/room.py), so ``too_costly`` is the viewer's own.
        """
        own = isinstance(error, (PoseError, FormatError)) or getattr(error, "code", "") in ("too_costly", "abandoned")
        return frame.shows_others and not own

    def _suspect_others(self, frame: Frame, error: Exception) -> None:
        number, frame.alone = frame.request.frame_id, True
        log.warning("frame %s of client %d is drawn without the others: %s", number, frame.channel.number, error)
        self._blame.suspect_others(frame.channel.address, self._clock(), slow=isinstance(error, BudgetError))

    def _next_frame(self, channel: ClientStream) -> Frame:
        request, waited, solution = channel.take(self._clock())
        arrived, times = self._clock() - waited, {"wait": waited * 1e3}
        frame = Frame(channel, request, arrived, times, request.cameras, channel.notice(), solution=solution)
        if request.form == "native" and channel.number:  # older clients know one size; 0 is the server itself
            timely = self._adaptive_quality.detail(channel.number, self._clock())
            rung = channel.session.rung(request, self._clock())
            frame.detail = timely if rung is None else timely.within(rung)
            frame.smaller = frame.detail.scale < timely.scale
            frame.cameras = frame.detail.resized(request.cameras)
        return frame

    def _failed(self, channel: ClientStream, frame: Frame, error: Exception) -> None:
        """A picture could not be drawn, through no fault of its request's form."""
        self._refuse(channel, frame, error)
        if isinstance(error, ContextLostError) and self._blame.again(channel.address, self._clock()):
            frame.ends = "pictures that the renderer does not survive"

    def _refuse(self, channel: ClientStream, frame: Frame, error: Exception) -> None:
        self.failures += 1
        log.error(
            "frame %s of client %d could not be drawn: %s",
            *(frame.request.frame_id, channel.number, error),
            exc_info=None if isinstance(error, GlsplatError) else error,
        )
        frame.error = ("render", "the picture could not be drawn")  # no details: they may name files

    def _over_budget(self, channel: ClientStream, request: Request, error: BudgetError) -> str:
        """Why that ends the connection, or nothing. Only what a client asked for is at fault, so nothing is rebuilt."""
        if error.code == "too_slow":
            log.warning("frame %s of client %d took too long; it is abandoned", request.frame_id, channel.number)
            return "pictures that take too long" if self._blame.again(channel.address, self._clock()) else ""
        if error.code == "too_costly":
            return "too many pictures that cost too much" if channel.session.overspent(self._clock()) else ""
        return ""

    def _job(self, frame: Frame) -> RenderJob:
        """What is to be drawn, at the pose that tracking came to, or everybody of the room.

        Raises PoseError where tracking is not solved.
        """
        request, channel = frame.request, frame.channel
        pose, cameras, room, solved, place = request.pose, frame.cameras, None, None, None
        if request.tracking is not None:
            if frame.solution is None:
                raise PoseError(channel.untracked)
            solved, frame.times["ik"] = frame.solution.result()
            frame.notes = solved.notes
        if channel.member is not None:
            pose = None
            cameras, room = channel.member.look(request, cameras, solved, frame.arrived, self._clock())
        elif solved is not None:
            pose, place = solved.pose, solved.place
            frame.drawn = tuple(map(solved.seen, cameras))
        frame.job = job = RenderJob(
            cameras=cameras,
            pose=pose,
            place=place,
            frame_id=request.frame_id,
            options=frame.options,
            avatar=channel.shown.name,
            room=room,
            viewer=channel.number,
            detail=frame.detail.bias,
            label=channel.label,
            notice=frame.notice,
            mark=channel.session.mark,
            others=0.0 if frame.alone else self._blame.others(channel.address, self._clock()),
        )
        return job

    def _begin(self, frame: Frame) -> float:
        """The time at which drawing begins."""
        start = self._clock()
        frame.times["wait"] = (start - frame.arrived) * 1e3 - frame.times.get("ik", 0.0)  # solving is no waiting
        return start

    def _note(self, frame: Frame, rendered: Rendered, start: float) -> None:
        """What is known of a picture once it is drawn."""
        now = self._clock()
        frame.times["render"] = (now - start) * 1e3
        frame.levels = rendered.levels
        self._adaptive_quality.drawn(frame.channel.number, now - start, rendered.coarsest, now, frame.smaller)
        if len(rendered.images) != len(frame.request.eyes):
            raise RuntimeError(f"{len(frame.request.eyes)} pictures were asked for, {len(rendered.images)} drawn")
        frame.places = {name: [round(v, 5) for v in place] for name, place in rendered.places.items()}
        frame.depth = rendered.depth
        if frame.channel.member is not None:
            frame.channel.member.posed(rendered.posed)
        frame.times |= {name: ms for name, ms in rendered.timings.items() if name not in ("render", "total")}

    def _end_threads(self) -> None:
        self._solve_thread.shutdown(wait=False, cancel_futures=True)
