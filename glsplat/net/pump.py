"""The frame pump: takes the clients' requests in fair turns, draws on one thread, encodes while the next is drawn.

The event loop only passes things on. One thread owns the renderer (an OpenGL context belongs to a thread); a few more
encode. Each client gets its pictures in order, at most its window of them under way.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Awaitable, Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

from glsplat.camera import Camera
from glsplat.errors import BudgetError, ContextError, ContextLostError, GlsplatError, PoseError
from glsplat.net.backend import Backend, Interruptible, Offered, PoseSolver, Rendered
from glsplat.net.codec.encode import Encoded, Encoder
from glsplat.net.guard.blame import Blame
from glsplat.net.guard.limits import Share
from glsplat.net.messages import RenderRequest, eye_fields
from glsplat.net.pace.governor import FULL, Detail, Governor
from glsplat.net.pace.stages import StageTimes
from glsplat.net.pace.turns import Turns
from glsplat.net.reply import pack_reply, pack_single
from glsplat.net.session import Session
from glsplat.net.solving import Solution, Solving

__all__ = ["Channel", "FramePump"]

log: logging.Logger = logging.getLogger("glsplat.net")

_SICK = 3  # pictures in a row that failed before /healthz says so
_STUCK = 10.0  # seconds a picture may take before /healthz says so
_PAUSES = (0.0, 0.5, 1.0)  # seconds before each attempt to make a new context; then the pump gives up
_ANYTHING = Offered(name="")
_GRACE = 0.5  # seconds the picture in hand gets when the server stops


@dataclass(eq=False, slots=True)
class Frame:
    """One picture on its way from the renderer to the socket."""

    request: RenderRequest
    arrived: float  # clock seconds
    times: dict[str, float]  # ms
    encoded: Awaitable[Encoded] | None = None  # None: it could not be drawn
    error: tuple[str, str] = ("", "")  # code and message in that case
    notes: tuple[str, ...] | None = None  # of the tracking solver
    drawn: tuple[Camera, ...] | None = None  # the eyes in the avatar's space, where tracking was solved
    box: list[float] | None = None  # of the avatar in the client's room, where it was asked for
    untracked: str = ": send pose instead of tracking"  # what is said where tracking is not solved
    ends: str = ""  # why the connection ends after this answer and its address is held off, if it does
    detail: Detail = FULL  # less than was asked for, where a rate is held
    levels: tuple[int, ...] = ()  # of detail that were drawn


@dataclass(eq=False, slots=True)
class Channel:
    """One client as the pump sees it."""

    number: int
    session: Session
    solving: Solving | None = None  # None: this server solves no tracking
    address: str = ""  # what has a fair share of the renderer's time
    shown: Offered = _ANYTHING
    share: Share | None = None  # of the time for reading and solving; None: no limit
    frames: asyncio.Queue[Frame] = field(default_factory=asyncio.Queue)  # bounded by the session's window

    def ready(self, solved: Callable[[], None]) -> bool:
        """True while a request can be drawn without waiting for its tracking.

        Where none is solved yet, the newest is from now on, and ``solved`` is called (on any thread) once it is: under
        a stream of samples that are all newer, waiting for the newest would never end.
        """
        session, newest = self.session, self.session.newest
        if not session.ready():
            return False
        if self.solving is None or (newest is not None and self._solved(newest)):
            return True
        if session.kept is None:
            assert newest is not None
            session.keep()
            self.solving.begin(newest.frame_id, solved)
        return self._solved(session.kept)

    def take(self, now: float) -> tuple[RenderRequest, float, Solution | None]:
        """The newest request that is ready, the seconds it waited, and its solution."""
        newest = self.session.newest
        kept = self.solving is not None and (newest is None or not self._solved(newest))
        taken = self.session.next_request(now, kept)
        assert taken is not None
        request, waited = taken
        return request, waited, None if self.solving is None else self.solving.take(request.frame_id)

    def _solved(self, request: RenderRequest | None) -> bool:
        solving = self.solving
        return request is None or request.tracking is None or solving is None or solving.solved(request.frame_id)


class FramePump:
    """Owns the render thread, the encoders and the turn of the clients."""

    def __init__(
        self, backend: Backend, clock: Callable[[], float] = time.perf_counter, rate: float | None = None
    ) -> None:
        self.driver: str = ""
        self.stages: StageTimes = StageTimes()
        self.failures: int = 0  # in a row
        self.rebuilds: int = 0  # contexts lost and made anew
        self._backend = backend
        self._clock = clock
        self._governor = Governor(rate)
        self._drawing: Channel | None = None
        self._drawing_since: float | None = None
        self._stopping = False
        self._turns: Turns[Channel] = Turns()
        self._blame = Blame()
        self._wake = asyncio.Event()
        self._loop: asyncio.AbstractEventLoop
        self._render_thread = ThreadPoolExecutor(1, thread_name_prefix="render")
        self._solve_thread = ThreadPoolExecutor(1, thread_name_prefix="solve")
        self._encode_threads = ThreadPoolExecutor(2, thread_name_prefix="frame")
        self._encoder = Encoder()
        self._task: asyncio.Task[None] | None = None
        if isinstance(backend, Interruptible):
            backend.abandoned = self._abandoned

    @property
    def drawing_for(self) -> float:
        """Seconds the picture in hand has taken so far; 0: none is."""
        return 0.0 if self._drawing_since is None else self._clock() - self._drawing_since

    @property
    def healthy(self) -> bool:
        """False once several pictures in a row failed, one takes far too long, or the pump has ended."""
        stuck = self.drawing_for > _STUCK
        return self.failures < _SICK and not stuck and self._task is not None and not self._task.done()

    async def start(self) -> None:
        """Open the backend on the render thread. Raises what it raises, after ending the threads."""
        loop = asyncio.get_running_loop()
        try:
            self.driver = await loop.run_in_executor(self._render_thread, self._backend.open)
        except BaseException:
            self._end_threads()
            raise
        self._loop = loop
        self._task = asyncio.create_task(self._run(), name="frame pump")

    async def ended(self) -> None:
        """Wait until the pump gives up. Raises ContextError: the context is lost and cannot be made again."""
        assert self._task is not None
        await asyncio.wait([self._task])
        if not self._task.cancelled():
            self._task.result()

    async def stop(self) -> None:
        """Close the backend, end the threads; the picture in hand gets half a second."""
        if self._task is None:
            return
        self._stopping = True
        self._task.cancel()
        await asyncio.gather(self._task, return_exceptions=True)
        self._task = None
        closing = asyncio.get_running_loop().run_in_executor(self._render_thread, self._backend.close)
        try:
            done, _ = await asyncio.wait([closing], timeout=_GRACE)
            if not done and isinstance(self._backend, Interruptible):
                self._backend.kill()
            await closing
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
        shown: Offered = _ANYTHING,
    ) -> Channel:
        """A client who is ``shown`` that, with what solves its tracking; it takes part once it is added."""
        solving = None if solver is None else Solving(solver, self._solve_thread, self._clock)
        return Channel(number, session, solving, address, shown)

    def add(self, channel: Channel) -> None:
        """Let a client take part."""
        self._turns.add(channel.address, channel)

    def remove(self, channel: Channel) -> None:
        """Forget a client; a picture of it that is being drawn is given up, or thrown away."""
        self._turns.remove(channel.address, channel)
        if channel.solving is not None:
            channel.solving.clear()

    def received(self, channel: Channel) -> None:
        """A message of this client was taken: its tracking is solved while others are drawn."""
        request = channel.session.accepted
        if request is not None and request.tracking is not None and channel.solving is not None:
            channel.solving.add(request)
        self._wake.set()

    def wake(self) -> None:
        """A window has room again."""
        self._wake.set()

    async def pack(self, channel: Channel, frame: Frame) -> list[bytes] | str:
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
        frame.times["total"] = (self._clock() - frame.arrived) * 1e3
        self.stages.add(frame.times)
        session.sending(request)
        if request.form == "single-legacy":
            return [pack_single(request.eyes[0], encoded.pictures[0])]
        assert request.frame_id is not None
        first = request.cameras[0]
        info: dict[str, Any] = {
            "t": request.t,
            "times": {name: round(ms, 3) for name, ms in frame.times.items()},
            "size": (first.width, first.height),
            "eyes": [eye_fields(camera) for camera in request.cameras],
            "crop": encoded.boxes,
            "dropped": session.counts.dropped,
            "driver": self.driver,
        }
        if frame.notes is not None:
            info["tracking"] = frame.notes
        drawn = None if frame.drawn is None else [eye_fields(camera) for camera in frame.drawn]
        if drawn is not None and drawn != info["eyes"]:
            info["drawn"] = drawn
        if channel.shown.still and request.pose is not None:
            info["still"] = channel.shown.still
        if frame.box is not None:
            info["box"] = frame.box
        if any(frame.levels) or frame.detail != FULL:
            info["detail"] = {"levels": frame.levels, "bias": frame.detail.bias, "scale": frame.detail.scale}
        if request.alpha == "straight":
            info["alpha"] = request.alpha
        return [pack_reply(request.frame_id, request.eyes, encoded.pictures, info, encoded.alphas)]

    async def _run(self) -> None:
        while True:
            start = self._clock()
            channel = self._turns.next(lambda channel: channel.ready(self._solved), start)
            if channel is None:
                self._wake.clear()
                with suppress(TimeoutError):
                    async with asyncio.timeout(self._turns.rest(start) or None):
                        await self._wake.wait()
                continue
            self._drawing, self._drawing_since = channel, start
            try:
                await self._draw_one(channel)
            finally:
                self._drawing = self._drawing_since = None
            now = self._clock()
            self._turns.charge(channel.address, channel, now - start, now)

    def _solved(self) -> None:
        """A request can be drawn. On the solving thread."""
        with suppress(RuntimeError):  # the server has stopped
            self._loop.call_soon_threadsafe(self._wake.set)

    def _abandoned(self) -> bool:
        """Nobody waits for the picture in hand any more. On any thread."""
        drawing = self._drawing
        return self._stopping or (drawing is not None and (drawing.address, drawing) not in self._turns)

    async def _draw_one(self, channel: Channel) -> None:
        loop = asyncio.get_running_loop()
        request, waited, solution = channel.take(self._clock())
        frame = Frame(request, self._clock() - waited, {"wait": waited * 1e3})
        if request.form == "native":  # older clients know one size
            frame.detail = self._governor.detail(channel.number, self._clock())
        frame.request = replace(frame.detail.of(request), viewer=channel.number, mark=channel.session.mark)
        if why := channel.shown.untracked:
            frame.untracked = f" for what it shows: {why}"
        lost = False
        try:
            encoded = await loop.run_in_executor(self._render_thread, self._draw, frame, solution)
            self.failures = 0
            frame.encoded = asyncio.wrap_future(encoded)
        except PoseError as error:
            frame.error = ("bad_pose", str(error))
        except BudgetError as error:
            self._governor.refused(channel.number, self._clock())
            frame.error = (error.code, str(error))
            frame.ends = self._over_budget(channel, request, error)
        except Exception as error:
            lost = isinstance(error, ContextLostError)
            self.failures += 1
            log.error(
                "frame %s of client %d could not be drawn: %s",
                *(request.frame_id, channel.number, error),
                exc_info=not isinstance(error, GlsplatError),
            )
            frame.error = ("render", "the picture could not be drawn")  # no details: they may name files
            if lost and self._blame.again(channel.address, self._clock()):
                frame.ends = "pictures that the renderer does not survive"
        if (channel.address, channel) in self._turns:
            channel.frames.put_nowait(frame)
        if lost:
            await self._rebuild()

    def _over_budget(self, channel: Channel, request: RenderRequest, error: BudgetError) -> str:
        """Why that ends the connection, or nothing. Only what a client asked for is at fault, so nothing is rebuilt."""
        if error.code == "too_slow":
            log.warning("frame %s of client %d took too long; it is abandoned", request.frame_id, channel.number)
            return "pictures that take too long" if self._blame.again(channel.address, self._clock()) else ""
        if error.code == "too_costly":
            return "too many pictures that cost too much" if channel.session.overspent(self._clock()) else ""
        return ""

    async def _rebuild(self) -> None:
        """A new context and everything in it; clients keep their connection.

        Raises ContextError if none can be made that draws a plain picture: no client's requests bring that about.
        """
        log.warning("the OpenGL context is lost; making a new one")
        for pause in _PAUSES:
            await asyncio.sleep(pause)
            try:
                self.driver = await asyncio.get_running_loop().run_in_executor(self._render_thread, self._reopen)
                break
            except ContextError as error:
                log.warning("there is no new one: %s", error)
                if pause == _PAUSES[-1]:
                    raise
        self.rebuilds += 1
        self.failures = 0  # it has drawn a picture

    def _reopen(self) -> str:
        """On the render thread."""
        try:
            self._backend.close()
        except Exception:
            log.debug("what is left of the lost context cannot be released", exc_info=True)
        return self._backend.open()

    def _draw(self, frame: Frame, solution: Solution | None) -> Future[Encoded]:
        """On the render thread: the pose where tracking was sent, the picture, and its encoding under way."""
        request, scale, floor = frame.request, 1.0, 0.0
        if request.tracking is not None:
            if solution is None:
                raise PoseError(f"this server has no tracking solver{frame.untracked}")
            solved, frame.times["ik"] = solution.result()
            request = replace(request, pose=solved.pose, cameras=solved.cameras)
            cameras = frame.detail.resized(solved.cameras)
            request = replace(request, cameras=cameras)
            frame.notes, frame.drawn = solved.notes, cameras
            scale, floor = solved.scale, solved.floor
        start = self._clock()
        frame.times["wait"] = (start - frame.arrived) * 1e3 - frame.times.get("ik", 0.0)  # solving is no waiting
        rendered = self._backend.render(request)
        done = rendered.done or _nothing
        try:
            took, now = self._clock() - start, self._clock()
            frame.times["render"] = took * 1e3
            frame.levels = rendered.levels
            self._governor.drawn(request.viewer, took, rendered.coarsest, now)
            if len(rendered.images) != len(frame.request.eyes):
                raise RuntimeError(f"{len(frame.request.eyes)} pictures were asked for, {len(rendered.images)} drawn")
            if rendered.box is not None:
                frame.box = [round(v * scale + floor * (i % 3 == 1), 5) for i, v in enumerate(rendered.box)]
            frame.times |= {name: ms for name, ms in rendered.timings.items() if name not in ("render", "total")}
            # from here: the event loop need not hear of it first
            encoded = self._encode_threads.submit(self._encode, rendered, frame.request)
        except BaseException:
            done()
            raise
        # of the future, not of the encoding: one that is cancelled while it waits never begins
        encoded.add_done_callback(lambda _: done())
        return encoded

    def _encode(self, rendered: Rendered, request: RenderRequest) -> Encoded:
        """On an encoding thread."""
        return self._encoder.encode(rendered.images, request.quality, request.crop, rendered.covered, request.alpha)

    def _end_threads(self) -> None:
        self._render_thread.shutdown(wait=False)
        self._solve_thread.shutdown(wait=False, cancel_futures=True)
        self._encode_threads.shutdown(wait=False)
        self._encoder.close()


def _nothing() -> None: ...
