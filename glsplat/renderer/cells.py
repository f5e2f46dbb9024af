"""Cells of neighbours: points halved along their longest axis again and again."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["cells"]


def cells(points: NDArray[np.float64], count: int) -> NDArray[np.intp]:
    """[N] which of ``count`` cells each of ``points`` [N, D] falls into: halved along the longest axis again and again.

    Sizes differ by at most one between siblings; every cell has at least one point if ``count`` <= N.
    """
    out = np.zeros(len(points), np.intp)
    todo = [(np.arange(len(points)), 0, count)]
    while todo:
        index, first, share = todo.pop()
        if share == 1:
            out[index] = first
            continue
        own = points[index]
        axis = int(np.ptp(own, axis=0).argmax())
        left = share // 2
        cut = int(np.clip(round(len(index) * left / share), left, len(index) - (share - left)))
        order = np.argpartition(own[:, axis], min(cut, len(index) - 1))
        todo += [(index[order[:cut]], first, left), (index[order[cut:]], first + left, share - left)]
    return out
