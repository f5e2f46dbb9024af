"""Write pictures and arrays, through a temporary file, so that no partial file remains."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError
from glsplat.io.files import replace_file
from glsplat.pictures import straight

if TYPE_CHECKING:
    from glsplat.renderer import Renderer

Image = NDArray[np.uint8]


def eight_bit(image: NDArray[Any]) -> Image:
    """Return RGB(A) as uint8; floats are clamped to [0, 1] and rounded."""
    if image.dtype == np.uint8:
        return image
    return np.rint(np.clip(np.nan_to_num(image), 0, 1) * 255).astype(np.uint8)


def side_by_side(images: NDArray[Any]) -> Image:
    """Return views [V, H, W, C] as one 8-bit picture [H, V * W, 3]."""
    return joined_views(eight_bit(images[..., :3]))


def joined_views(images: NDArray[Any]) -> NDArray[Any]:
    """Return views [V, H, W, ...] as one picture [H, V * W, ...] of the same values."""
    return np.concatenate(list(images), axis=1)


def stack(rows: Sequence[Sequence[Image]], gap: int = 4) -> Image:
    """Return a contact sheet of equally sized pictures; each list is a row."""
    height, width = rows[0][0].shape[:2]
    columns = max(map(len, rows))
    sheet = np.full((len(rows) * (height + gap) - gap, columns * (width + gap) - gap, 3), 40, np.uint8)
    for y, row in enumerate(rows):
        for x, image in enumerate(row):
            top, left = y * (height + gap), x * (width + gap)
            sheet[top : top + height, left : left + width] = image[..., :3]
    return sheet


def label(image: Image, text: str) -> Image:
    """Return a copy with ``text`` in its upper left corner."""
    out = np.ascontiguousarray(image[..., :3]).copy()
    scale = max(0.4, image.shape[0] / 900)
    cv2.putText(out, text, (6, int(24 * scale) + 2), cv2.FONT_HERSHEY_SIMPLEX, scale, (230, 230, 230), 1, cv2.LINE_AA)
    return out


def save_png(path: str | Path, image: NDArray[Any]) -> None:
    """Write a picture [H, W, 3|4] as PNG. RGBA, premultiplied as from the renderer, is stored straight."""
    pixels = eight_bit(straight(image) if image.shape[2] == 4 else image)
    order = cv2.COLOR_RGBA2BGRA if pixels.shape[2] == 4 else cv2.COLOR_RGB2BGR
    _write_png(path, cv2.cvtColor(np.ascontiguousarray(pixels), order))


def _write_png(path: str | Path, pixels: NDArray[Any]) -> None:
    ok, data = cv2.imencode(".png", pixels)
    if not ok:
        raise FormatError(f"{path}: the picture could not be encoded as PNG")
    replace_file(path, [data.tobytes()])


def save_npy(path: str | Path, array: NDArray[Any]) -> None:
    """Write an array as .npy."""
    buffer = io.BytesIO()
    np.save(buffer, array)
    replace_file(path, [buffer.getbuffer()])


def save_depth(path: str | Path, depths: NDArray[np.float32], several: bool) -> None:
    """Write depths [V, H, W] in metres as .npy (not ``several``: [H, W] of one view), or as .png in 16-bit grey.

    The PNG has millimetres, views side by side: 0 is empty, 65535 is 65.535 m or more.
    """
    if Path(path).suffix.lower() == ".npy":
        return save_npy(path, depths if several else depths[0])
    millimetres = np.rint(np.clip(joined_views(depths).astype(np.float64) * 1000, 0, 65535))
    nearest = np.where(
        joined_views(depths) > 0, np.maximum(millimetres, 1), 0
    )  # less than half a millimetre is not empty
    _write_png(path, nearest.astype(np.uint16))


def frame_report(renderer: Renderer) -> dict[str, Any]:
    """Return driver, float target, counts and stage times of the last frame, as JSON values."""
    stats = renderer.stats
    return {
        "driver": renderer.driver,
        "float_target": renderer.target_dtype,
        "splats": stats.splats,
        "levels": stats.levels,
        "drawn": stats.drawn,
        "skipped": stats.skipped,
        "culled": stats.culled,
        "timings_ms": {stage: round(ms, 3) for stage, ms in renderer.timings.items()},
    }
