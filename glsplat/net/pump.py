"""The frame pump: takes requests of all clients in turn, draws them on one thread, encodes while the next is drawn.

The event loop only passes things on. One thread owns the renderer (an OpenGL context belongs to a thread); a few more
encode. Each client gets its pictures in order, at most its window of them under way.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections import deque
from collections.abc import Awaitable, Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any

from glsplat.errors import ContextError, GlsplatError, PoseError
from glsplat.net.backend import Backend, PoseSolver, Rendered
from glsplat.net.encode import Encoded, Encoder
from glsplat.net.messages import RenderRequest, eye_fields
from glsplat.net.reply import pack_reply, pack_single
from glsplat.net.session import Session
from glsplat.net.solving import Solution, Solving
from glsplat.net.stages import StageTimes

__all__ = ["Channel", "FramePump"]

log: logging.Logger = logging.getLogger("glsplat.net")

_SICK = 3  # pictures in a row that failed before /healthz says so
_STUCK = 10.0  # seconds a picture may take before /healthz says so
_REBUILDS = 3  # lost contexts in a row, without a picture between them, before the pump gives up


@dataclass(eq=False, slots=True)
class Frame:
    """One picture on its way from the renderer to the socket."""

    request: RenderRequest
    arrived: float  # clock seconds
    times: dict[str, float]  # ms
    encoded: Awaitable[Encoded] | None = None  # None: it could not be drawn
    error: tuple[str, str] = ("", "")  # code and message in that case
    notes: tuple[str, ...] | None = None  # of the tracking solver


@dataclass(eq=False, slots=True)
class Channel:
    """One client as the pump sees it."""

    number: int
    session: Session
    solving: Solving | None = None  # None: this server solves no tracking
    frames: asyncio.Queue[Frame] = field(default_factory=asyncio.Queue)  # bounded by the session's window


class FramePump:
    """Owns the render thread, the encoders and the turn of the clients."""

    def __init__(self, backend: Backend, clock: Callable[[], float] = time.perf_counter) -> None:
        self.driver: str = ""
        self.stages: StageTimes = StageTimes()
        self.failures: int = 0  # in a row
        self.rebuilds: int = 0  # contexts lost and made anew
        self._lost = 0  # of them in a row
        self._backend = backend
        self._clock = clock
        self._drawing_since: float | None = None
        self._turn: deque[Channel] = deque()
        self._wake = asyncio.Event()
        self._render_thread = ThreadPoolExecutor(1, thread_name_prefix="render")
        self._solve_thread = ThreadPoolExecutor(1, thread_name_prefix="solve")
        self._encode_threads = ThreadPoolExecutor(2, thread_name_prefix="frame")
        self._encoder = Encoder()
        self._task: asyncio.Task[None] | None = None

    @property
    def healthy(self) -> bool:
        """False once several pictures in a row failed, one takes far too long, or the pump has ended."""
        stuck = self._drawing_since is not None and self._clock() - self._drawing_since > _STUCK
        return self.failures < _SICK and not stuck and self._task is not None and not self._task.done()

    async def start(self) -> None:
        """Open the backend on the render thread. Raises what it raises, after ending the threads."""
        loop = asyncio.get_running_loop()
        try:
            self.driver = await loop.run_in_executor(self._render_thread, self._backend.open)
        except BaseException:
            self._end_threads()
            raise
        self._task = asyncio.create_task(self._run(), name="frame pump")

    async def ended(self) -> None:
        """Wait until the pump gives up. Raises ContextError: the context is lost and cannot be made again."""
        assert self._task is not None
        await asyncio.wait([self._task])
        if not self._task.cancelled():
            self._task.result()

    async def stop(self) -> None:
        """Finish the picture in hand, close the backend, end the threads."""
        if self._task is None:
            return
        self._task.cancel()
        await asyncio.gather(self._task, return_exceptions=True)
        self._task = None
        try:
            await asyncio.get_running_loop().run_in_executor(self._render_thread, self._backend.close)
        except Exception:  # the driver is gone, or its objects are: the process ends anyway
            log.exception("the renderer could not be closed")
        finally:
            self._end_threads()

    def open(self, number: int, session: Session, solver: PoseSolver | None = None) -> Channel:
        """A client, with what solves its tracking; it takes part once it is added."""
        solving = None if solver is None else Solving(solver, self._solve_thread, self._clock)
        return Channel(number, session, solving)

    def add(self, channel: Channel) -> None:
        """Let a client take part."""
        self._turn.append(channel)

    def remove(self, channel: Channel) -> None:
        """Forget a client; a picture of it that is being drawn is thrown away."""
        if channel in self._turn:
            self._turn.remove(channel)
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
        return [pack_reply(request.frame_id, request.eyes, encoded.pictures, info)]

    async def _run(self) -> None:
        while True:
            channel = self._next()
            if channel is None:
                self._wake.clear()
                await self._wake.wait()
                continue
            self._drawing_since = self._clock()
            await self._draw_one(channel)
            self._drawing_since = None

    def _next(self) -> Channel | None:
        """The next client, in turn, whose request can be drawn."""
        for _ in range(len(self._turn)):
            channel = self._turn[0]
            self._turn.rotate(-1)
            if channel.session.ready():
                return channel
        return None

    async def _draw_one(self, channel: Channel) -> None:
        loop = asyncio.get_running_loop()
        taken = channel.session.next_request(self._clock())
        assert taken is not None
        request, waited = taken
        frame = Frame(request, self._clock() - waited, {"wait": waited * 1e3})
        lost = False
        solution = channel.solving.take(request.frame_id) if channel.solving is not None else None
        try:
            encoded = await loop.run_in_executor(self._render_thread, self._draw, frame, solution)
            self.failures = self._lost = 0
            frame.encoded = asyncio.wrap_future(encoded)
        except PoseError as error:
            frame.error = ("bad_pose", str(error))
        except Exception as error:
            lost = isinstance(error, ContextError)
            self.failures += 1
            log.error(
                "frame %s of client %d could not be drawn: %s",
                *(request.frame_id, channel.number, error),
                exc_info=not isinstance(error, GlsplatError),
            )
            frame.error = ("render", "the picture could not be drawn")  # no details: they may name files
        if channel in self._turn:
            channel.frames.put_nowait(frame)
        if lost:
            await self._rebuild()

    async def _rebuild(self) -> None:
        """A new context and everything in it; clients keep their connection. Raises ContextError if that is no use."""
        self._lost += 1
        if self._lost > _REBUILDS:
            raise ContextError(f"the OpenGL context was lost {self._lost} times in a row; restart the driver")
        log.warning("the OpenGL context is lost; making a new one")
        self.driver = await asyncio.get_running_loop().run_in_executor(self._render_thread, self._reopen)
        self.rebuilds += 1

    def _reopen(self) -> str:
        """On the render thread."""
        try:
            self._backend.close()
        except Exception:
            log.debug("what is left of the lost context cannot be released", exc_info=True)
        return self._backend.open()

    def _draw(self, frame: Frame, solution: Solution | None) -> Future[Encoded]:
        """On the render thread: the pose where tracking was sent, the picture, and its encoding under way."""
        request = frame.request
        if request.tracking is not None:
            if solution is None:
                raise PoseError("this server has no tracking solver: send pose instead of tracking")
            solved, frame.times["ik"] = solution.result()
            request = replace(request, pose=solved.pose, cameras=solved.cameras)
            frame.notes = solved.notes
        start = self._clock()
        frame.times["wait"] = (start - frame.arrived) * 1e3 - frame.times.get("ik", 0.0)  # solving is no waiting
        rendered = self._backend.render(request)
        frame.times["render"] = (self._clock() - start) * 1e3
        if len(rendered.images) != len(frame.request.eyes):
            raise RuntimeError(f"{len(frame.request.eyes)} pictures were asked for, {len(rendered.images)} drawn")
        frame.times |= {name: ms for name, ms in rendered.timings.items() if name not in ("render", "total")}
        # from here: the event loop need not hear of it first
        return self._encode_threads.submit(self._encode, rendered, frame.request)

    def _encode(self, rendered: Rendered, request: RenderRequest) -> Encoded:
        """On an encoding thread."""
        try:
            return self._encoder.encode(rendered.images, request.quality, request.crop, rendered.covered)
        finally:
            if rendered.done is not None:
                rendered.done()

    def _end_threads(self) -> None:
        self._render_thread.shutdown(wait=False)
        self._solve_thread.shutdown(wait=False, cancel_futures=True)
        self._encode_threads.shutdown(wait=False)
        self._encoder.close()
