"""Writing pictures: always to a temporary neighbour first, so that no partial file is left behind."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError
from glsplat.io.files import replace_file
from glsplat.pictures import straight

__all__ = ["Image", "eight_bit", "joined_views", "label", "save_depth", "save_npy", "save_png", "side_by_side", "stack"]

Image = NDArray[np.uint8]


def eight_bit(image: NDArray[Any]) -> Image:
    """RGB(A) uint8 as it is, float clamped to [0, 1] and rounded."""
    if image.dtype == np.uint8:
        return image
    return np.rint(np.clip(np.nan_to_num(image), 0, 1) * 255).astype(np.uint8)


def side_by_side(images: NDArray[Any]) -> Image:
    """[V, H, W, C] to one [H, V * W, 3] picture."""
    return np.concatenate(list(eight_bit(images[..., :3])), axis=1)


def joined_views(images: NDArray[Any]) -> NDArray[Any]:
    """[V, H, W, ...] to one [H, V * W, ...] picture, values and channels as they are."""
    return np.concatenate(list(images), axis=1)


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


def save_depth(path: str | Path, depths: NDArray[np.float32], several: bool) -> None:
    """Write depths [V, H, W] in metres: .npy as they are (one view without ``several``: [H, W]), .png as 16-bit grey.

    The picture holds millimetres, views side by side: 0 is nothing, and 65535 is 65.535 m and all beyond.
    """
    if Path(path).suffix.lower() == ".npy":
        return save_npy(path, depths if several else depths[0])
    millimetres = np.rint(np.clip(joined_views(depths).astype(np.float64) * 1000, 0, 65535))
    nearest = np.where(joined_views(depths) > 0, np.maximum(millimetres, 1), 0)  # half a millimetre is not nothing
    ok, data = cv2.imencode(".png", nearest.astype(np.uint16))
    if not ok:
        raise FormatError(f"{path}: the depths could not be encoded as PNG")
    replace_file(path, [data.tobytes()])
