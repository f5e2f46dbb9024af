"""Find the lining of the open body's mouth, which continues its skin: its rim, and the depth behind it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from glsplat.arrays import F64, frozen
from glsplat.extras.authoring.body.open_body import open_body
from glsplat.extras.authoring.body.open_face import open_face

Indices = NDArray[np.intp]

_MOUTH_CENTRE_M = (0.0, 0.82, 0.10)  # a point within the open body's mouth
_LIP_WIDTH_M = 0.007  # from the rim
_LOWER_LIP_FRACTION = 0.5  # of the largest move of the rim as the jaw opens: the lower lip moves farther


@dataclass(frozen=True, slots=True, eq=False)
class Lining:
    """The lining and the lips, as vertices of the open body (V)."""

    inside: NDArray[np.bool_]  # [V] the lining with its rim
    far: F64  # [V] straight distance from the rim, metres
    lips: NDArray[np.bool_]  # [V] the outer lips
    upper: Indices  # [K] rim of the upper lip, from the person's right to their left
    lower: Indices  # [K] rim of the lower lip


@lru_cache(maxsize=1)
def mouth_lining() -> Lining:
    """Return the lining, an island of MakeHuman's texture layout whose border is the rim. Computed once."""
    body = open_body()
    places, corner = np.unique(np.rint(body.uv.reshape(-1, 2) * 1e5), axis=0, return_inverse=True)
    ends = corner.reshape(-1, 3)[:, [0, 1, 1, 2]].reshape(-1, 2)
    joined = coo_array((np.ones(len(ends)), ends.T), (len(places), len(places)))
    _, island = connected_components(joined, directed=False)
    island_of_face = island[corner.reshape(-1, 3)[:, 0]]
    islands = [body.faces[island_of_face == number] for number in range(island_of_face.max() + 1)]
    skin = np.array([body.skin[faces].all() for faces in islands])
    centres = np.array([body.vertices[faces].reshape(-1, 3).mean(axis=0) for faces in islands])
    distances = np.linalg.norm(centres - _MOUTH_CENTRE_M, axis=1)
    lining = island_of_face == np.flatnonzero(skin)[distances[skin].argmin()]
    inside = np.zeros(len(body.vertices), bool)
    inside[body.faces[lining]] = True
    rim = np.intersect1d(body.faces[lining], body.faces[~lining])
    far, _ = cKDTree(body.vertices[rim]).query(body.vertices)
    lowered = np.linalg.norm(open_face().expressions.dense("jawOpen", len(body.vertices)), axis=1)[rim]
    low = lowered > _LOWER_LIP_FRACTION * lowered.max()
    upper, lower = (lip[np.argsort(body.vertices[lip, 0])] for lip in (rim[~low], rim[low]))
    return Lining(
        inside=frozen(inside),
        far=frozen(far),
        lips=frozen(~inside & body.skin & (far < _LIP_WIDTH_M)),
        upper=frozen(upper),
        lower=frozen(lower),
    )
