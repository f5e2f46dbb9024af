"""PictureEncoder: encodes drawn pictures on threads, in the server or in a worker."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import GlsplatError
from glsplat.io.cores import cores
from glsplat.net.backend import Rendered
from glsplat.net.codec.encode import Encoder
from glsplat.net.codec.encoded import Encoded
from glsplat.net.wire_schema import PictureOptions
from glsplat.optional import extra_module, missing, plugin

_VIDEO_THREADS = max(1, cores() // 2)
MAX_VIDEO_PICTURES = _VIDEO_THREADS + 1  # of all videos, queued or being encoded: each holds memory for drawing


def _nothing(images: NDArray[np.uint8]) -> None: ...


class VideoStream(Protocol):
    """Codes the pictures of one client as video (extras/far_links). Called on one thread at a time."""

    def encode(
        self,
        images: NDArray[np.uint8],
        codecs: Sequence[str],
        quality: int = 80,
        covered: tuple[int, int, int, int] | None = None,
        alpha: bool | str = False,
        key: bool = False,
    ) -> Encoded | None:
        """Return the next picture of ``images`` [V, H, W, 4]; None: it has to be a JPEG."""


class ClientVideo:
    """A client's video, and its newest picture: the next one is coded after that."""

    def __init__(self, stream: VideoStream) -> None:
        self.stream: VideoStream = stream
        self.newest: Future[Encoded] | None = None


class PictureEncoder:
    """Encodes JPEGs on two threads, and videos on separate threads, so that no JPEG waits for a video.

    ``video`` offers video to clients. Raises GlsplatError where no codec is installed.
    """

    def __init__(self, video: bool = False) -> None:
        self.codecs: tuple[str, ...] = _codecs() if video else ()
        self.on_capacity: list[Callable[[], None]] = []
        """Called on any thread once another picture of a video may be submitted."""
        self._encoder = Encoder()
        self._jpeg_threads = ThreadPoolExecutor(2, thread_name_prefix="frame")
        self._video_threads = ThreadPoolExecutor(_VIDEO_THREADS, thread_name_prefix="video")
        self._videos: tuple[Future[Encoded], ...] = ()

    @property
    def full(self) -> bool:
        """True while MAX_VIDEO_PICTURES are queued or being encoded."""
        return sum(not one.done() for one in self._videos) >= MAX_VIDEO_PICTURES

    def video(self, clock: Callable[[], float]) -> ClientVideo | None:
        """Return the video of a new client; None where video is not offered."""
        if not self.codecs:
            return None
        video = extra_module("far_links.video")
        return ClientVideo(video.VideoStream(clock, {codec: video.CODECS[codec] for codec in self.codecs}))

    def submit(
        self,
        rendered: Rendered,
        options: PictureOptions,
        video: ClientVideo | None = None,
        observe: Callable[[NDArray[np.uint8]], None] = _nothing,
    ) -> Future[Encoded]:
        """Encode a picture as a JPEG, or as the next one of ``video`` where ``options`` request that.

        ``observe`` is called first, on the encoding thread; it may change the images. ``rendered.done`` is called at
        the end, also for a picture whose future is cancelled.
        """
        if video is None or options.video is None:
            encoded = self._jpeg_threads.submit(self._jpegs, rendered, options, observe)
        else:
            encoded = self._video_threads.submit(self._code, video.stream, video.newest, rendered, options, observe)
            video.newest = encoded
            self._videos = (*(one for one in self._videos if not one.done()), encoded)
            encoded.add_done_callback(self._call_on_capacity)
        if rendered.done is not None:
            done = rendered.done
            encoded.add_done_callback(lambda _: done())
        return encoded

    def close(self, wait: bool = False) -> None:
        """End the threads after their present pictures."""
        for threads in (self._jpeg_threads, self._video_threads):
            threads.shutdown(wait=wait)
        self._encoder.close()

    def _jpegs(
        self, rendered: Rendered, options: PictureOptions, observe: Callable[[NDArray[np.uint8]], None] = _nothing
    ) -> Encoded:
        observe(rendered.images)
        images, covered = rendered.images, rendered.covered
        return self._encoder.encode(images, options.quality, options.crop, covered, options.alpha)

    def _code(
        self,
        stream: VideoStream,
        before: Future[Encoded] | None,
        rendered: Rendered,
        options: PictureOptions,
        observe: Callable[[NDArray[np.uint8]], None],
    ) -> Encoded:
        if before is not None:  # it was submitted first, so there is no deadlock
            wait([before])
        assert options.video is not None
        observe(rendered.images)
        how = options.video.codecs, options.quality, rendered.covered, options.alpha, options.video.key
        return stream.encode(rendered.images, *how) or self._jpegs(rendered, options)

    def _call_on_capacity(self, _: Future[Encoded]) -> None:
        for call in self.on_capacity:
            call()


def _codecs() -> tuple[str, ...]:
    video = plugin("far_links.video")
    if video is None:
        raise GlsplatError(missing("far_links", "video"))
    names: tuple[str, ...] = video.available()
    return names
