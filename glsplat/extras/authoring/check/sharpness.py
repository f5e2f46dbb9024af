"""Measure how blurred a picture of a person is."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

_MAX_HEIGHT_PX = 1000  # of the person; larger ones are reduced, since an avatar shows no more detail
_BLUR_PX = 9  # width of the second blur


def blur_of(picture: NDArray[np.uint8], mask: NDArray[np.bool_]) -> float:
    """Return 0 for a sharp picture to 1 for a completely blurred one, inside ``mask`` [H, W] and along its outline.

    A further blur removes most differences between neighbours of a sharp picture and few of a blurred one (Crete et
    al., The Blur Effect, 2007). The worse of the two directions counts, because hands shake in one.
    """
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        return 1.0
    area = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    grey = cv2.cvtColor(np.ascontiguousarray(picture[area]), cv2.COLOR_RGB2GRAY).astype(np.float32)
    inside = mask[area].astype(np.float32)
    scale = _MAX_HEIGHT_PX / grey.shape[0]
    if scale < 1:
        size = max(round(grey.shape[1] * scale), 2), _MAX_HEIGHT_PX
        grey, inside = (cv2.resize(a, size, interpolation=cv2.INTER_AREA) for a in (grey, inside))
    inside = cv2.dilate(inside, np.ones((5, 5), np.uint8)) > 0.5
    values = []
    for axis, window in ((0, (1, _BLUR_PX)), (1, (_BLUR_PX, 1))):
        before = np.abs(np.diff(grey, axis=axis))
        after = np.abs(np.diff(cv2.blur(grey, window), axis=axis))
        used = np.take(inside, range(1, inside.shape[axis]), axis=axis)
        total = float(before[used].sum())
        values.append(1 - float(np.maximum(before - after, 0)[used].sum()) / total if total > 0 else 1.0)
    return max(values)
