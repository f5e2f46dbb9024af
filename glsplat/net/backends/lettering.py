"""Writes a notice into finished 8-bit pictures, on the CPU.

Text is composited after projection: its board is upright, wholly inside the picture and of a readable size, whatever
the cameras are.
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F64
from glsplat.camera import Camera
from glsplat.renderer.stats import Box, union

_MIN_LINE_PX = 12.0  # of a line
_LINE_SHARE = 0.03  # of the picture's height, a line
_MAX_BOARD_SHARE = 0.5  # of the picture's height: all lines of a board at most
_MAX_LINES = 8
_MIN_DISTANCE_M = 0.3  # metres from each eye: nearer than that no point is projected
_DISTANCE_M = 1.5  # metres from the eyes, where the picture allows it
_PLACE = 0.8  # of the way from the middle of the picture to its lower edge
_MAX_OFFSET_PX = 1e7  # pixels from the picture, farther than which nothing is placed
_ROW_PX, _FONT_PX, _WEIGHT = 40, 29, 500  # pixels of a line and of its letters before they are scaled; of their strokes
_MARGIN_PX = 8
_MAX_WIDTH_PX = 8192
_BOARD_ALPHA, _INK_GREY = 0.6, 240  # alpha of the board, grey of the letters


def write_notice(images: NDArray[np.uint8], cameras: Sequence[Camera], text: str) -> Box:
    """Write a text near the lower edge of premultiplied images [V, H, W, 4]; return the box that changed."""
    size = cameras[0].width, cameras[0].height
    line = max(_MIN_LINE_PX, _LINE_SHARE * size[1])
    patch = _fitted(text, line, size)
    tall = _line(patch, line, size) * len(patch) / _ROW_PX
    half = np.array([tall * patch.shape[1] / len(patch), tall]) / 2
    centres = _seen(cameras, _position(cameras))
    changed: Box = (0, 0, 0, 0)
    boxes = _inside(np.concatenate([centres - half, centres + half], axis=1), size)
    for image, (left, top, right, bottom) in zip(images, boxes, strict=True):
        changed = union(changed, _draw(image, patch, left, top, right - left, bottom - top))
    return changed


def _position(cameras: Sequence[Camera]) -> F64:
    """Return the position [3] of the board, in front of both eyes and near the lower edge of the first eye's view."""
    first = cameras[0]
    down = _PLACE * (first.height - float(first.K[1, 2])) / float(first.K[1, 1])
    eyes = np.mean([camera.position for camera in cameras], axis=0)
    position: F64 = eyes + _DISTANCE_M * (first.viewmat[2, :3] + down * first.viewmat[1, :3])
    return position


def _seen(cameras: Sequence[Camera], position: F64) -> F64:
    """Project a position; return its pixels [V, 2]."""
    points = np.array([camera.viewmat[:3, :3] @ position + camera.viewmat[:3, 3] for camera in cameras])
    depths = np.maximum(points[:, 2], _MIN_DISTANCE_M)
    pixels = [
        (camera.K[0, 0] * x / depth + camera.K[0, 2], camera.K[1, 1] * y / depth + camera.K[1, 2])
        for camera, (x, y, _), depth in zip(cameras, points, depths, strict=True)
    ]
    return np.clip(np.array(pixels), -_MAX_OFFSET_PX, _MAX_OFFSET_PX)


def _fitted(text: str, line: float, size: tuple[int, int]) -> NDArray[np.uint8]:
    """Return text in as few lines as are readable in a picture of that size, else in those of the largest letters."""
    best = _patch(text, 1)
    for lines in range(2, _MAX_LINES + 1):
        if _line(best, line, size) >= min(line, _MIN_LINE_PX):
            break
        best = max(best, _patch(text, lines), key=lambda patch: _line(patch, line, size))
    return best


def _line(patch: NDArray[np.uint8], line: float, size: tuple[int, int]) -> float:
    """Return the height of a line in pixels, at most ``line``, with which all text fits into the picture."""
    return min(line, size[0] * _ROW_PX / patch.shape[1], _MAX_BOARD_SHARE * size[1] * _ROW_PX / len(patch))


def _inside(boxes: F64, size: tuple[int, int]) -> F64:
    """Move ``boxes`` [V, 4] into the picture, by the same in all views if possible, which keeps their depth."""
    low, high = -boxes[:, :2], np.array(size) - boxes[:, 2:]  # limits of each move
    least, most = low.max(axis=0), high.min(axis=0)
    moves = np.where(least <= most, np.clip(0.0, least, most), np.clip(0.0, low, high))
    return boxes + np.concatenate([moves, moves], axis=1)


def _draw(
    image: NDArray[np.uint8], patch: NDArray[np.uint8], left: float, top: float, width: float, height: float
) -> Box:
    """Draw a board into a picture at subpixel accuracy; return the box that changed."""
    x0, y0 = max(0, int(np.floor(left))), max(0, int(np.floor(top)))
    x1, y1 = min(image.shape[1], int(np.ceil(left + width))), min(image.shape[0], int(np.ceil(top + height)))
    # shrink first, so that thin strokes do not flicker: warping samples only four pixels
    shrunk = max(1, min(patch.shape[1], round(width))), max(1, min(patch.shape[0], round(height)))
    patch = np.asarray(cv2.resize(patch, shrunk, interpolation=cv2.INTER_AREA), np.uint8)
    # pixel (i, j) covers [i, i+1) x [j, j+1) here, OpenCV's centres are at whole numbers
    across, along = width / patch.shape[1], height / patch.shape[0]
    warp = np.array([[across, 0, left - x0 + (across - 1) / 2], [0, along, top - y0 + (along - 1) / 2]])
    drawn = cv2.warpAffine(patch, warp, (x1 - x0, y1 - y0), flags=cv2.INTER_LINEAR)
    kept = cv2.merge([cv2.bitwise_not(drawn[:, :, 3])] * 4)
    under = image[y0:y1, x0:x1]
    under[:] = cv2.add(drawn, cv2.multiply(under, kept, scale=1 / 255))
    return x0, y0, x1 - x0, y1 - y0


@lru_cache(maxsize=256)
def _patch(text: str, lines: int) -> NDArray[np.uint8]:
    """Return light letters on a dark, transparent board [rows, columns, 4], premultiplied, of at most ``lines``."""
    shown = text if hasattr(cv2, "FontFace") else text.encode("ascii", "replace").decode()
    written = [_written(part) for part in _wrapped(shown, lines)]
    canvas = np.zeros((_ROW_PX * len(written), max(part.shape[1] for part in written), 3), np.uint8)
    for row, part in enumerate(written):
        start = (canvas.shape[1] - part.shape[1]) // 2
        canvas[_ROW_PX * row : _ROW_PX * (row + 1), start : start + part.shape[1]] = part
    ink = canvas[:, :, :1].astype(np.float32) / 255
    out = np.concatenate([np.repeat(ink * _INK_GREY, 3, axis=2), 255 * (ink + (1 - ink) * _BOARD_ALPHA)], axis=2)
    out[[0, -1]] = out[:, [0, -1]] = 0  # a rim, for a smooth edge
    patch = np.rint(out).astype(np.uint8)
    patch.setflags(write=False)
    return patch


def _wrapped(text: str, lines: int) -> list[str]:
    """Return a text in at most ``lines`` of about equal length; longer words are split."""
    for wide in range(-(-len(text) // lines), len(text)):
        found = textwrap.wrap(text, wide)
        if len(found) <= lines:
            return found
    return [text]


def _written(text: str) -> NDArray[np.uint8]:
    """Return white letters on black [rows, columns, 3]."""
    start, white = (_MARGIN_PX, _ROW_PX - 12), (255, 255, 255)
    if hasattr(cv2, "FontFace"):  # OpenCV 5: all scripts
        face = cv2.FontFace("sans")
        x, _, wide, _ = cv2.getTextSize((_MAX_WIDTH_PX, _ROW_PX), text, start, face, _FONT_PX, _WEIGHT)
        canvas = np.zeros((_ROW_PX, x + wide + _MARGIN_PX, 3), np.uint8)
        cv2.putText(canvas, text, start, white, face, _FONT_PX, _WEIGHT)
    else:
        (wide, _), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.9, 2)
        canvas = np.zeros((_ROW_PX, 2 * _MARGIN_PX + wide, 3), np.uint8)
        cv2.putText(canvas, text, start, cv2.FONT_HERSHEY_SIMPLEX, 0.9, white, 2, cv2.LINE_AA)
    return canvas
