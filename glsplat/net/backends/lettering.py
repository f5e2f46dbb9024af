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

_LEAST = 11.0  # pixels from the lower to the upper edge, however far away a label is
_ROWS = 40  # pixels of a label before it is projected
_MARGIN = 10
_WIDEST = 4096
_BACK, _INK = 0.55, 235  # alpha of the board, grey of the letters

Box = tuple[int, int, int, int]  # x, y, width, height


def draw_labels(images: NDArray[np.uint8], cameras: Sequence[Camera], labels: Sequence[Label]) -> Box:
    """Write labels into images [V, H, W, 4], premultiplied, farthest first; returns the box that holds what changed.

    Empty where nothing did.
    """
    changed: Box = (0, 0, 0, 0)
    middle = np.mean([camera.position for camera in cameras], axis=0)
    for label in sorted(labels, key=lambda one: -float(np.linalg.norm(one.place - middle))):
        corners = _corners(label, cameras)
        if corners is None:
            continue
        for image, camera in zip(images, cameras, strict=True):
            changed = union(changed, _draw(image, camera, corners, _patch(label.text), label.opacity))
    return changed


def _corners(label: Label, cameras: Sequence[Camera]) -> NDArray[np.float64] | None:
    """[4, 3] of the board in the room, from its upper left as it is read; None where it is not in front of all eyes."""
    depths = [float(camera.viewmat[2, :3] @ label.place + camera.viewmat[2, 3]) for camera in cameras]
    if not all(camera.near < z < camera.far for z, camera in zip(depths, cameras, strict=True)):
        return None
    height = max(label.height, _LEAST * float(np.mean(depths)) / float(cameras[0].K[1, 1]))
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
