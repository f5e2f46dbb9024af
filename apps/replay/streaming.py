"""Stream a motion through a server and time every stage, for ``replay`` and ``demo``.

There are three request policies to compare. ``mailbox``: a request at every display refresh, of which the server draws
the newest. ``stop-and-wait``: the next request when both eyes are decoded, as in the paper's released client. ``fifo``:
as many unanswered requests as the window allows, all of which are drawn.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any, Protocol, Unpack

import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera, look_at, stereo_cameras
from glsplat.errors import ProtocolError
from glsplat.net.client import Client
from glsplat.net.flow import ReceivedReply
from glsplat.net.pace.stages import median_p95
from glsplat.net.reply import Reply
from glsplat.net.wire_schema import PictureParams
from glsplat.rotations import FLIP_YZ
from glsplat.skinning.pose import Pose

_DRAIN_TIMEOUT_S = 3.0  # for the last pictures

STAGES: tuple[tuple[str, str, str], ...] = (
    ("ik", "tracking and IK", "server"),
    ("communication", "communication", "both"),
    ("wait", "waiting for its turn", "both"),
    ("render", "stereo rendering", "server"),
    ("encode", "encoding (JPEG)", "server"),
    ("decode", "decoding", "client"),
    ("end_to_end", "end to end", ""),
)
"""Key, name and place of the rows of the latency table. The last is the sum of the others."""


@dataclass(frozen=True, slots=True)
class Driven:
    """Input of the avatar at one time: a pose, or a tracking object of docs/protocol.md."""

    pose: Pose | Mapping[str, Any] | None = None
    tracking: Mapping[str, Any] | None = None
    root: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))  # [3] position of the avatar, metres


class Drive(Protocol):
    """Input of the avatar over time."""

    def at(self, seconds: float) -> Driven:
        """Return the pose or tracking sample at a time >= 0."""


@dataclass(frozen=True, slots=True)
class Later:
    """A drive from a later time on."""

    drive: Drive
    start: float  # seconds

    def at(self, seconds: float) -> Driven:
        """Return the input of the avatar ``seconds`` after the start."""
        return self.drive.at(self.start + seconds)


@dataclass
class Result:
    """Statistics of the frames of one run, times in ms."""

    sent: int = 0
    received: int = 0
    shown: int = 0
    late: int = 0  # received, but replaced by a newer picture before it was shown
    errors: int = 0
    seconds: float = 0.0  # from the first request to the last picture
    interval: float = 0.0  # ms from request to request
    last_error: str = ""
    driver: str = ""
    times: dict[str, list[float]] = field(default_factory=dict)  # by stage
    ages: list[float] = field(default_factory=list)  # of the shown picture at each display refresh
    replies: list[float] = field(default_factory=list)  # from request to reply: age of the pose at arrival
    waits: list[float] = field(default_factory=list)  # in the server's mailbox, until the renderer was free
    nbytes: list[int] = field(default_factory=list)  # of each reply
    kept: list[tuple[float, Reply]] = field(default_factory=list)  # seconds and picture, in order

    @property
    def dropped(self) -> int:
        """Requests that were dropped for a newer one."""
        return self.sent - self.received - self.errors

    @property
    def fps(self) -> float:
        """Distinct pictures shown per second."""
        return self.shown / self.seconds if self.seconds > 0 else 0.0

    @property
    def render_ms(self) -> float:
        """Mean time to render a pair."""
        return float(np.mean(self.times["render"])) if self.times else 0.0

    @property
    def share(self) -> float:
        """Share of the renderer's maximum rate that was shown: fps times the mean render time."""
        return self.fps * self.render_ms / 1e3

    @property
    def beyond_render(self) -> list[float]:
        """Times from request to reply without the render time."""
        return [reply - ms for reply, ms in zip(self.replies, self.times.get("render", ()), strict=True)]

    @property
    def age_bound(self) -> float:
        """Upper bound of the 95th percentile of ``replies`` if the newest pose is always drawn.

        It is the sum of the 95th percentiles of solving, rendering and encoding, and one request interval.
        """
        return self.interval + sum(median_p95(self.times.get(stage, ()))[1] for stage in ("ik", "render", "encode"))

    def add(self, arrived: ReceivedReply, decode_ms: float, done: float) -> None:
        """Add one decoded reply."""
        server = arrived.reply.info.get("times", {})
        row = {
            "ik": server.get("ik", 0.0),
            "communication": arrived.communication_ms,
            "render": server.get("render", 0.0),
            "encode": server.get("encode", 0.0),
            "decode": decode_ms,
            "end_to_end": (done - arrived.requested) * 1e3,
        }
        # the rest: the mailbox, switches between threads, a busy client
        row["wait"] = max(0.0, 2 * row["end_to_end"] - sum(row.values()))
        row |= {f"render/{k}": v for k, v in server.items() if k not in (*row, "total", "wait")}
        for name, ms in row.items():
            self.times.setdefault(name, []).append(ms)
        self.replies.append((arrived.at - arrived.requested) * 1e3)
        self.waits.append(server.get("wait", 0.0))

    def summary(self) -> dict[str, Any]:
        """Return the numbers for --json."""
        return {
            "driver": self.driver,
            "fps": round(self.fps, 2),
            "seconds": round(self.seconds, 2),
            "sent": self.sent,
            "received": self.received,
            "shown": self.shown,
            "dropped": self.dropped,
            "late": self.late,
            "errors": self.errors,
            "bytes_per_frame": round(float(np.mean(self.nbytes))) if self.nbytes else 0,
            "share_of_render_rate": round(self.share, 3),
            "age_ms": _pair(self.ages),
            "reply_ms": _pair(self.replies),
            "beyond_render_ms": _pair(self.beyond_render),
            "mailbox_ms": _pair(self.waits),
            "age_bound_ms": round(self.age_bound, 3),
            "render_mean_ms": round(self.render_ms, 3),
            "stages_ms": {name: _pair(values) for name, values in self.times.items()},
        }


def observer(seconds: float, root: NDArray[np.float64], size: tuple[int, int]) -> tuple[Camera, Camera]:
    """Return the eyes of an observer who sways about 2 m in front of the avatar: the view of the mirror study.

    Eyes follow from the head pose by the paper's equations 1 to 3. ``root`` [3] is the avatar's translation, which the
    observer follows on the floor.
    """
    floor = np.array([root[0], 0.0, root[2]])
    sway = 0.3 * np.sin(0.7 * seconds), 1.35 + 0.05 * np.sin(0.45 * seconds), 2.0 + 0.2 * np.cos(0.3 * seconds)
    head = np.linalg.inv(FLIP_YZ @ look_at(floor + np.array(sway), floor + np.array([0.0, 0.92, 0.0])))
    return stereo_cameras(head, size=size)


async def stream(
    client: Client,
    drive: Drive,
    *,
    frames: int,
    fps: float = 72.0,
    size: tuple[int, int] = (1024, 1024),
    policy: str = "mailbox",
    window: int = 2,
    keep: bool = False,
    progress: Callable[[int], None] = lambda count: None,
    see: Callable[[float, Driven, tuple[int, int]], tuple[Camera, Camera]] | None = None,
    **params: Unpack[PictureParams],
) -> Result:
    """Stream for ``frames`` refreshes of a display of ``fps`` Hz; at each, show the newest decoded picture.

    ``policy`` says when to send requests; ``window`` limits the unanswered requests of ``fifo``. ``keep`` stores the
    shown replies. ``see`` returns the eyes at a time (default: ``observer``); ``params`` are options of each picture.
    """
    run = _Stream(client, keep)
    run.result.interval = 1e3 / fps

    async def ask(seconds: float) -> None:
        driven = drive.at(seconds)
        cameras = observer(seconds, driven.root, size) if see is None else see(seconds, driven, size)
        run.result.sent += 1
        await client.send(cameras, pose=driven.pose, tracking=driven.tracking, **params)

    async def ask_when_answered() -> None:
        while not over.is_set():
            if client.flow.may_request(policy, window, run.decoded):
                await ask(time.perf_counter() - start)
                await asyncio.sleep(1 / fps)  # no newer tracking sample before
            else:
                run.answered.clear()
                await run.answered.wait()

    over, closed = asyncio.Event(), None
    start = time.perf_counter()
    tasks = [asyncio.create_task(run.receive()), asyncio.create_task(run.decode())]
    if policy != "mailbox":
        tasks.append(asyncio.create_task(ask_when_answered()))
    try:
        for index in range(frames):
            await asyncio.sleep(max(0.0, start + index / fps - time.perf_counter()))
            run.refresh(time.perf_counter() - start)
            if policy == "mailbox":
                await ask(index / fps)
            progress(1)
            if any(task.done() for task in tasks):
                break
        over.set()
        run.answered.set()
        await asyncio.gather(*tasks[2:])
        end = time.perf_counter() + _DRAIN_TIMEOUT_S
        while not (run.finished or any(task.done() for task in tasks[:2])) and time.perf_counter() < end:
            await asyncio.sleep(1 / fps)
            run.refresh(time.perf_counter() - start)
        run.result.seconds = run.last_shown - start if run.result.shown else time.perf_counter() - start
    except ProtocolError as error:
        if error.code != "closed":
            raise
        closed = error
    finally:
        for task in tasks:
            task.cancel()
        outcomes = await asyncio.gather(*tasks, return_exceptions=True)
        run.threads.shutdown()
    for outcome in (closed, *outcomes):
        if isinstance(outcome, ProtocolError) and outcome.code == "closed" and run.result.last_error:
            raise ProtocolError(f"{outcome}; it said: {run.result.last_error}", "closed")
        if isinstance(outcome, Exception):
            raise outcome
    return run.result


def _pair(values: list[float]) -> dict[str, float]:
    median, p95 = median_p95(values)
    return {"median": round(median, 3), "p95": round(p95, 3)}


class _Stream:
    """Receives, decodes and shows replies; keeps only the newest undecoded and the newest decoded one."""

    def __init__(self, client: Client, keep: bool) -> None:
        self.result = Result()
        self.last_shown = 0.0
        self.answered = asyncio.Event()
        self.threads = ThreadPoolExecutor(2, thread_name_prefix="decode")
        self._client = client
        self._keep = keep
        self._arrived: ReceivedReply | None = None
        self._decoding = False
        self._wake = asyncio.Event()
        self._decoded: ReceivedReply | None = None
        self._on_show: ReceivedReply | None = None
        self.decoded = client.newest  # frame_id of the newest decoded picture

    @property
    def finished(self) -> bool:
        """Whether the newest request was answered and shown."""
        pending = self._decoding or self._arrived is not None or self._decoded is not None
        return not self._client.waiting and not pending

    async def receive(self) -> None:
        """Receive replies; an undecoded reply that is replaced counts as late."""
        while True:
            try:
                arrived = await self._client.receive()
            except ProtocolError as error:
                if error.code in ("closed", "timeout", "bad_reply"):
                    raise
                if error.code == "bad_pose" and not self.result.received:
                    raise  # all others will fail alike
                self.result.errors += 1
                self.result.last_error = str(error)
                self.answered.set()
                continue
            if still := arrived.reply.info.get("still"):  # figures without the applied pose would mislead
                raise ProtocolError(f"the server does not apply poses: {still}", "bad_pose")
            self.result.received += 1
            self.answered.set()
            self.result.nbytes.append(arrived.reply.nbytes)
            self.result.driver = arrived.reply.info.get("driver", "")
            self.result.late += self._arrived is not None
            self._arrived = arrived
            self._wake.set()

    async def decode(self) -> None:
        """Decode the newest reply, both eyes at once."""
        loop = asyncio.get_running_loop()
        while True:
            await self._wake.wait()
            self._wake.clear()
            arrived, self._arrived = self._arrived, None
            if arrived is None:
                continue
            self._decoding = True
            start = time.perf_counter()
            await asyncio.gather(*(loop.run_in_executor(self.threads, job) for job in arrived.reply.decoders()))
            done = time.perf_counter()
            self._decoding = False
            self.decoded = max(self.decoded, arrived.reply.frame_id)
            self.answered.set()
            self.result.add(arrived, (done - start) * 1e3, done)
            self.result.late += self._decoded is not None
            self._decoded = arrived

    def refresh(self, seconds: float) -> None:
        """Show the newest decoded picture, and record the age of the shown one."""
        now = time.perf_counter()
        if self._decoded is not None:
            self._on_show, self._decoded = self._decoded, None
            self.result.shown += 1
            self.last_shown = now
            if self._keep:
                self.result.kept.append((seconds, self._on_show.reply))
        if self._on_show is not None:
            self.result.ages.append((now - self._on_show.requested) * 1e3)
