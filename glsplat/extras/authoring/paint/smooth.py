"""Fill in colours of unseen vertices from those around them."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, csr_matrix, diags

from glsplat.extras.authoring.body.open_body import Body
from glsplat.extras.authoring.body.segments import HANDS
from glsplat.extras.authoring.compute.solvers import conjugate_gradients
from glsplat.skinning.smplx import JOINT_NAMES

F64 = NDArray[np.float64]

_ARMS = [n for n, name in enumerate(JOINT_NAMES) if any(word in name for word in ("shoulder", "elbow", *HANDS))]
_ROUND_PARTS = [n for n, name in enumerate(JOINT_NAMES) if any(word in name for word in ("head", "jaw", "eye", "foot"))]
_MEAN_PULL = 1e-6  # of an unseen vertex towards the mean colour
_ALONG_LIMB_WEIGHT = 0.05  # of an edge along a limb, over one around it
_SMOOTHNESS = 0.003  # of a neighbour's colour, over an observed one


@lru_cache(maxsize=2)
def _edge_weights(body: Body, hair: bool) -> csr_matrix:
    """Return ``body.neighbours`` with lower weights along a limb: cloth is alike around it, not along it."""
    edges = body.neighbours.tocoo()
    edge = body.vertices[edges.row] - body.vertices[edges.col]
    along = np.where(np.isin(body.part, _ARMS)[edges.row], np.abs(edge[:, 0]), np.abs(edge[:, 1]))
    along /= np.maximum(np.linalg.norm(edge, axis=1), 1e-12)
    if not hair:
        along[np.isin(body.part, _ROUND_PARTS)[edges.row] | np.isin(body.part, _ROUND_PARTS)[edges.col]] = 0
    share = _ALONG_LIMB_WEIGHT + (1 - _ALONG_LIMB_WEIGHT) * (1 - along**2) ** 2
    one_way = coo_matrix((share, (edges.row, edges.col)), edges.shape).tocsr()
    return (one_way + one_way.T) / 2


def fill_smoothly(
    body: Body,
    known: F64,
    target: F64,
    hair: bool = False,
    decay: float | None = None,
    some: NDArray[np.bool_] | None = None,
) -> F64:
    """Return [V, 3], or [N, 3], linear colours near ``target / known`` where ``known`` [V] is large, smooth between.

    ``target`` [V, 3] is the weighted sum of the colours observed at each vertex, ``known`` the sum of the weights. With
    ``hair`` a head counts as a limb, too. With ``decay`` the values are offsets, pulled to 0 by that weight. ``some``
    [V] selects the N vertices to return; all others are ignored.
    """
    mean = target.sum(axis=0) / max(float(known.sum()), 1e-9) if decay is None else np.zeros(3)
    keep = _MEAN_PULL if decay is None else decay
    neighbours = _edge_weights(body, hair)
    if some is not None:
        neighbours, known, target = neighbours[some][:, some], known[some], target[some]
    degree = np.asarray(neighbours.sum(axis=1)).ravel()
    scale = known + _SMOOTHNESS * degree + keep
    matrix = diags(scale) - _SMOOTHNESS * neighbours
    start = np.where(known[:, None] > 0.2, target / np.maximum(known, 0.2)[:, None], mean)
    return conjugate_gradients(matrix.tocsr(), target + keep * mean, start).clip(0 if decay is None else -2, 2)
