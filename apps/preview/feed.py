"""Feed: requests, receives and decodes a server's pictures on a thread, so that the window never waits.

Both directions keep only the newest item: the newest request is sent, at most at the rate of a display, and the newest
decoded picture is queued. A lost connection is retried with growing pauses.
"""

from __future__ import annotations

import argparse
import asyncio
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera
from glsplat.errors import GlsplatError, ProtocolError
from glsplat.net.client import Client
from glsplat.net.flow import Backoff, ReceivedReply
from glsplat.net.guard.access import read_token
from glsplat.skinning.pose import Pose

MIN_PERIOD_S = 1 / 72  # between requests
_TIMEOUT_S = 5.0  # of a connection or a picture
_REPLY_TIMEOUT_S = 2 * _TIMEOUT_S  # of wait_ready()
_KEEPALIVE_S = 20.0  # without requests; the server drops clients that are silent for 60 s
_MIN_SCALE = 1 / 16  # of the window size, if the server refuses larger pictures


@dataclass(frozen=True, eq=False)
class ViewRequest:
    """A view to draw: cameras of one size, and the pose or tracking sample of the avatar."""

    cameras: Sequence[Camera]
    pose: Pose | Mapping[str, Any] | None = None
    tracking: Mapping[str, Any] | None = None
    options: Mapping[str, Any] = field(default_factory=dict)  # of Client.send: mirror, hide, alpha
    about: object = None  # returned with its picture; not sent


@dataclass(frozen=True, eq=False)
class Picture:
    """One decoded reply."""

    images: NDArray[np.uint8]  # [V, H, W, 4] RGBA, rows top-down
    info: Mapping[str, Any]  # of the reply
    frame_id: int
    nbytes: int  # of the message
    requested_at: float  # seconds on time.perf_counter's clock
    communication_ms: float
    decode_ms: float
    about: object = None  # of the request that it answers


class Feed:
    """Pictures of one server: ``start``, then ``request`` and ``take`` from one thread, finally ``close``."""

    def __init__(self, url: str, token: str | None = None, *, cafile: Path | None = None, quality: int | None = None):
        self.url = url
        self.notice = ""  # current problem
        self.late = 0  # pictures replaced by a newer one before they were taken
        self.reconnects = 0
        self.wake: Callable[[], None] = lambda: None  # called on the feed's thread when a picture or notice is new
        # one client for all connections, so that it returns to its room as the same person
        self._client = Client(url, token, window=2, cafile=cafile, timeout=_TIMEOUT_S)
        self._quality = quality
        self._request: tuple[int, ViewRequest] | None = None
        self._requested = 0  # number of requests
        self._answered: tuple[int, str] = (0, "")  # number of the newest answered request, and its error
        self._scale = 1.0  # of the window's size, if the server refuses larger pictures
        self._scaled_at = 0  # newest frame_id when the scale was set
        self._picture: Picture | None = None
        self._changed = threading.Condition()
        self._loop = asyncio.new_event_loop()
        self._request_set = asyncio.Event()  # set when a request is new
        self._main: asyncio.Task[None] | None = None
        self._thread = threading.Thread(target=self._work, name="feed", daemon=True)
        self._first: GlsplatError | None = None
        self._up = threading.Event()

    def start(self) -> None:
        """Connect. Raises GlsplatError on failure."""
        self._thread.start()
        self._up.wait()
        if self._first is not None:
            self._thread.join()
            raise self._first

    def close(self) -> None:
        """Disconnect and end the thread."""
        if self._thread.is_alive():
            with suppress(RuntimeError):  # the loop has just ended
                self._loop.call_soon_threadsafe(self._stop)
            self._thread.join()

    @property
    def ready(self) -> bool:
        """Whether a picture is queued."""
        return self._picture is not None

    def request(self, request: ViewRequest) -> None:
        """Queue a request; replaces one that was not sent yet."""
        with self._changed:
            self._requested += 1
            self._request = (self._requested, request)
        self._loop.call_soon_threadsafe(self._request_set.set)

    def take(self) -> Picture | None:
        """Return and remove the queued picture; None without one."""
        with self._changed:
            picture, self._picture = self._picture, None
        return picture

    def wait_ready(self) -> None:
        """Wait until the newest request is answered. Raises GlsplatError if it failed or took too long."""
        with self._changed:
            if not self._changed.wait_for(lambda: self._answered[0] >= self._requested, _REPLY_TIMEOUT_S):
                raise GlsplatError(self.notice or f"{self.url}: no picture within {_REPLY_TIMEOUT_S:g} s")
            if self._answered[1]:
                raise GlsplatError(self._answered[1])

    # ------------------------------------------------------------------------------------------------ the thread

    def _work(self) -> None:
        try:
            with asyncio.Runner(loop_factory=lambda: self._loop) as runner, suppress(asyncio.CancelledError):
                runner.run(self._serve())
        finally:
            self._up.set()  # unblocks start() if the thread ends

    def _stop(self) -> None:
        if self._main is not None:
            self._main.cancel()

    async def _serve(self) -> None:
        """Connect, exchange messages, and reconnect when the connection ends."""
        self._main = asyncio.current_task()
        backoff = Backoff()
        while True:
            try:
                async with self._client as client:
                    if self._up.is_set():
                        self.reconnects += 1
                        self._notify("")
                    self._up.set()
                    backoff.connected()
                    await self._exchange(client)
            except GlsplatError as error:
                if not self._up.is_set():
                    self._first = error
                    self._up.set()
                    return
                pause = backoff.pause()
                self._notify(f"{error}; trying again in {pause:g} s")
                await asyncio.sleep(pause)

    async def _exchange(self, client: Client) -> None:
        """Send and receive until the connection ends; then raise ProtocolError."""
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
        self._request_set.set()  # after a reconnection the last request is sent again
        sent: tuple[int, float] | None = None
        while True:
            try:
                async with asyncio.timeout(_KEEPALIVE_S):
                    await self._request_set.wait()
            except TimeoutError:
                await client.acknowledge()
                continue
            self._request_set.clear()
            if self._request is None or sent == (self._request[0], self._scale):
                continue
            number, request = self._request
            sent = number, self._scale
            cameras = [
                camera.resized(max(1, round(camera.width * self._scale)), max(1, round(camera.height * self._scale)))
                for camera in request.cameras
            ]
            options = dict(request.options, quality=self._quality, crop=True, subject=(number, request.about))
            await client.send(cameras, pose=request.pose, tracking=request.tracking, **options)
            await asyncio.sleep(MIN_PERIOD_S)

    async def _receive(self, client: Client) -> None:
        while True:
            try:
                arrived = await client.receive()
                self._put(arrived, *self._request_of(client, arrived.reply.frame_id))
            except ProtocolError as error:
                if error.code == "timeout" and not client.waiting:
                    continue
                if error.code in ("closed", "timeout", "bad_reply"):
                    raise
                self._refused(error, client)

    def _request_of(self, client: Client, frame_id: int) -> tuple[int, object]:
        """Return the number and ``about`` of the request that was sent as ``frame_id``."""
        subject = client.flow.about(frame_id)
        return subject if isinstance(subject, tuple) else (self._answered[0], None)

    def _put(self, arrived: ReceivedReply, number: int, about: object) -> None:
        """Decode a picture and queue it."""
        reply, start = arrived.reply, time.perf_counter()
        if reply.alphas:
            images = np.stack(reply.rgba())
        else:
            decoded = reply.images()
            images = np.full((len(decoded), *decoded[0].shape[:2], 4), 255, np.uint8)
            for image, out in zip(decoded, images, strict=True):
                out[..., :3] = image
        decode_ms = (time.perf_counter() - start) * 1e3
        times = arrived.requested, arrived.communication_ms, decode_ms
        picture = Picture(images, reply.info, reply.frame_id, reply.nbytes, *times, about)
        with self._changed:
            self.late += self._picture is not None
            self._picture, self.notice, self._answered = picture, "", (number, "")
            self._changed.notify_all()
        self.wake()

    def _refused(self, error: ProtocolError, client: Client) -> None:
        """Handle a refused request: request smaller pictures, or show the reason."""
        frame_id = error.frame_id or client.newest
        if error.code == "bad_size" and self._scale > _MIN_SCALE:
            if frame_id > self._scaled_at:  # ignores requests sent before the last change
                self._scale /= 2
                self._scaled_at = client.newest
                self._request_set.set()
            return
        with self._changed:
            self._answered = (self._request_of(client, frame_id)[0], str(error))
            self._changed.notify_all()
        self._notify(f"the server says: {error}")

    def _notify(self, notice: str) -> None:
        self.notice = notice
        self.wake()


def feed_of(args: argparse.Namespace, url: str | None) -> Feed | None:
    """Return a feed of ``url`` by the options of a command, not connected yet; None without ``url``."""
    if url is None:
        return None
    token = None if args.token_file is None else read_token(args.token_file)
    return Feed(url, token, cafile=args.tls_ca, quality=args.quality)
