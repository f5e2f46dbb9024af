"""The lining of the open body's mouth, which its skin goes on into: where it begins, and how deep it goes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from glsplat.arrays import frozen
from glsplat.extras.authoring.body.open_body import open_body
from glsplat.extras.authoring.body.open_face import open_face

__all__ = ["Lining", "mouth_lining"]

F64 = NDArray[np.float64]
Indices = NDArray[np.intp]

_MIDDLE = (0.0, 0.82, 0.10)  # metres: a place within the open body's mouth
_LIPS = 0.007  # metres about the rim, as far as lips reach
_JAW = 0.5  # of the way that the farthest vertex of the rim goes as the jaw opens: what goes farther is the lower lip's


@dataclass(frozen=True, slots=True, eq=False)
class Lining:
    """Of the open body's V vertices."""

    inside: NDArray[np.bool_]  # [V] of the lining, its rim too
    far: F64  # [V] metres from the rim, straight
    lips: NDArray[np.bool_]  # [V] of what is seen of the lips
    upper: Indices  # [K] of the rim, from the person's right to their left
    lower: Indices


@lru_cache(maxsize=1)
def mouth_lining() -> Lining:
    """Found once: MakeHuman's texture has the mouth's inside on an island of its own, whose shore is the rim."""
    body = open_body()
    places, corner = np.unique(np.rint(body.uv.reshape(-1, 2) * 1e5), axis=0, return_inverse=True)
    ends = corner.reshape(-1, 3)[:, [0, 1, 1, 2]].reshape(-1, 2)
    joined = coo_array((np.ones(len(ends)), ends.T), (len(places), len(places)))
    _, island = connected_components(joined, directed=False)
    of = island[corner.reshape(-1, 3)[:, 0]]
    within = np.array([_middle_distance(body.vertices[body.faces[of == one]]) for one in range(of.max() + 1)])
    skin = np.array([body.skin[body.faces[of == one]].all() for one in range(of.max() + 1)])
    mine = of == np.flatnonzero(skin)[within[skin].argmin()]
    inside = np.zeros(len(body.vertices), bool)
    inside[body.faces[mine]] = True
    rim = np.intersect1d(body.faces[mine], body.faces[~mine])
    far, _ = cKDTree(body.vertices[rim]).query(body.vertices)
    lowered = np.linalg.norm(open_face().expressions.dense("jawOpen", len(body.vertices)), axis=1)[rim]
    low = lowered > _JAW * lowered.max()
    rows = [rim[which][np.argsort(body.vertices[rim[which], 0])] for which in (~low, low)]
    return Lining(
        inside=frozen(inside),
        far=frozen(far),
        lips=frozen(~inside & body.skin & (far < _LIPS)),
        upper=frozen(rows[0]),
        lower=frozen(rows[1]),
    )


def _middle_distance(corners: F64) -> float:
    return float(np.linalg.norm(corners.reshape(-1, 3).mean(axis=0) - _MIDDLE))
