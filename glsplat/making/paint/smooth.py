"""Colours of vertices that nobody saw, from those around them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix, diags
from scipy.sparse.linalg import cg

from glsplat.making.fit.body import Body

__all__ = ["smoothest"]

F64 = NDArray[np.float64]

_SHY = 1e-6  # how much a vertex nobody saw stays at the mean colour
_STIFF = 0.003  # how much neighbours agree against how much a vertex obeys what was seen of it


def smoothest(body: Body, known: F64, target: F64) -> F64:
    """[V, 3] linear colours near ``target / known`` where ``known`` [V] is large, the smoothest between.

    ``target`` [V, 3] is the sum of the colours seen at each vertex, ``known`` the sum of their weights.
    """
    mean = target.sum(axis=0) / max(known.sum(), 1e-9)
    neighbours: csr_matrix = body.neighbours
    degree = np.asarray(neighbours.sum(axis=1)).ravel()
    scale = known + _STIFF * degree + _SHY
    matrix = diags(scale) - _STIFF * neighbours
    start = np.where(known[:, None] > 0.2, target / np.maximum(known, 0.2)[:, None], mean)
    columns = [
        cg(matrix, target[:, c] + _SHY * mean[c], x0=start[:, c], rtol=1e-4, maxiter=300, M=diags(1 / scale))[0]
        for c in range(3)
    ]
    return np.stack(columns, axis=1).clip(0, 2)
