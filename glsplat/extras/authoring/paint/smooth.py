"""Colours of vertices that nobody saw, from those around them."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, csr_matrix, diags

from glsplat.extras.authoring.body.open_body import Body
from glsplat.extras.authoring.body.segments import HANDS
from glsplat.extras.authoring.compute.conjugate_gradients import conjugate_gradients
from glsplat.skinning.smplx import JOINT_NAMES

__all__ = ["smoothest"]

F64 = NDArray[np.float64]

_ARMS = [n for n, name in enumerate(JOINT_NAMES) if any(word in name for word in ("shoulder", "elbow", *HANDS))]
_ROUND = [n for n, name in enumerate(JOINT_NAMES) if any(word in name for word in ("head", "jaw", "eye", "foot"))]
_SHY = 1e-6  # how much a vertex nobody saw stays at the mean colour
_ALONG = 0.05  # how much an edge along a limb says against one around it
_STIFF = 0.003  # how much neighbours agree against how much a vertex obeys what was seen of it


@lru_cache(maxsize=2)
def _around(body: Body, hair: bool) -> csr_matrix:
    """``body.neighbours``, less than one where an edge runs along a limb: cloth is the same around it, not along."""
    edges = body.neighbours.tocoo()
    way = body.vertices[edges.row] - body.vertices[edges.col]
    along = np.where(np.isin(body.part, _ARMS)[edges.row], np.abs(way[:, 0]), np.abs(way[:, 1]))
    along /= np.maximum(np.linalg.norm(way, axis=1), 1e-12)
    if not hair:
        along[np.isin(body.part, _ROUND)[edges.row] | np.isin(body.part, _ROUND)[edges.col]] = 0
    share = _ALONG + (1 - _ALONG) * (1 - along**2) ** 2
    one_way = coo_matrix((share, (edges.row, edges.col)), edges.shape).tocsr()
    return (one_way + one_way.T) / 2


def smoothest(
    body: Body,
    known: F64,
    target: F64,
    hair: bool = False,
    shy: float | None = None,
    some: NDArray[np.bool_] | None = None,
) -> F64:
    """[V, 3], or [N, 3], linear colours near ``target / known`` where ``known`` [V] is large, the smoothest between.

    ``target`` [V, 3] is the sum of the colours seen at each vertex, ``known`` the sum of their weights. With ``hair``
    a head is a limb, too. With ``shy`` they are differences, and nothing by so much where nothing is known.
    ``some`` [V] are the vertices that are asked for, N of them; the others' colours are not looked at.
    """
    mean = target.sum(axis=0) / max(float(known.sum()), 1e-9) if shy is None else np.zeros(3)
    keep = _SHY if shy is None else shy
    neighbours = _around(body, hair)
    if some is not None:
        neighbours, known, target = neighbours[some][:, some], known[some], target[some]
    degree = np.asarray(neighbours.sum(axis=1)).ravel()
    scale = known + _STIFF * degree + keep
    matrix = diags(scale) - _STIFF * neighbours
    start = np.where(known[:, None] > 0.2, target / np.maximum(known, 0.2)[:, None], mean)
    return conjugate_gradients(matrix.tocsr(), target + keep * mean, start).clip(0 if shy is None else -2, 2)
