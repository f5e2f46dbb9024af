"""A client's video decoder (PyAV). Every picture is decoded in order, as each is the reference of the next."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import GlsplatError
from glsplat.optional import require_package

if TYPE_CHECKING:
    from av import VideoCodecContext

Image = NDArray[np.uint8]

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
