"""Lettering: the words of labels.py into finished 8-bit pictures, on the host."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera
from glsplat.net.backends.labels import Label
from glsplat.passes.stats import union

__all__ = ["draw_labels"]

_LEAST, _SHARE = 11.0, 1 / 40  # pixels, and of the picture's height, that a label has at least, however far away it is
_ROWS = 40  # pixels of a label before it is projected
_MARGIN = 10
_WIDEST = 4096
_GAP, _FADED = 2.0, 0.8  # pixels between two labels, and what is left of one that had to give way
_BACK, _INK = 0.55, 235  # alpha of the board, grey of the letters

Box = tuple[int, int, int, int]  # x, y, width, height


def draw_labels(images: NDArray[np.uint8], cameras: Sequence[Camera], labels: Sequence[Label]) -> Box:
    """Write labels into images [V, H, W, 4], premultiplied, farthest first; returns the box that holds what changed.

    Empty where nothing did. Where two would cover each other the farther one stands above the nearer, and fainter.
    """
    changed: Box = (0, 0, 0, 0)
    for label, corners, opacity in _placed(labels, cameras):
        for image, camera in zip(images, cameras, strict=True):
            changed = union(changed, _draw(image, camera, corners, _patch(label.text), opacity))
    return changed


def _placed(labels: Sequence[Label], cameras: Sequence[Camera]) -> list[tuple[Label, NDArray[np.float64], float]]:
    """Each label that is in front of all eyes with its corners [4, 3] and its opacity, the farthest first."""
    middle = np.mean([camera.position for camera in cameras], axis=0)
    taken: list[NDArray[np.float64]] = []
    found = []
    for label in sorted(labels, key=lambda one: float(np.linalg.norm(one.place - middle))):
        corners = _corners(label, cameras)
        if corners is None:
            continue
        moved = _apart(corners, cameras, taken)
        taken.append(_boxes(moved, cameras))
        found.append((label, moved, label.opacity * (1.0 if moved is corners else _FADED)))
    return found[::-1]


def _apart(
    corners: NDArray[np.float64], cameras: Sequence[Camera], taken: Sequence[NDArray[np.float64]]
) -> NDArray[np.float64]:
    """``corners`` [4, 3] raised so far that no eye sees them over one of ``taken``; lowered where up is out of sight.

    The board stays at its distance, so both eyes see it there. Unmoved where there is no room for it at all.
    """
    first, seen = cameras[0], _boxes(corners, cameras)
    down = np.mean([camera.viewmat[1, :3] for camera in cameras], axis=0)
    deep = np.mean([(corners @ camera.viewmat[2, :3] + camera.viewmat[2, 3]).mean() for camera in cameras])
    for way in (-1.0, 1.0):
        moved, boxes = corners, seen
        for _ in range(len(taken) + 1):  # one that is passed is not met again
            hit = next((other for other in taken if _cover(boxes, other)), None)
            if hit is None:
                break
            pixels = (boxes[:, 3] - hit[:, 1] if way < 0 else hit[:, 3] - boxes[:, 1]).max() + _GAP
            moved = moved + way * down * pixels * deep / float(first.K[1, 1])
            boxes = _boxes(moved, cameras)
        inside = boxes[:, 1].min() >= min(0.0, seen[:, 1].min()) and boxes[:, 3].max() <= max(
            first.height, seen[:, 3].max()
        )
        if moved is corners or inside:
            return moved
    return corners


def _boxes(corners: NDArray[np.float64], cameras: Sequence[Camera]) -> NDArray[np.float64]:
    """[V, 4] pixels: left, upper, right and lower edge of a board in each picture."""
    found = []
    for camera in cameras:
        seen = corners @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
        pixels = (seen @ camera.K.T)[:, :2] / np.maximum(seen[:, 2:], camera.near)
        found.append(np.concatenate([pixels.min(axis=0), pixels.max(axis=0)]))
    return np.array(found)


def _cover(one: NDArray[np.float64], other: NDArray[np.float64]) -> bool:
    """Whether two boards cover each other in a picture of any eye."""
    return bool(np.any(np.all((one[:, :2] < other[:, 2:]) & (other[:, :2] < one[:, 2:]), axis=1)))


def _corners(label: Label, cameras: Sequence[Camera]) -> NDArray[np.float64] | None:
    """[4, 3] of the board in the room, from its upper left as it is read; None where it is not in front of all eyes."""
    depths = [float(camera.viewmat[2, :3] @ label.place + camera.viewmat[2, 3]) for camera in cameras]
    if not all(camera.near < z < camera.far for z, camera in zip(depths, cameras, strict=True)):
        return None
    least = max(_LEAST, _SHARE * cameras[0].height)
    height = max(label.height, least * float(np.mean(depths)) / float(cameras[0].K[1, 1]))
    rows, columns = _patch(label.text).shape[:2]
    right, down = (np.mean([camera.viewmat[row, :3] for camera in cameras], axis=0) for row in (0, 1))
    across, along = right * height * columns / rows / 2, down * height / 2
    return np.array([label.place + x * across + y * along for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))])


def _draw(
    image: NDArray[np.uint8], camera: Camera, corners: NDArray[np.float64], patch: NDArray[np.uint8], opacity: float
) -> Box:
    """One board in one picture; the box that it changed."""
    seen = corners @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
    if seen[:, 2].min() <= camera.near:
        return 0, 0, 0, 0
    pixels = (seen @ camera.K.T)[:, :2] / seen[:, 2:]
    x0, y0 = np.clip(np.floor(pixels.min(axis=0)) - 1, 0, (camera.width, camera.height)).astype(int)
    x1, y1 = np.clip(np.ceil(pixels.max(axis=0)) + 1, 0, (camera.width, camera.height)).astype(int)
    if x1 <= x0 or y1 <= y0:
        return 0, 0, 0, 0
    # shrunk first, so that thin strokes do not flicker: warping looks at four pixels only
    tall = float(np.linalg.norm(pixels[3] - pixels[0]))
    scale = min(1.0, max(1.0, tall) / len(patch))
    if scale < 1:
        patch = cv2.resize(patch, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA).astype(np.uint8)
    rows, columns = patch.shape[:2]
    # pixel (i, j) covers [i, i+1) x [j, j+1) here, OpenCV's centres are at whole numbers
    ends = np.array([(0, 0), (columns, 0), (columns, rows), (0, rows)], np.float32) - np.float32(0.5)
    warp = cv2.getPerspectiveTransform(ends, (pixels - (x0 + 0.5, y0 + 0.5)).astype(np.float32))
    board = cv2.warpPerspective(patch, warp, (int(x1 - x0), int(y1 - y0)), flags=cv2.INTER_LINEAR).astype(np.float32)
    board *= opacity
    under = image[y0:y1, x0:x1]
    under[:] = np.rint(board + under * (1 - board[:, :, 3:] / 255))
    return int(x0), int(y0), int(x1 - x0), int(y1 - y0)


@lru_cache(maxsize=256)
def _patch(text: str) -> NDArray[np.uint8]:
    """[rows, columns, 4] light letters on a dark, see-through board, premultiplied."""
    shown = text if hasattr(cv2, "FontFace") else text.encode("ascii", "replace").decode()
    canvas = _written(shown)
    ink = canvas[:, :, :1].astype(np.float32) / 255
    out = np.concatenate([np.repeat(ink * _INK, 3, axis=2), 255 * (ink + (1 - ink) * _BACK)], axis=2)
    out[[0, -1]] = out[:, [0, -1]] = 0  # a rim, for a smooth edge
    patch = np.rint(out).astype(np.uint8)
    patch.setflags(write=False)
    return patch


def _written(text: str) -> NDArray[np.uint8]:
    """[rows, columns, 3] white letters on black."""
    start, white = (_MARGIN, _ROWS - 13), (255, 255, 255)
    if hasattr(cv2, "FontFace"):  # OpenCV 5: all scripts
        face = cv2.FontFace("sans")
        x, _, wide, _ = cv2.getTextSize((_WIDEST, _ROWS), text, start, face, 26)
        canvas = np.zeros((_ROWS, x + wide + _MARGIN, 3), np.uint8)
        cv2.putText(canvas, text, start, white, face, 26)
    else:
        (wide, _), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.8, 1)
        canvas = np.zeros((_ROWS, 2 * _MARGIN + wide, 3), np.uint8)
        cv2.putText(canvas, text, start, cv2.FONT_HERSHEY_SIMPLEX, 0.8, white, 1, cv2.LINE_AA)
    return canvas
