"""The local render loop: draws on one thread of this process, encodes on others while the next picture is drawn.

One thread owns the renderer, as an OpenGL context belongs to a thread.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Awaitable, Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import Any

from glsplat.errors import ContextError, GlsplatError
from glsplat.io.machine import cores
from glsplat.net.backend import Backend, Interruptible, Rendered
from glsplat.net.client_stream import ClientStream, Frame, VideoStream
from glsplat.net.codec.encode import Encoded, Encoder
from glsplat.net.fields import PictureOptions
from glsplat.net.render_loop import RenderLoop
from glsplat.optional import extra_module, missing, plugin

__all__ = ["LocalLoop", "encode"]

log: logging.Logger = logging.getLogger("glsplat.net")

_PAUSES = (0.0, 0.5, 1.0)  # seconds before each attempt to make a new context; then the render loop gives up
_GRACE = 0.5  # seconds the picture in hand gets when the server stops
_CODERS = max(1, cores() // 2)  # threads that code video, which takes long: JPEGs do not wait for it
_CODED = _CODERS + 1  # pictures that are coded or wait for it, of all videos: each holds room that drawing needs


class LocalLoop(RenderLoop):
    """Draws with a backend on a thread of its own, and encodes on some more.

    ``video`` lets clients have video who ask for it. Raises GlsplatError where there is nothing to code it with.
    """

    def __init__(
        self,
        backend: Backend,
        clock: Callable[[], float] = time.perf_counter,
        rate: float | None = None,
        video: bool = False,
    ) -> None:
        super().__init__(clock, rate)
        self.codecs = _codecs() if video else ()
        self._backend = backend
        self._render_thread = ThreadPoolExecutor(1, thread_name_prefix="render")
        self._encode_threads = ThreadPoolExecutor(2, thread_name_prefix="frame")
        self._video_threads = ThreadPoolExecutor(_CODERS, thread_name_prefix="video")
        self._coded: tuple[Future[Encoded], ...] = ()  # by them, the newest last
        self._encoder = Encoder()
        if isinstance(backend, Interruptible):
            backend.abandoned = self._abandoned

    def open(self, *args: Any, **kwargs: Any) -> ClientStream:
        """A client, as elsewhere; here it may have video."""
        channel = super().open(*args, **kwargs)
        if self.codecs:
            video = extra_module("far_links.video")
            channel.video = video.VideoStream(self._clock, {codec: video.CODECS[codec] for codec in self.codecs})
        return channel

    def _ready(self, now: float, rests: list[float], channel: ClientStream) -> bool:
        """As elsewhere; none that is to be video while as many are drawn already as are coded at a time."""
        session = channel.session
        asks = any(one is not None and one.options.video is not None for one in (session.newest, session.kept))
        if channel.video is not None and asks and sum(not one.done() for one in self._coded) >= _CODED:
            return False
        return super()._ready(now, rests, channel)

    async def _open(self) -> str:
        return await self._loop.run_in_executor(self._render_thread, self._backend.open)

    async def _rebuild(self) -> None:
        """A new context and everything in it; clients keep their connection.

        Raises ContextError if none can be made that draws a plain picture: no client's requests bring that about.
        """
        log.warning("the OpenGL context is lost; making a new one")
        for pause in _PAUSES:
            await asyncio.sleep(pause)
            try:
                self.driver = await self._loop.run_in_executor(self._render_thread, self._open_again)
                break
            except ContextError as error:
                log.warning("there is no new one: %s", error)
                if pause == _PAUSES[-1]:
                    raise
        self.rebuilds += 1
        self.failures = 0  # it has drawn a picture

    def _open_again(self) -> str:
        """On the render thread."""
        try:
            self._backend.close()
        except Exception:
            log.debug("what is left of the lost context cannot be released", exc_info=True)
        return self._backend.open()

    async def _close(self) -> None:
        closing = self._loop.run_in_executor(self._render_thread, self._backend.close)
        done, _ = await asyncio.wait([closing], timeout=_GRACE)
        if not done and isinstance(self._backend, Interruptible):
            self._backend.kill()
        await closing

    async def _picture(self, frame: Frame) -> Awaitable[Encoded]:
        return asyncio.wrap_future(await self._loop.run_in_executor(self._render_thread, self._draw, frame))

    def _draw(self, frame: Frame) -> Future[Encoded]:
        """On the render thread: the pose where tracking was sent, the picture, and its encoding under way."""
        job = self._job(frame)
        start = self._begin(frame)
        rendered = self._backend.render(job)
        done = rendered.done or _nothing
        try:
            self._note(frame, rendered, start)
            for observer in frame.channel.observers:
                observer.picture_drawn(rendered.images)
            # from here: the event loop need not hear of it first
            encoded = self._submit(frame.channel, rendered, job.options)
        except BaseException:
            done()
            raise
        # of the future, not of the encoding: one that is cancelled while it waits never begins
        encoded.add_done_callback(lambda _: done())
        return encoded

    def _submit(self, channel: ClientStream, rendered: Rendered, options: PictureOptions) -> Future[Encoded]:
        if options.video is None or channel.video is None:
            return self._encode_threads.submit(encode, self._encoder, rendered, options)
        coding = self._video_threads.submit(self._code, channel.video, channel.coding, rendered, options)
        channel.coding = coding
        self._coded = (*(one for one in self._coded if not one.done()), coding)
        coding.add_done_callback(lambda _: self._solved())  # the next may be drawn
        return coding

    def _code(
        self, video: VideoStream, before: Future[Encoded] | None, rendered: Rendered, options: PictureOptions
    ) -> Encoded:
        """The next picture of a client's video. On a thread for it."""
        if before is not None:  # it was begun before this one was, so that this thread waits for no other place
            wait([before])
        assert options.video is not None
        how = options.video.codecs, options.quality, rendered.covered, options.alpha, options.video.key
        return video.encode(rendered.images, *how) or encode(self._encoder, rendered, options)

    def _end_threads(self) -> None:
        super()._end_threads()
        self._render_thread.shutdown(wait=False)
        for threads in (self._encode_threads, self._video_threads):
            threads.shutdown(wait=False)
        self._encoder.close()


def encode(encoder: Encoder, rendered: Rendered, options: PictureOptions) -> Encoded:
    """The JPEGs of what was drawn, here or in a worker. On an encoding thread."""
    return encoder.encode(rendered.images, options.quality, options.crop, rendered.covered, options.alpha)


def _codecs() -> tuple[str, ...]:
    video = plugin("far_links.video")
    if video is None:
        raise GlsplatError(missing("far_links", "video"))
    names: tuple[str, ...] = video.available()
    return names


def _nothing() -> None: ...
