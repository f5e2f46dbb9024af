"""Clips that browsers play: VP9 in MP4 or WebM, by the encoder that comes with OpenCV."""

from __future__ import annotations

import os
import secrets
import sys
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
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

__all__ = ["CLIPS", "Clip"]

# H.264 would need an encoder under other terms (x264); VP9 is in every OpenCV wheel and plays in the same browsers
CLIPS = {".mp4": "vp09", ".webm": "VP90"}
_OLD = "mp4v"  # of an OpenCV that was built without VP9
_AHEAD = 4  # pictures that may wait for the encoder

# read once, when OpenCV's FFmpeg is first used: what goes wrong is said by an error, not by FFmpeg ("moov atom ...")
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")


class Clip:
    """A clip written frame by frame; it takes its name when the ``with`` block ends without an error.

    The ending of the name chooses the container. The pictures are encoded in a thread of their own, while the next
    ones are drawn: VP9 takes longer than many a frame. A ``sound`` goes into an .mp4; a .webm stays silent, as it takes
    none but Opus and Vorbis.
    """

    def __init__(self, path: str | Path, fps: float, sound: Sound | None = None) -> None:
        self._path, self._fps, self._sound = Path(path), fps, sound
        self._partial = self._path.parent / f".{secrets.token_hex(6)}{self._path.suffix.lower()}"
        self._writer: Any = None
        self._encoder = ThreadPoolExecutor(1, "encoder")
        self._waiting: list[Future[None]] = []
        self._frames = 0
        self.codec = "VP9"

    @property
    def summary(self) -> str:
        """Name, pictures, rate and codec, for people."""
        said = (
            "" if self._sound is None else ", sound of FLAC" if self._heard else ", silent: only .mp4 takes the sound"
        )
        return f"{self._path}: {self._frames} pictures, {self._fps:g} a second, {self.codec}{said}"

    @property
    def _heard(self) -> bool:
        return self._sound is not None and self._path.suffix.lower() == ".mp4"

    def add(self, image: NDArray[Any]) -> None:
        """Append an RGB picture [H, W, 3|4]; all of one size, odd sizes lose their last row or column."""
        if min(image.shape[:2]) < 2:
            raise FormatError(f"{self._path}: a clip needs pictures of at least 2x2 pixels")
        pixels = eight_bit(image)[: image.shape[0] // 2 * 2, : image.shape[1] // 2 * 2, :3]
        if self._writer is None:
            self._open(pixels.shape[1], pixels.shape[0])
        while len(self._waiting) >= _AHEAD:
            self._waiting.pop(0).result()
        self._frames += 1
        self._waiting.append(self._encoder.submit(self._write, pixels.copy()))

    def _open(self, width: int, height: int) -> None:
        codes = [CLIPS[self._path.suffix.lower()], *([_OLD] if self._path.suffix.lower() == ".mp4" else [])]
        for code in codes:
            with _silent():  # OpenCV prints that it does not know WebM's tag for VP9, and writes it all the same
                self._writer = cv2.VideoWriter(
                    str(self._partial), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*code), self._fps, (width, height)
                )
            if self._writer.isOpened():
                if code == _OLD:
                    self.codec = "MPEG-4 part 2, which browsers do not play: this OpenCV has no VP9"
                return
        raise FormatError(f"{self._path}: this OpenCV cannot write such a clip; try a folder/ of PNG files")

    def _write(self, pixels: Image) -> None:
        self._writer.write(cv2.cvtColor(np.ascontiguousarray(pixels), cv2.COLOR_RGB2BGR))

    def _verify(self) -> None:
        """OpenCV does not report failed writes: look whether all frames arrived, and the index behind them."""
        with _silent():
            reader = cv2.VideoCapture(str(self._partial), cv2.CAP_FFMPEG)
            told = reader.get(cv2.CAP_PROP_FRAME_COUNT) if reader.isOpened() else 0  # WebM: the duration's word
            reader.set(cv2.CAP_PROP_FORMAT, -1)  # packets as they are: nothing is decoded
            count = 0
            while count <= self._frames and reader.grab():
                count += 1
            reader.release()
        if not told == count == self._frames:
            raise FormatError(f"{self._path}: only a part of the clip could be written; is the disk full?")

    def __enter__(self) -> Clip:
        if not self._path.parent.is_dir() or not os.access(self._path.parent, os.W_OK):
            raise FormatError(f"{self._path}: cannot be written (no such folder, or not writable)")
        # a warning a frame when the disk is full; _verify says it once
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
                for written in self._waiting:
                    written.result()
                self._verify()
                if self._sound is not None and self._heard:
                    from glsplat.extras.speech.mp4 import add_sound  # here: most clips are silent

                    add_sound(self._partial, self._sound)
                os.replace(self._partial, self._path)
        except OSError as problem:
            raise FormatError(f"{self._path}: cannot be written ({problem.strerror})") from None
        finally:
            cv2.utils.logging.setLogLevel(self._log_level)
            self._partial.unlink(missing_ok=True)


@contextmanager
def _silent() -> Iterator[None]:
    """Keep what C code prints to standard error away from the terminal; for calls of milliseconds."""
    sys.stderr.flush()
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)
