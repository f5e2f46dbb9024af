"""Cloth behind arms: a shirt hangs straight, where no outline shows it and a bare waist would be."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from glsplat.authoring.fit.body import Body
from glsplat.skinning.smplx import JOINT_NAMES

__all__ = ["hung"]

F64 = NDArray[np.float64]

_ROW = 0.02  # metres of height
_ARMPIT = 0.07  # metres below the shoulder joints: up to there flanks are looked at
_WAIST = 0.03  # metres below the lowest joint of the spine: seen no higher than that, a flank says nothing of the waist
_WORN = 0.004, 0.012  # metres of cloth: from the first on it hangs a little, from the second on straight
_EDGE = 0.01  # metres: what is so near to a row's outermost vertex is on its edge
_ASIDE = 0.7  # cosine between a flank's normal and the side it is on


def hung(
    body: Body, bare: F64, joints: F64, directions: F64, offsets: F64, rim: NDArray[np.intp], hidden: NDArray[np.intp]
) -> tuple[NDArray[np.intp], F64]:
    """K vertices of flanks that arms hide, and their offsets [K] with which they are as wide as they are seen below.

    ``offsets`` [V] along ``directions`` [V, 3] are those without. ``bare`` [V, 3] and ``joints`` [55, 3] are in the
    zero pose, metres. ``rim`` are vertices whose outline is seen, ``hidden`` those that an arm lies before.
    Flanks are left alone that are seen no higher than the hips, or wear nothing there.
    """
    dressed = bare + offsets[:, None] * directions
    high = float(joints[[_at("left_shoulder"), _at("right_shoulder")], 1].mean()) - _ARMPIT
    low = float(joints[_at("spine1"), 1]) - _WAIST
    row = np.floor((bare[:, 1] - low) / _ROW).astype(np.intp)
    count = int((high - low) / _ROW) + 1
    within = _trunk(body) & (row >= 0) & (row < count)
    found, wanted = [], []
    for side in (1.0, -1.0):
        flank = within & (side * directions[:, 0] > _ASIDE)
        wide = np.zeros(count)
        np.maximum.at(wide, row[flank], side * dressed[flank, 0])
        seen, covered = (np.bincount(row[some[flank[some]]], minlength=count) > 0 for some in (rim, hidden))
        covered &= ~seen & (wide > 0)
        first = int(covered.argmax())  # the lowest row that an arm hides
        if not covered.any() or not seen[:first].any():
            continue
        last = int(np.flatnonzero(seen[:first])[-1])
        edge = rim[flank[rim] & (row[rim] == last)]
        worn = float(np.clip((np.median(offsets[edge]) - _WORN[0]) / (_WORN[1] - _WORN[0]), 0, 1))
        lacks = np.where(covered, worn * (wide[last] - wide), 0.0)
        mine = np.flatnonzero(flank)
        # of each row what is about as far aside as anything
        mine = mine[(lacks[row[mine]] > 0) & (side * dressed[mine, 0] > wide[row[mine]] - _EDGE)]
        found.append(mine)
        wanted.append(offsets[mine] + lacks[row[mine]])
    if not found:
        return np.zeros(0, np.intp), np.zeros(0)
    return np.concatenate(found), np.concatenate(wanted)


@lru_cache(maxsize=1)
def _trunk(body: Body) -> NDArray[np.bool_]:
    """[V] chest, belly and hips."""
    names = ("pelvis", "spine", "collar")
    return np.asarray(np.array([any(word in name for word in names) for name in JOINT_NAMES])[body.part] & body.skin)


def _at(name: str) -> int:
    return JOINT_NAMES.index(name)
