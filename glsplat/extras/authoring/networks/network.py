"""Run one network in OpenCV's dnn on square crops of a picture.

Pictures are RGB uint8 [H, W, 3]. Points are in pixels, x right and y down; the centre of the first pixel is at
(0.5, 0.5), so a picture spans 0..W and 0..H.
"""

from __future__ import annotations

import logging
import threading
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F32, F64
from glsplat.errors import GlsplatError
from glsplat.extras.authoring.models.store import path_of


class Network:
    """A network, named as in the store. Raises GlsplatError if its file is missing.

    Outputs are flat float32 arrays, equal for equal inputs on one machine. Threads may share an instance.
    """

    def __init__(self, name: str, outputs: tuple[str, ...] = ()) -> None:
        path = path_of(name)
        # OpenCV 5's default engine computes wrong landmarks of bodies; older versions have only the classic one
        engine = [cv2.dnn.ENGINE_CLASSIC] if hasattr(cv2.dnn, "ENGINE_CLASSIC") else []
        try:
            self._net: Any = cv2.dnn.readNetFromTFLite(str(path), *engine)
        except (AttributeError, cv2.error) as error:
            logging.getLogger(__name__).debug("%s: %s", path, error)
            raise GlsplatError(
                f"{path}: OpenCV {cv2.__version__} cannot read this network; "
                "install opencv-contrib-python-headless 4.10 or newer"
            ) from None
        self._lock = threading.Lock()
        self.outputs: tuple[str, ...] = outputs or tuple(self._net.getUnconnectedOutLayersNames())

    def __call__(self, picture: NDArray[np.uint8]) -> list[F32]:
        """Return the outputs, in the order of ``outputs``, for a square crop (RGB uint8 [n, n, 3])."""
        values = picture.astype(np.float32).transpose(2, 0, 1)[None] / np.float32(255)
        with self._lock:
            self._net.setInput(np.ascontiguousarray(values))
            found = self._net.forward(list(self.outputs))
        return [np.array(value, np.float32).reshape(-1) for value in found]


network = lru_cache(maxsize=8)(Network)
"""Return the ``Network``, which is read once."""


@dataclass(frozen=True)
class Crop:
    """A square of a picture: centre and side in pixels, turned clockwise by ``turn`` radians."""

    x: float
    y: float
    side: float
    turn: float = 0.0

    @classmethod
    def around(cls, points: F64, turn: float, factor: float, up: float = 0.0) -> Crop:
        """Return a crop turned by ``turn``, ``factor`` times as large as the box of ``points`` [N, 2] in its axes.

        ``up`` moves it by a fraction of the box's longer side.
        """
        axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])  # rows: right and down
        inner = points @ axes.T
        low, high = inner.min(axis=0), inner.max(axis=0)
        side = float((high - low).max())
        middle = ((low + high) / 2 + (0, -up * side)) @ axes
        return cls(float(middle[0]), float(middle[1]), factor * max(side, 1.0), turn)

    def to_picture(self, points: F64, n: int) -> F64:
        """Transform points [..., 2] in a crop of n x n pixels into pixels of the picture."""
        matrix = self._matrix(n)
        return points @ matrix[:, :2].T + matrix[:, 2]

    def cut(self, picture: NDArray[np.uint8], n: int) -> NDArray[np.uint8]:
        """Return the crop as n x n pixels; the picture's border is repeated outside it; large crops are averaged."""
        height, width = picture.shape[:2]
        shrink = int(self.side / n)  # bilinear sampling alone would skip pixels
        scale_x = scale_y = 1.0
        if shrink >= 2:
            small = max(width // shrink, 1), max(height // shrink, 1)
            scale_x, scale_y = small[0] / width, small[1] / height
            picture = cv2.resize(picture, small, interpolation=cv2.INTER_AREA)
        matrix = np.diag([scale_x, scale_y]) @ self._matrix(n)
        matrix[:, 2] += matrix[:, :2] @ (0.5, 0.5) - 0.5  # OpenCV's origin is the first pixel's centre
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        return np.asarray(cv2.warpAffine(picture, matrix, (n, n), flags=flags, borderMode=cv2.BORDER_REPLICATE))

    def paste(self, values: F32, shape: tuple[int, int], interpolation: int = cv2.INTER_LINEAR) -> F32:
        """Return values [n, n] of a crop as a float32 picture of ``shape`` (H, W), zero outside the crop."""
        matrix = self._matrix(values.shape[0])
        matrix[:, 2] += matrix[:, :2] @ (0.5, 0.5) - 0.5
        return np.asarray(cv2.warpAffine(values, matrix, shape[::-1], flags=interpolation))

    def _matrix(self, n: int) -> F64:
        """Return the affine map [2, 3] from points of a crop of n x n pixels to points of the picture."""
        cos, sin = np.cos(self.turn) * self.side / n, np.sin(self.turn) * self.side / n
        linear = np.array([[cos, -sin], [sin, cos]])
        return np.column_stack([linear, (self.x, self.y) - linear @ (n / 2, n / 2)])


def sigmoid(values: F32) -> F32:
    """Return the logistic function of logits, without overflow."""
    return np.asarray(0.5 * (1 + np.tanh(0.5 * values)), np.float32)
