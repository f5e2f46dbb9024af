"""Clips for browsers: VP9 in MP4 or WebM, by OpenCV's encoder."""

from __future__ import annotations

import os
import secrets
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError

from .output import Image, eight_bit

if TYPE_CHECKING:
    from glsplat.extras.speech.sound import Sound

# not H.264, whose encoder x264 has another licence; VP9 is in every OpenCV wheel and plays in the same browsers
CLIPS = {".mp4": "vp09", ".webm": "VP90"}
_FALLBACK = "mp4v"  # if OpenCV was built without VP9
_MAX_QUEUED = 4  # pictures that wait for the encoder

# read when OpenCV first uses FFmpeg: silences its messages, as errors are raised instead
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")


class Clip:
    """A clip written frame by frame; the file appears when the ``with`` block ends without an error.

    The suffix selects the container. A thread encodes pictures while the next ones are drawn, as VP9 often takes longer
    than a frame. A ``sound`` is stored in an .mp4 only: a .webm accepts just Opus and Vorbis. Raises
    MissingPackageError if an .mp4 is to have sound and PyAV is not installed.
    """

    def __init__(self, path: str | Path, fps: float, sound: Sound | None = None) -> None:
        self._path, self._fps, self._sound = Path(path), fps, sound
        self._partial = self._path.parent / f".{secrets.token_hex(6)}{self._path.suffix.lower()}"
        self._add_sound: Callable[[Path], None] | None = None
        if sound is not None and self._path.suffix.lower() == ".mp4":
            from glsplat.extras.speech.mp4 import add_sound  # here, before a frame is drawn: it needs PyAV

            self._add_sound = partial(add_sound, sound=sound)
        self._writer: Any = None
        self._encoder = ThreadPoolExecutor(1, "encoder")
        self._queued: list[Future[None]] = []
        self._frames = 0
        self.codec = "VP9"

    @property
    def summary(self) -> str:
        """A line with name, pictures, rate, codec and sound."""
        sound = ", sound of FLAC" if self._add_sound else ", silent: only .mp4 takes the sound"
        sound = "" if self._sound is None else sound
        return f"{self._path}: {self._frames} pictures, {self._fps:g} a second, {self.codec}{sound}"

    def add(self, image: NDArray[Any]) -> None:
        """Append an RGB picture [H, W, 3|4]. All need one size; an odd size loses its last row or column."""
        if min(image.shape[:2]) < 2:
            raise FormatError(f"{self._path}: a clip needs pictures of at least 2x2 pixels")
        pixels = eight_bit(image)[: image.shape[0] // 2 * 2, : image.shape[1] // 2 * 2, :3]
        if self._writer is None:
            self._open(pixels.shape[1], pixels.shape[0])
        while len(self._queued) >= _MAX_QUEUED:
            self._queued.pop(0).result()
        self._frames += 1
        self._queued.append(self._encoder.submit(self._write, pixels.copy()))

    def _open(self, width: int, height: int) -> None:
        codes = [CLIPS[self._path.suffix.lower()], *([_FALLBACK] if self._path.suffix.lower() == ".mp4" else [])]
        for code in codes:
            with _silent():  # OpenCV warns about WebM's tag for VP9, but writes it
                self._writer = cv2.VideoWriter(
                    str(self._partial), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*code), self._fps, (width, height)
                )
            if self._writer.isOpened():
                if code == _FALLBACK:
                    self.codec = "MPEG-4 part 2, which browsers do not play: this OpenCV has no VP9"
                return
        raise FormatError(f"{self._path}: this OpenCV cannot write such a clip; try a folder/ of PNG files")

    def _write(self, pixels: Image) -> None:
        self._writer.write(cv2.cvtColor(np.ascontiguousarray(pixels), cv2.COLOR_RGB2BGR))

    def _verify(self) -> None:
        """Raise FormatError unless the file has all frames and their index: OpenCV does not report failed writes."""
        with _silent():
            reader = cv2.VideoCapture(str(self._partial), cv2.CAP_FFMPEG)
            declared = reader.get(cv2.CAP_PROP_FRAME_COUNT) if reader.isOpened() else 0  # WebM: from the duration
            reader.set(cv2.CAP_PROP_FORMAT, -1)  # raw packets: nothing is decoded
            count = 0
            while count <= self._frames and reader.grab():
                count += 1
            reader.release()
        if not declared == count == self._frames:
            raise FormatError(f"{self._path}: only a part of the clip could be written; is the disk full?")

    def __enter__(self) -> Clip:
        if not self._path.parent.is_dir() or not os.access(self._path.parent, os.W_OK):
            raise FormatError(f"{self._path}: cannot be written (no such folder, or not writable)")
        # OpenCV warns at every frame when the disk is full; _verify raises once
        self._log_level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._encoder.shutdown(wait=True, cancel_futures=kind is not None)
        try:
            if self._writer is not None:
                self._writer.release()
            if kind is None and self._frames:
                for written in self._queued:
                    written.result()
                self._verify()
                if self._add_sound is not None:
                    self._add_sound(self._partial)
                os.replace(self._partial, self._path)
        except OSError as problem:
            raise FormatError(f"{self._path}: cannot be written ({problem.strerror})") from None
        finally:
            cv2.utils.logging.setLogLevel(self._log_level)
            self._partial.unlink(missing_ok=True)


@contextmanager
def _silent() -> Iterator[None]:
    """Discard what C code prints to standard error. For short calls only."""
    sys.stderr.flush()
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)
