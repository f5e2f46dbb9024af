"""What splats know of their surface, made to agree with what is seen: a picture mixes splats that lie over each other.

A splat of the inside of a cheek shows through between those of its outside, in the skin's colour: a fit has seen to
that. Lit by its own normal it would be a dark speck there. So a splat that is far from what faces the camera where it
shows takes the mean of that; what nobody sees keeps its own, and teeth are mostly seen in an open mouth.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from glsplat.authoring.optimize.compiled import available
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
_FACING = 0.5  # of a pixel, at least, that shows what faces the camera: elsewhere one looks through


def as_seen(avatar: Avatar, normals: F64, occlusion: F64, shade: F64 | None = None) -> tuple[F64, F64, F64]:
    """Unit normals [N, 3], occlusion [N] and shade [N], 1 if not given, of the avatar's splats as pictures mix them.

    Of the zero pose. As they are without numba, and where there is nothing to look at.
    """
    shade = np.ones(len(normals)) if shade is None else shade
    if not available():
        return normals, occlusion, shade
    from glsplat.authoring.optimize.pictures import looks_at
    from glsplat.authoring.optimize.rasterizer import Rasterizer

    antialias, drawing = avatar.splats.antialias, Rasterizer(len(avatar.splats))
    looks = list(looks_at(avatar))
    values = np.concatenate([normals, occlusion[:, None], np.log2(shade)[:, None]], axis=1)
    for _ in range(_ROUNDS):
        total, weight, whole = values * _OWN, np.full((len(values), 1), _OWN), np.zeros((len(values), 1))
        for splats, cameras in looks:
            for camera in cameras:
                way = -camera.viewmat[:3, :3].T @ camera.viewmat[:3, 3] - splats.means
                facing = (np.einsum("nc,nc->n", way, values[:, :3]) > 0)[:, None]
                shown = [
                    drawing.draw(splats._replace(rgb=np.ascontiguousarray(some)), camera, antialias)[:, :, :3]
                    for some in (values[:, :3] * facing, np.concatenate([values[:, 3:] * facing, facing], axis=1))
                ]
                part = shown[1][:, :, 2:]
                seen = np.concatenate(shown, axis=2)[:, :, :5] / np.maximum(part, 1e-6)
                good = (part > _FACING).astype(np.float32)
                upright = np.clip(seen[:, :, :3] @ -camera.viewmat[2, :3], 0, 1)[:, :, None] ** 2
                upright = (upright * good).astype(np.float32)  # rims show much of what is behind
                seen, nothing = seen * upright, np.zeros_like(upright)
                found = drawing.backward(np.concatenate([seen[:, :, :3], nothing], axis=2), good[:, :, 0])
                total[:, :3] += found.rgb
                whole += found.error[:, None]
                found = drawing.backward(np.concatenate([seen[:, :, 3:], upright, nothing], axis=2), good[:, :, 0])
                total[:, 3:] += found.rgb[:, :2]
                weight += found.rgb[:, 2:]
        mean = total / weight
        off = np.linalg.norm(mean - values, axis=1, keepdims=True)
        sure = np.clip(((weight - _OWN) / np.maximum(whole, 1e-6) - _GRAZING) / _GRAZING, 0, 1)
        values += (mean - values) * sure * np.clip((off - _NEAR) / (_FAR - _NEAR), 0, 1)
        length = np.linalg.norm(values[:, :3], axis=1, keepdims=True)
        values[:, :3] = np.where(length > 1e-6, values[:, :3] / np.maximum(length, 1e-6), 0)
    return values[:, :3], values[:, 3], np.exp2(values[:, 4])
