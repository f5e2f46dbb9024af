"""Video: a client's pictures as one stream of inter-coded frames (PyAV).

One coded picture holds both eyes side by side and alpha below them, so that one decoder has a whole frame. The settings
are those of low delay: each picture gives its bytes at once, without look-ahead. TCP loses nothing, so key frames come
only at the start of a stream, when its form changes, and on a client's request; H.264 also refreshes column by column
(intra refresh).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.errors import GlsplatError
from glsplat.io.cores import cores
from glsplat.net.codec.encode import straightened
from glsplat.net.codec.encoded import Box, Encoded
from glsplat.optional import require_package

if TYPE_CHECKING:
    from av import VideoCodecContext

Image = NDArray[np.uint8]

STEPS = (20, 40, 60, 80, 90)
"""JPEG qualities that a stream can match; one takes the next above that of the request or its link."""


@dataclass(frozen=True, slots=True)
class Coder:
    """Settings of a codec."""

    library: str  # FFmpeg's encoder
    options: dict[str, str]
    factors: tuple[int, ...]  # crf at each of STEPS that has JPEG's LPIPS (docs/measured/codec.md)


CODECS: dict[str, Coder] = {
    "vp9": Coder(
        "libvpx-vp9",
        {"deadline": "realtime", "cpu-used": "8", "lag-in-frames": "0", "row-mt": "1", "tile-columns": "2", "b": "0"}
        | {"g": "9999", "auto-alt-ref": "0"},
        (50, 41, 34, 23, 12),
    ),
    "h264": Coder(
        "libx264",
        {"preset": "superfast", "tune": "zerolatency", "profile": "high", "forced-idr": "1"}
        | {"x264-params": "intra-refresh=1:keyint=300"},
        (36, 29, 26, 22, 15),
    ),
}
"""Codecs that a server may use, by their names in requests."""

_AGAIN = 0.5  # least seconds between changes of form, and between key frames that a client requests
_SHARE, _SAVED = 0.1, 1.0  # time for changes of form: average share of a client's time; most seconds at once
_LEAST, _MOST = 32, 4096 * 2304  # fewest pixels of a side, most of the coded picture
_THREADS = max(1, min(2, cores() // 4))  # the renderer needs cores, too
_BLACK = 16, 128, 128  # of Y, U and V in limited range (ITU-R BT.601)
_601, _709, _SRGB, _LIMITED = 6, 1, 13, 1  # matrix, primaries, transfer and range as FFmpeg numbers them


def available() -> tuple[str, ...]:
    """Return the names of CODECS that the installed PyAV has. Raises GlsplatError without PyAV."""
    require_package("video", "av", "video", "leave video out")
    import av

    found = []
    for name, coder in CODECS.items():
        with suppress(av.error.FFmpegError, ValueError):
            av.codec.Codec(coder.library, "w")
            found.append(name)
    return tuple(found)


class VideoStream:
    """One client's stream; ``encode`` takes its pictures in the order in which they are sent."""

    def __init__(self, clock: Callable[[], float] = time.perf_counter, coders: Mapping[str, Coder] = CODECS) -> None:
        self._clock, self._coders = clock, coders
        self._context: VideoCodecContext | None = None
        self._form: tuple[Any, ...] = ()
        self._step = 0
        self._opened = self._key = -np.inf
        self._credit, self._since = _SAVED, clock()  # seconds left for changes of form, and when that was computed
        self._number = 0
        self._name = ""  # of the codec, in WebCodecs
        self._canvas: Image = np.empty((0, 0), np.uint8)  # planes Y, U, V one below the other
        self._filled: list[Box] = []  # its boxes that are not black

    def encode(
        self,
        images: Image,
        codecs: Sequence[str],
        quality: int = 80,
        covered: Box | None = None,
        alpha: bool | str = False,
        key: bool = False,
    ) -> Encoded | None:
        """Encode the next picture of ``images`` [V, H, W, 4], which are zero outside ``covered``.

        ``quality`` is JPEG's. ``key``: the client needs a key frame. Returns None if the picture should be a JPEG: its
        form is not supported, or changes too soon; the stream stays as it is.
        """
        start = self._clock()
        eyes, height, width = images.shape[:3]
        even = (width + width % 2, height + height % 2)
        size = even[0] * eyes, even[1] * (2 if alpha else 1)
        known = [one for one in codecs if one in self._coders]
        codec = self._form[0] if self._form and self._form[0] in known else next(iter(known), None)
        if codec is None or min(width, height) < _LEAST or size[0] * size[1] > _MOST:
            return None
        form = codec, *size, eyes, bool(alpha)
        step = next((i for i, one in enumerate(STEPS) if quality <= one), len(STEPS) - 1)
        self._credit = min(_SAVED, self._credit + _SHARE * (start - self._since))
        self._since = start
        early = start - self._opened < _AGAIN or self._credit <= 0
        if form != self._form and early:
            return None
        if self._context is None or form != self._form or (step != self._step and not early):
            self._open(form, step, start)
        anew = self._key == -np.inf
        force = anew or (key and start - self._key >= _AGAIN)
        if alpha == "straight":
            images = np.stack([straightened(image) for image in images])
            covered = None
        places = [(i * even[0], 0) for i in range(eyes)]
        below = [(x, even[1]) for x, _ in places] if alpha else []
        self._fill(images, covered, places, below)
        try:
            data, is_key = self._code(force)
        except Exception:
            self._context, self._form = None, ()  # its state is unknown: the next picture opens a new one
            raise
        end = self._clock()
        if is_key:
            self._key = start
            self._name = _name(codec, data)
        if anew:
            self._credit -= end - start
        self._number += 1
        said: dict[str, Any] = {"codec": self._name, "number": self._number, "key": is_key, "size": size}
        said |= {"eyes": places} | ({"alpha": below} if below else {})
        return Encoded([data], None, (end - start) * 1e3, video=said)

    def _open(self, form: tuple[Any, ...], step: int, now: float) -> None:
        import av

        codec, width, height = form[:3]
        coder = self._coders[codec]
        context = cast("VideoCodecContext", av.CodecContext.create(coder.library, "w"))
        context.width, context.height, context.pix_fmt = width, height, "yuv420p"
        context.time_base, context.framerate = Fraction(1, 1000), Fraction(30)
        context.colorspace, context.color_primaries = _601, _709
        context.color_trc, context.color_range = _SRGB, _LIMITED
        context.options = coder.options | {"crf": str(coder.factors[step])}
        context.thread_count = _THREADS
        context.open()
        self._context, self._form, self._step = context, form, step
        self._opened, self._key = now, -np.inf
        self._canvas = np.empty((height * 3 // 2, width), np.uint8)
        for plane, value in zip(_planes(self._canvas), _BLACK, strict=True):
            plane[:] = value
        self._filled = []

    def _fill(
        self, images: Image, covered: Box | None, places: list[tuple[int, int]], below: list[tuple[int, int]]
    ) -> None:
        planes = _planes(self._canvas)
        for x, y, w, h in self._filled:
            for plane, value, of in zip(planes, _BLACK, (1, 2, 2), strict=True):
                plane[y // of : (y + h) // of, x // of : (x + w) // of] = value
        self._filled = []
        height, width = images.shape[1:3]
        left, top, w, h = covered or (0, 0, width, height)
        right, low = left + w + (left + w) % 2, top + h + (top + h) % 2
        left, top = left - left % 2, top - top % 2
        if right <= left or low <= top:
            return
        for image, *at in zip(images, places, below or places, strict=True):
            part = image[top:low, left:right]
            part = np.pad(part, ((0, low - top - part.shape[0]), (0, right - left - part.shape[1]), (0, 0)))
            drawn = [part, np.repeat(part[..., 3:], 4, axis=2)] if below else [part]
            for one, (x, y) in zip(drawn, at, strict=False):
                yuv = np.asarray(cv2.cvtColor(np.ascontiguousarray(one), cv2.COLOR_RGBA2YUV_I420), np.uint8)
                box = x + left, y + top, right - left, low - top
                self._filled.append(box)
                for plane, new, size in zip(planes, _planes(yuv), (1, 2, 2), strict=True):
                    rows, columns = new.shape
                    plane[box[1] // size :, box[0] // size :][:rows, :columns] = new

    def _code(self, force: bool) -> tuple[bytes, bool]:
        import av

        assert self._context is not None
        frame = av.VideoFrame.from_ndarray(self._canvas, "yuv420p")
        frame.pts = self._number * 33
        if force:
            frame.pict_type = av.video.frame.PictureType.I
        packets = self._context.encode(frame)
        if not packets:
            raise RuntimeError("the video encoder holds a picture back")
        return b"".join(map(bytes, packets)), any(packet.is_keyframe for packet in packets)


def _planes(canvas: Image) -> tuple[Image, Image, Image]:
    """Return views of the planes Y, U and V, which lie one below the other as in OpenCV and FFmpeg."""
    height, width = canvas.shape[0] * 2 // 3, canvas.shape[1]
    colours = canvas[height:].reshape(2, height // 2, width // 2)
    return canvas[:height], colours[0], colours[1]


def _name(codec: str, data: bytes) -> str:
    """Return WebCodecs' name: for H.264 with profile and level (ISO/IEC 14496-15), for VP9 with the highest level."""
    if codec == "vp9":
        return "vp09.00.51.08"
    at = data.find(b"\0\0\1\x67") + 4
    return f"avc1.{data[at : at + 3].hex().upper()}"


_NAMES = {"vp9": "vp09", "h264": "avc1"}  # name in a request: start of a reply's name (docs/protocol.md, section 5.2)


class VideoReader:
    """Decodes one connection's video. Raises GlsplatError without PyAV, or if it decodes none of a server's codecs."""

    def __init__(self) -> None:
        require_package("video", "av", "video", "leave video out")
        import av

        self._codecs: list[str] = []
        for name in _NAMES:
            with suppress(av.error.FFmpegError, ValueError):
                av.codec.Codec(name, "r")
                self._codecs.append(name)
        if not self._codecs:
            raise GlsplatError(f"this PyAV decodes none of {', '.join(_NAMES)}: install another, or leave video out")
        self._context: VideoCodecContext | None = None
        self._name = ""
        self._next = 0  # number of the picture that can be decoded next; 0: only a key frame can

    def request_fields(self) -> dict[str, Any]:
        """Return ``video`` of the next request: the codecs, and whether a key frame is needed."""
        return {"codecs": self._codecs} | ({} if self._next else {"key": True})

    def eyes(self, data: bytes, said: Mapping[str, Any], size: Any) -> tuple[Image, ...]:
        """Decode the eyes' pictures [H, W, 3], with alpha [H, W, 4], of ``size`` (width, height), left first.

        ``said`` is ``video`` of the reply. Returns () for invalid data; ``request_fields`` then requests a key frame.
        """
        import av

        try:
            number, key = int(said["number"]), bool(said["key"])
            if not (key or number == self._next):
                raise ValueError("its reference frame did not arrive")
            name = next(name for name, begins in _NAMES.items() if str(said["codec"]).startswith(begins))
            if self._context is None or (key and name != self._name):
                self._context, self._name = cast("VideoCodecContext", av.CodecContext.create(name, "r")), name
                self._context.options = {"flags": "low_delay"}  # decode each picture at once
                self._context.thread_count = 1
            (frame,) = self._context.decode(av.Packet(data))
            whole = np.asarray(frame.to_ndarray(format="rgb24"), np.uint8)
            eyes = [_part(whole, at, size) for at in said["eyes"]]
            if "alpha" in said:
                greys = [_part(whole, at, size)[..., :1] for at in said["alpha"]]
                eyes = [np.dstack(pair) for pair in zip(eyes, greys, strict=True)]
        except (av.error.FFmpegError, ArithmeticError, LookupError, TypeError, ValueError, StopIteration):
            self._context, self._next = None, 0
            return ()
        self._next = number + 1
        return tuple(eyes)


def _part(whole: Image, at: Any, size: Any) -> Image:
    (x, y), (width, height) = map(int, at), map(int, size)
    found = whole[y : y + height, x : x + width]
    if min(x, y) < 0 or found.shape[:2] != (height, width):
        raise ValueError(f"{width} x {height} at {x}, {y} of {whole.shape}")
    return found
