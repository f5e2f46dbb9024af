"""Contact sheets: an avatar and its participant at every moment, from the front and from behind."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]
_SIDE = 192  # height of a picture in pixels
_STRIP = 18  # height of a row's heading in pixels
_QUALITY = 85


class Sheet:
    """Small pictures in named rows and a column per moment; rows are in the order of their first picture."""

    def __init__(self, moments: int) -> None:
        self._moments = moments
        self._rows: dict[str, list[Picture | None]] = {}

    def put(self, row: str, moment: int, picture: Picture) -> None:
        """Add a picture [H, W, 3 or 4] RGB(A)."""
        cells = self._rows.setdefault(row, [None] * self._moments)
        height, width = picture.shape[:2]
        size = (round(_SIDE * width / height), _SIDE)
        cells[moment] = cv2.resize(picture[..., :3], size, interpolation=cv2.INTER_AREA)

    def jpeg(self) -> bytes:
        """Return the sheet with its rows' names as a JPEG."""
        lines = []
        for name, cells in self._rows.items():
            filled = [np.zeros((_SIDE, _SIDE, 3), np.uint8) if cell is None else cell for cell in cells]
            line = np.hstack(filled)
            strip = np.full((_STRIP, line.shape[1], 3), 64, np.uint8)
            cv2.putText(strip, name, (4, 13), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (255, 255, 255), 1, cv2.LINE_AA)
            lines += [strip, line]
        data = cv2.imencode(".jpg", np.vstack(lines)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1]
        return bytes(data.tobytes())
