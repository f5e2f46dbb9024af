"""What splats know of their surface, made to agree with what is seen: a picture mixes splats that lie over each other.

A splat of the inside of a cheek shows through between those of its outside, in the skin's colour: a fit has seen to
that. Lit by its own normal it would be a dark speck there. So a splat that is far from what faces the camera where it
shows takes the mean of that; what nobody sees keeps its own, and teeth are mostly seen in an open mouth.
"""

from __future__ import annotations

from queue import SimpleQueue
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from glsplat.authoring.optimize.compiled import available
from glsplat.authoring.posed import PosedSplats
from glsplat.authoring.threads import abreast
from glsplat.avatar import Avatar
from glsplat.camera import Camera
from glsplat.io.machine import cores

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


class _Look(NamedTuple):
    """A picture that is looked at: splats in a pose, the camera, and which of the avatar's splats these are."""

    splats: PosedSplats
    camera: Camera
    some: NDArray[np.intp]


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

    antialias, desks = avatar.splats.antialias, SimpleQueue[Rasterizer]()
    for _ in range(cores()):
        desks.put(Rasterizer(len(avatar.splats), 1, _LEAST))
    every = np.arange(len(avatar.splats))
    looks = [_Look(splats, camera, every) for splats, cameras in looks_at(avatar) for camera in cameras]
    values = np.concatenate([normals, occlusion[:, None], np.log2(shade)[:, None]], axis=1)

    def gathered(look: _Look) -> tuple[NDArray[np.intp], F64]:
        """Which of the look's splats its picture shows, and their sums."""
        splats, camera, own = look.splats, look.camera, values[look.some]
        eye, towards = -camera.viewmat[:3, :3].T @ camera.viewmat[:3, 3], -camera.viewmat[2, :3]
        facing = np.einsum("nc,nc->n", eye - splats.means, own[:, :3]) > 0
        mixed = (np.column_stack([own, np.ones(len(own))]) * facing[:, None]).astype(np.float32)
        drawing = desks.get()
        try:
            drawing.place(splats, camera, antialias)
            sums = drawing.gathered(agreed, SUMS, mixed, towards.astype(np.float32))
        finally:
            desks.put(drawing)
        shown = np.flatnonzero(sums[:, 7])
        return shown, sums[shown]

    for _ in range(_ROUNDS):
        sums = np.zeros((len(values), SUMS))
        for index, (shown, found) in enumerate(abreast(gathered, looks)):
            splats, camera, some = looks[index]
            sums[some[shown]] += found
            if len(shown) < len(some):  # after the first round, without what is hidden
                looks[index] = _Look(PosedSplats(*(part[shown] for part in splats)), camera, some[shown])
        weight, whole = sums[:, 5:6] + _OWN, sums[:, 6:7]
        total = values * _OWN + sums[:, :5]
        mean = total / weight
        off = np.linalg.norm(mean - values, axis=1, keepdims=True)
        sure = np.clip(((weight - _OWN) / np.maximum(whole, 1e-6) - _GRAZING) / _GRAZING, 0, 1)
        values += (mean - values) * sure * np.clip((off - _NEAR) / (_FAR - _NEAR), 0, 1)
        length = np.linalg.norm(values[:, :3], axis=1, keepdims=True)
        values[:, :3] = np.where(length > 1e-6, values[:, :3] / np.maximum(length, 1e-6), 0)
    return values[:, :3], values[:, 3], np.exp2(values[:, 4])
