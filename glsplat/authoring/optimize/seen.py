"""What splats know of their surface, made to agree with what is seen: a picture mixes splats that lie over each other.

A splat of the inside of a cheek shows through between those of its outside, in the skin's colour: a fit has seen to
that. Lit by its own normal it would be a dark speck there. So a splat that is far from what faces the camera where it
shows takes the mean of that; what nobody sees keeps its own, and teeth are mostly seen in an open mouth.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from glsplat.authoring.optimize.compiled import available
from glsplat.authoring.posed import PosedSplats
from glsplat.avatar import Avatar

__all__ = ["as_seen"]

F64 = NDArray[np.float64]

_ROUNDS = 3
_OWN = 1.0  # pixels of all pictures that a splat's own values count as
_NEAR, _FAR = (
    0.2,
    0.4,
)  # of a unit, or an octave: how far from the mean a splat's own may be; from there on it is the mean
_GRAZING = 0.22  # square of the cosine under which a splat is seen at most from aside; from twice that it is seen well
_LEAST = 1e-3  # of a pixel: what less passes to is not seen


def as_seen(avatar: Avatar, normals: F64, occlusion: F64, shade: F64 | None = None) -> tuple[F64, F64, F64]:
    """Unit normals [N, 3], occlusion [N] and shade [N], 1 if not given, of the avatar's splats as pictures mix them.

    Of the zero pose. As they are without numba, and where there is nothing to look at.
    """
    shade = np.ones(len(normals)) if shade is None else shade
    if not available():
        return normals, occlusion, shade
    from glsplat.authoring.optimize.agreed import SUMS, agreed
    from glsplat.authoring.optimize.pictures import looks_at
    from glsplat.authoring.optimize.rasterizer import Rasterizer

    antialias, drawing = avatar.splats.antialias, Rasterizer(len(avatar.splats), least=_LEAST)
    looks = [(splats, camera) for splats, cameras in looks_at(avatar) for camera in cameras]
    shown: list[NDArray[np.intp] | slice] = [slice(None)] * len(looks)  # after the first round, what is not hidden
    values = np.concatenate([normals, occlusion[:, None], np.log2(shade)[:, None]], axis=1)
    for _ in range(_ROUNDS):
        sums = np.zeros((len(values), SUMS))
        for index, (splats, camera) in enumerate(looks):
            some = shown[index]
            splats, own = PosedSplats(*(part[some] for part in splats)), values[some]
            eye, towards = -camera.viewmat[:3, :3].T @ camera.viewmat[:3, 3], -camera.viewmat[2, :3]
            facing = np.einsum("nc,nc->n", eye - splats.means, own[:, :3]) > 0
            mixed = np.column_stack([own, np.ones(len(own))]) * facing[:, None]
            drawing.place(splats, camera, antialias)
            found = drawing.gathered(agreed, SUMS, mixed.astype(np.float32), towards.astype(np.float32))
            sums[some] += found
            if isinstance(some, slice):
                shown[index] = np.flatnonzero(found[:, 7])
        weight, whole = sums[:, 5:6] + _OWN, sums[:, 6:7]
        total = values * _OWN + sums[:, :5]
        mean = total / weight
        off = np.linalg.norm(mean - values, axis=1, keepdims=True)
        sure = np.clip(((weight - _OWN) / np.maximum(whole, 1e-6) - _GRAZING) / _GRAZING, 0, 1)
        values += (mean - values) * sure * np.clip((off - _NEAR) / (_FAR - _NEAR), 0, 1)
        length = np.linalg.norm(values[:, :3], axis=1, keepdims=True)
        values[:, :3] = np.where(length > 1e-6, values[:, :3] / np.maximum(length, 1e-6), 0)
    return values[:, :3], values[:, 3], np.exp2(values[:, 4])
