"""A server's pictures for a window: a thread with an event loop asks, receives and decodes; the window never waits.

Both directions are mailboxes of one: the newest wish is sent, at most at the pace of a display, and the newest decoded
picture lies ready. A server that goes away is tried again, ever less often.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera
from glsplat.errors import GlsplatError, ProtocolError
from glsplat.net.client import Client
from glsplat.net.flow import Backoff, ReceivedReply
from glsplat.skinning.pose import Pose

__all__ = ["PACE", "Feed", "Picture", "Wish"]

PACE = 1 / 72  # seconds from request to request at least
_TIMEOUT = 5.0  # seconds until a connection or a picture is given up
_QUIET = 20.0  # seconds without a wish after which the server hears from us: it drops clients that say nothing for 60
_SMALLEST = 1 / 16  # of the window, where the server refuses large pictures


@dataclass(frozen=True, eq=False)
class Wish:
    """What the window wants to show: cameras of one size, and what moves the avatar."""

    cameras: Sequence[Camera]
    pose: Pose | Mapping[str, Any] | None = None
    tracking: Mapping[str, Any] | None = None
    options: Mapping[str, Any] = field(default_factory=dict)  # of Client.send: mirror, hide, alpha
    about: object = None  # comes back with its picture; not sent


@dataclass(frozen=True, eq=False)
class Picture:
    """One decoded reply."""

    images: NDArray[np.uint8]  # [V, H, W, 4] RGBA, rows top-down
    info: Mapping[str, Any]  # what the server says about it
    frame_id: int
    nbytes: int  # of the message
    asked: float  # seconds on time.perf_counter's clock
    communication_ms: float
    decode_ms: float
    about: object = None  # of the wish that it answers


class Feed:
    """The pictures of one server. ``start``, then ``ask`` and ``take`` from one thread, at last ``close``."""

    def __init__(self, url: str, token: str | None = None, *, cafile: Path | None = None, quality: int | None = None):
        self.url = url
        self.notice = ""  # what is wrong at present
        self.late = 0  # pictures replaced by a newer one before they were taken
        self.reconnects = 0
        self.wake: Callable[[], None] = lambda: None  # called on the thread when there is something to see
        # one for all connections: in a room it comes back as the same person
        self._client = Client(url, token, window=2, cafile=cafile, timeout=_TIMEOUT)
        self._quality = quality
        self._wish: tuple[int, Wish] | None = None
        self._asked = 0  # wishes so far
        self._settled: tuple[int, str] = (0, "")  # newest wish that was answered, and its error
        self._scale = 1.0  # of the pictures, where the server refuses the window's size
        self._scaled_at = 0  # frame_id of the newest request when it was set
        self._picture: Picture | None = None
        self._changed = threading.Condition()
        self._loop = asyncio.new_event_loop()
        self._new = asyncio.Event()  # a wish, for the thread
        self._main: asyncio.Task[None] | None = None
        self._thread = threading.Thread(target=self._work, name="feed", daemon=True)
        self._first: GlsplatError | None = None
        self._up = threading.Event()

    def start(self) -> None:
        """Connect. Raises GlsplatError, one line, if that fails."""
        self._thread.start()
        self._up.wait()
        if self._first is not None:
            self._thread.join()
            raise self._first

    def close(self) -> None:
        """Leave the server and end the thread."""
        if self._thread.is_alive():
            with suppress(RuntimeError):  # it ended just now
                self._loop.call_soon_threadsafe(self._stop)
            self._thread.join()

    @property
    def ready(self) -> bool:
        """True while a picture waits to be taken."""
        return self._picture is not None

    def ask(self, wish: Wish) -> None:
        """Want this from now on; replaces a wish that was not sent yet."""
        with self._changed:
            self._asked += 1
            self._wish = (self._asked, wish)
        self._loop.call_soon_threadsafe(self._new.set)

    def take(self) -> Picture | None:
        """The newest picture that was not taken yet."""
        with self._changed:
            picture, self._picture = self._picture, None
        return picture

    def settle(self, seconds: float = 2 * _TIMEOUT) -> None:
        """Wait until the newest wish is answered. Raises GlsplatError if it failed or took too long."""
        with self._changed:
            if not self._changed.wait_for(lambda: self._settled[0] >= self._asked, seconds):
                raise GlsplatError(self.notice or f"{self.url}: no picture within {seconds:g} s")
            if self._settled[1]:
                raise GlsplatError(self._settled[1])

    # ------------------------------------------------------------------------------------------------ the thread

    def _work(self) -> None:
        try:
            with asyncio.Runner(loop_factory=lambda: self._loop) as runner, suppress(asyncio.CancelledError):
                runner.run(self._serve())
        finally:
            self._up.set()  # nobody waits for a thread that has ended

    def _stop(self) -> None:
        if self._main is not None:
            self._main.cancel()

    async def _serve(self) -> None:
        """Connect, talk, and when the server goes away begin again."""
        self._main = asyncio.current_task()
        backoff = Backoff()
        while True:
            try:
                async with self._client as client:
                    if self._up.is_set():
                        self.reconnects += 1
                        self._say("")
                    self._up.set()
                    backoff.connected()
                    await self._talk(client)
            except GlsplatError as error:
                if not self._up.is_set():
                    self._first = error
                    self._up.set()
                    return
                pause = backoff.pause()
                self._say(f"{error}; trying again in {pause:g} s")
                await asyncio.sleep(pause)

    async def _talk(self, client: Client) -> None:
        """Send and receive until the connection ends. Raises ProtocolError then."""
        self._scaled_at = 0
        tasks = [asyncio.create_task(self._send(client)), asyncio.create_task(self._receive(client))]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in tasks:
                task.cancel()
            ends = await asyncio.gather(*tasks, return_exceptions=True)
        for end in ends:
            if isinstance(end, Exception):
                raise end

    async def _send(self, client: Client) -> None:
        self._new.set()  # after a reconnection the last wish still stands
        sent: tuple[int, float] | None = None
        while True:
            try:
                async with asyncio.timeout(_QUIET):
                    await self._new.wait()
            except TimeoutError:
                await client.acknowledge()
                continue
            self._new.clear()
            if self._wish is None or sent == (self._wish[0], self._scale):
                continue
            number, wish = self._wish
            sent = number, self._scale
            cameras = [_scaled(camera, self._scale) for camera in wish.cameras]
            asked = dict(wish.options, quality=self._quality, crop=True, subject=(number, wish.about))
            await client.send(cameras, pose=wish.pose, tracking=wish.tracking, **asked)
            await asyncio.sleep(PACE)

    async def _receive(self, client: Client) -> None:
        while True:
            try:
                arrived = await client.receive()
                self._put(arrived, *self._wish_of(client, arrived.reply.frame_id))
            except ProtocolError as error:
                if error.code == "timeout" and not client.waiting:
                    continue
                if error.code in ("closed", "timeout", "bad_reply"):
                    raise
                self._refused(error, client)

    def _wish_of(self, client: Client, frame_id: int) -> tuple[int, object]:
        """The number of the wish that a request carried, and what it was about."""
        subject = client.flow.about(frame_id)
        return subject if isinstance(subject, tuple) else (self._settled[0], None)

    def _put(self, arrived: ReceivedReply, number: int, about: object) -> None:
        """Decode and lay ready."""
        reply, start = arrived.reply, time.perf_counter()
        if reply.alphas:
            images = np.stack(reply.rgba())
        else:
            decoded = reply.images()
            images = np.full((len(decoded), *decoded[0].shape[:2], 4), 255, np.uint8)
            for image, out in zip(decoded, images, strict=True):
                out[..., :3] = image
        decode_ms = (time.perf_counter() - start) * 1e3
        way = arrived.communication_ms
        picture = Picture(images, reply.info, reply.frame_id, reply.nbytes, arrived.requested, way, decode_ms, about)
        with self._changed:
            self.late += self._picture is not None
            self._picture, self.notice, self._settled = picture, "", (number, "")
            self._changed.notify_all()
        self.wake()

    def _refused(self, error: ProtocolError, client: Client) -> None:
        """The server did not draw a wish: ask for smaller pictures, or say why."""
        frame_id = error.frame_id or client.newest
        if error.code == "bad_size" and self._scale > _SMALLEST:
            if frame_id > self._scaled_at:  # not one of the requests sent before the last change
                self._scale /= 2
                self._scaled_at = client.newest
                self._new.set()
            return
        with self._changed:
            self._settled = (self._wish_of(client, frame_id)[0], str(error))
            self._changed.notify_all()
        self._say(f"the server says: {error}")

    def _say(self, notice: str) -> None:
        self.notice = notice
        self.wake()


def _scaled(camera: Camera, factor: float) -> Camera:
    """The same view with fewer pixels."""
    if factor == 1:
        return camera
    width, height = max(1, round(camera.width * factor)), max(1, round(camera.height * factor))
    K = camera.K * np.array([[width / camera.width], [height / camera.height], [1.0]])
    return replace(camera, K=K, width=width, height=height)
