"""Writing pictures and clips: always to a temporary neighbour first, so that no partial file is left behind."""

from __future__ import annotations

import io
import os
import secrets
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError
from glsplat.formats.files import replace_file
from glsplat.pictures import straight

__all__ = ["Clip", "eight_bit", "label", "save_npy", "save_png", "side_by_side", "stack"]

Image = NDArray[np.uint8]


def eight_bit(image: NDArray[Any]) -> Image:
    """RGB(A) uint8 as it is, float clamped to [0, 1] and rounded."""
    if image.dtype == np.uint8:
        return image
    return np.rint(np.clip(np.nan_to_num(image), 0, 1) * 255).astype(np.uint8)


def side_by_side(images: NDArray[Any]) -> Image:
    """[V, H, W, C] to one [H, V * W, 3] picture."""
    return np.concatenate(list(eight_bit(images[..., :3])), axis=1)


def stack(rows: Sequence[Sequence[Image]], gap: int = 4) -> Image:
    """A contact sheet of equally sized pictures, a list a row."""
    height, width = rows[0][0].shape[:2]
    columns = max(map(len, rows))
    sheet = np.full((len(rows) * (height + gap) - gap, columns * (width + gap) - gap, 3), 40, np.uint8)
    for y, row in enumerate(rows):
        for x, image in enumerate(row):
            top, left = y * (height + gap), x * (width + gap)
            sheet[top : top + height, left : left + width] = image[..., :3]
    return sheet


def label(image: Image, text: str) -> Image:
    """A copy with ``text`` in its upper left corner."""
    out = np.ascontiguousarray(image[..., :3]).copy()
    scale = max(0.4, image.shape[0] / 900)
    cv2.putText(out, text, (6, int(24 * scale) + 2), cv2.FONT_HERSHEY_SIMPLEX, scale, (230, 230, 230), 1, cv2.LINE_AA)
    return out


def save_png(path: str | Path, image: NDArray[Any]) -> None:
    """Write a picture [H, W, 3|4]. RGBA is as the renderer gives it (colours times alpha) and is stored straight."""
    pixels = eight_bit(straight(image) if image.shape[2] == 4 else image)
    order = cv2.COLOR_RGBA2BGRA if pixels.shape[2] == 4 else cv2.COLOR_RGB2BGR
    ok, data = cv2.imencode(".png", cv2.cvtColor(np.ascontiguousarray(pixels), order))
    if not ok:
        raise FormatError(f"{path}: the picture could not be encoded as PNG")
    replace_file(path, [data.tobytes()])


def save_npy(path: str | Path, array: NDArray[Any]) -> None:
    """Write an array as .npy."""
    buffer = io.BytesIO()
    np.save(buffer, array)
    replace_file(path, [buffer.getbuffer()])


class Clip:
    """An MP4 written frame by frame; it takes its name when the ``with`` block ends without an error."""

    def __init__(self, path: str | Path, fps: float) -> None:
        self._path, self._fps = Path(path), fps
        self._partial = self._path.parent / f".{secrets.token_hex(6)}.mp4"
        self._writer: Any = None
        self._frames = 0

    def add(self, image: NDArray[Any]) -> None:
        """Append an RGB picture [H, W, 3|4]; all of one size, odd sizes lose their last row or column."""
        if min(image.shape[:2]) < 2:
            raise FormatError(f"{self._path}: MP4 needs pictures of at least 2x2 pixels")
        pixels = eight_bit(image)[: image.shape[0] // 2 * 2, : image.shape[1] // 2 * 2, :3]
        if self._writer is None:
            size = pixels.shape[1], pixels.shape[0]
            fourcc = cv2.VideoWriter.fourcc(*"mp4v")
            self._writer = cv2.VideoWriter(str(self._partial), fourcc, self._fps, size)
            if not self._writer.isOpened():
                raise FormatError(f"{self._path}: cannot be written as MP4 (is the folder writable?)")
        self._frames += 1
        self._writer.write(cv2.cvtColor(np.ascontiguousarray(pixels), cv2.COLOR_RGB2BGR))

    def _verify(self) -> None:
        """OpenCV does not report failed writes: look whether all frames arrived."""
        reader = cv2.VideoCapture(str(self._partial))
        count = int(reader.get(cv2.CAP_PROP_FRAME_COUNT)) if reader.isOpened() else 0
        reader.release()
        if count != self._frames:
            raise FormatError(f"{self._path}: {count} of {self._frames} frames were written (is the disk full?)")

    def __enter__(self) -> Clip:
        if not self._path.parent.is_dir() or not os.access(self._path.parent, os.W_OK):
            raise FormatError(f"{self._path}: cannot be written (no such folder, or not writable)")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._writer is not None:
            self._writer.release()
        try:
            if kind is None and self._partial.exists():
                self._verify()
                os.replace(self._partial, self._path)
        except OSError as problem:
            raise FormatError(f"{self._path}: cannot be written ({problem.strerror})") from None
        finally:
            self._partial.unlink(missing_ok=True)
