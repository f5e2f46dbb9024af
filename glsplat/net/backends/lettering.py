"""Draws labels and notices into finished 8-bit pictures, on the CPU.

Text is composited after projection: each board of text is upright, wholly inside the picture and of a readable size,
whatever the cameras are.
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera
from glsplat.net.room_view import Label
from glsplat.renderer.stats import Box, union

__all__ = ["draw_labels"]

_MIN_LINE_PX, _MIN_LINE_SHARE = 12.0, 1 / 40  # of a line: pixels, and of the picture's height, however far away it is
_MAX_LINE_SHARE = 1 / 8  # of the picture's height: a line at most, however near it is
_MAX_BOARD_SHARE = 0.5  # of the picture's height: all lines of a board at most
_MAX_LINES = 8
_MIN_DISTANCE_M = 0.3  # metres from the eyes: labels stand no nearer, so that both eyes can read them
_NOTICE_DISTANCE_M = 1.5  # metres from the eyes, where the picture allows it
_NOTICE_PLACE = 0.8  # of the way from the middle of the picture to its lower edge
_NOTICE_SHARE = 0.03  # of the picture's height, a line
_MAX_OFFSET_PX = 1e7  # pixels from the picture, farther than which nothing is placed
_ROUNDING_PX = 1e-3  # pixels
_RIM_PX = 2.0  # pixels around a picture that count as in it: so far what is smaller than a pixel is spread
_ROW_PX, _FONT_PX, _WEIGHT = 40, 29, 500  # pixels of a line and of its letters before they are scaled; of their strokes
_MARGIN_PX = 8
_MAX_WIDTH_PX = 8192
_GAP_PX, _MOVED_OPACITY = 2.0, 0.8  # pixels between two boards, and the opacity of one that had to give way
_BOARD_ALPHA, _INK_GREY = 0.6, 240  # alpha of the board, grey of the letters
_CORNERS = np.array(list(product((0, 1), repeat=3)))

F64 = NDArray[np.float64]


@dataclass(slots=True, eq=False)
class _Board:
    """Text in a picture: ``boxes`` [V, 4] are its left, upper, right and lower edge in each view, in pixels."""

    patch: NDArray[np.uint8]
    boxes: F64
    opacity: float


def draw_labels(images: NDArray[np.uint8], cameras: Sequence[Camera], labels: Sequence[Label], notice: str = "") -> Box:
    """Draw labels and a notice into premultiplied images [V, H, W, 4]; return the box that changed, which may be empty.

    A label is in all views if any view shows its thing. Of two labels that would overlap, the farther one moves above,
    below or beside the nearer, and is fainter. The notice does not move.
    """
    size = cameras[0].width, cameras[0].height
    boards: list[_Board] = []
    if notice:
        position, line = _notice_position(cameras), max(_least(size), _NOTICE_SHARE * size[1])
        boards.append(_placed(notice, _seen(cameras, position)[0], line, size, 1.0, []))
    middle = np.mean([camera.position for camera in cameras], axis=0)
    for label in sorted(labels, key=lambda one: float(np.linalg.norm(one.position - middle))):
        if label.opacity > 0 and _shown(label, cameras):
            centres, depth = _seen(cameras, label.position)
            line = max(_least(size), min(_MAX_LINE_SHARE * size[1], label.height * float(cameras[0].K[1, 1]) / depth))
            boards.append(_placed(label.text, centres, line, size, label.opacity, [one.boxes for one in boards]))
    changed: Box = (0, 0, 0, 0)
    for board in reversed(boards):  # the farthest first, the notice last
        for image, (left, top, right, bottom) in zip(images, board.boxes, strict=True):
            changed = union(changed, _draw(image, board, left, top, right - left, bottom - top))
    return changed


def _least(size: tuple[int, int]) -> float:
    """Return the smallest readable height of a line, in pixels, in a picture of that size."""
    return max(_MIN_LINE_PX, _MIN_LINE_SHARE * size[1])


def _notice_position(cameras: Sequence[Camera]) -> F64:
    """Return the position [3] of a notice, in front of both eyes and near the lower edge of the first eye's view."""
    first = cameras[0]
    down = _NOTICE_PLACE * (first.height - float(first.K[1, 2])) / float(first.K[1, 1])
    eyes = np.mean([camera.position for camera in cameras], axis=0)
    position: F64 = eyes + _NOTICE_DISTANCE_M * (first.viewmat[2, :3] + down * first.viewmat[1, :3])
    return position


def _seen(cameras: Sequence[Camera], position: F64) -> tuple[F64, float]:
    """Project a position; return its pixels [V, 2] and its mean depth in metres, at least ``_MIN_DISTANCE_M``."""
    points = np.array([camera.viewmat[:3, :3] @ position + camera.viewmat[:3, 3] for camera in cameras])
    depths = np.maximum(points[:, 2], _MIN_DISTANCE_M)
    pixels = [
        (camera.K[0, 0] * x / depth + camera.K[0, 2], camera.K[1, 1] * y / depth + camera.K[1, 2])
        for camera, (x, y, _), depth in zip(cameras, points, depths, strict=True)
    ]
    return np.clip(np.array(pixels), -_MAX_OFFSET_PX, _MAX_OFFSET_PX), float(depths.mean())


def _shown(label: Label, cameras: Sequence[Camera]) -> bool:
    """Return whether any view may show a part of a label's thing."""
    if any(_meets(camera, label.position[None]) for camera in cameras):
        return True
    box = None if label.box is None else label.box()
    return box is not None and any(_meets(camera, box[_CORNERS, (0, 1, 2)]) for camera in cameras)


def _meets(camera: Camera, corners: F64) -> bool:
    """Return whether the hull of corners [N, 3] may be in a picture: not all are beyond one of its edges."""
    x, y, z = (corners @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]).T
    right, down = camera.K[0, 0] * x + camera.K[0, 2] * z, camera.K[1, 1] * y + camera.K[1, 2] * z
    depth = z > camera.near, z < camera.far
    across = right > -_RIM_PX * z, right < (camera.width + _RIM_PX) * z
    along = down > -_RIM_PX * z, down < (camera.height + _RIM_PX) * z
    return all(bool(each.any()) for each in (*depth, *across, *along))


def _placed(
    text: str, centres: F64, line: float, size: tuple[int, int], opacity: float, taken: Sequence[F64]
) -> _Board:
    """Return text of about ``line`` pixels a line, centred at ``centres`` [V, 2] or as near as possible."""
    patch = _fitted(text, line, size)
    tall = _line(patch, line, size) * len(patch) / _ROW_PX
    half = np.array([tall * patch.shape[1] / len(patch), tall]) / 2
    wanted = _inside(np.concatenate([centres - half, centres + half], axis=1), size)
    boxes = _apart(wanted, size, taken)
    return _Board(patch, boxes, opacity * (1.0 if boxes is wanted else _MOVED_OPACITY))


def _fitted(text: str, line: float, size: tuple[int, int]) -> NDArray[np.uint8]:
    """Return text in as few lines as are readable in a picture of that size, else in those of the largest letters."""
    best = _patch(text, 1)
    for lines in range(2, _MAX_LINES + 1):
        if _line(best, line, size) >= min(line, _least(size)):
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


def _apart(boxes: F64, size: tuple[int, int], taken: Sequence[F64]) -> F64:
    """Move ``boxes`` [V, 4] as little as possible so that no view shows them over ``taken``: up, else down, or aside.

    The move is the same in all views. They stay where they are if nothing is in the way, or there is no room.
    """
    if not _covers(boxes[None], taken)[0]:
        return boxes
    others = np.array(taken)  # [T, V, 4]
    # moves that end next to one of the others
    before = (others[:, :, :2] - boxes[:, 2:]).min(axis=1) - _GAP_PX
    behind = (others[:, :, 2:] - boxes[:, :2]).max(axis=1) + _GAP_PX
    columns, rows = np.concatenate([[(0.0, 0.0)], before, behind]).T
    for across, along in ((columns[:1], rows[rows <= 0]), (columns[:1], rows), (columns, rows)):
        moves = np.array(list(product(across, along)))
        moved = boxes + np.tile(moves, 2)[:, None]
        over = np.maximum(-moved[:, :, :2], moved[:, :, 2:] - size).max(axis=(1, 2))  # pixels beyond the picture
        fits = over < _ROUNDING_PX
        fits[fits] = ~_covers(moved[fits], taken)
        if fits.any():
            return np.asarray(moved[fits][np.abs(moves[fits]).sum(axis=1).argmin()])
    return boxes


def _covers(boxes: F64, taken: Sequence[F64]) -> NDArray[np.bool_]:
    """Return [N] whether any view shows boxes [N, V, 4] over one of ``taken``."""
    found = np.zeros(len(boxes), np.bool_)
    for other in taken:
        apart = (boxes[:, :, :2] >= other[:, 2:]) | (other[:, :2] >= boxes[:, :, 2:])
        found |= ~np.all(np.any(apart, axis=2), axis=1)
    return found


def _draw(image: NDArray[np.uint8], board: _Board, left: float, top: float, width: float, height: float) -> Box:
    """Draw a board into a picture at subpixel accuracy; return the box that changed."""
    patch = board.patch
    x0, y0 = max(0, int(np.floor(left))), max(0, int(np.floor(top)))
    x1, y1 = min(image.shape[1], int(np.ceil(left + width))), min(image.shape[0], int(np.ceil(top + height)))
    # shrink first, so that thin strokes do not flicker: warping samples only four pixels
    shrunk = max(1, min(patch.shape[1], round(width))), max(1, min(patch.shape[0], round(height)))
    patch = cv2.convertScaleAbs(cv2.resize(patch, shrunk, interpolation=cv2.INTER_AREA), alpha=board.opacity)
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
