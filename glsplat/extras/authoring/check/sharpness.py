"""How blurred a picture of a person is, from the picture alone."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["blur_of"]

_HEIGHT = 1000  # pixels: a person larger than that is made smaller first, since an avatar shows no more
_WINDOW = 9  # pixels of the second blur


def blur_of(picture: NDArray[np.uint8], mask: NDArray[np.bool_]) -> float:
    """0 for a sharp picture to 1 for one that is nothing but blur, inside ``mask`` [H, W] and along its outline.

    A sharp picture loses most of its steps between neighbours when it is blurred once more, a blurred one hardly any
    (after Crete and others, The Blur Effect, 2007). The worse of the two directions counts: hands shake in one.
    """
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        return 1.0
    area = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    grey = cv2.cvtColor(np.ascontiguousarray(picture[area]), cv2.COLOR_RGB2GRAY).astype(np.float32)
    inside = mask[area].astype(np.float32)
    scale = _HEIGHT / grey.shape[0]
    if scale < 1:
        size = max(round(grey.shape[1] * scale), 2), _HEIGHT
        grey, inside = (cv2.resize(a, size, interpolation=cv2.INTER_AREA) for a in (grey, inside))
    inside = cv2.dilate(inside, np.ones((5, 5), np.uint8)) > 0.5
    values = []
    for axis, window in ((0, (1, _WINDOW)), (1, (_WINDOW, 1))):
        before = np.abs(np.diff(grey, axis=axis))
        after = np.abs(np.diff(cv2.blur(grey, window), axis=axis))
        used = np.take(inside, range(1, inside.shape[axis]), axis=axis)
        total = float(before[used].sum())
        values.append(1 - float(np.maximum(before - after, 0)[used].sum()) / total if total > 0 else 1.0)
    return max(values)
