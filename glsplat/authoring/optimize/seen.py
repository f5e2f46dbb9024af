"""What splats know of their surface, made to agree with what is seen: a picture mixes splats that lie over each other.

A splat of the inside of a cheek shows through between those of its outside, in the skin's colour: a fit has seen to
that. Lit by its own normal it would be a dark speck there. What is seen is mostly the outside, so each splat takes the
mean of the pictures where it shows; what nobody sees keeps its own, and teeth are mostly seen in an open mouth.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from glsplat.authoring.optimize.compiled import available
from glsplat.avatar import Avatar

__all__ = ["as_seen"]

F64 = NDArray[np.float64]

_ROUNDS = 3
_OWN = 1.0  # pixels of all pictures that a splat's own value counts as


def as_seen(avatar: Avatar, values: F64) -> F64:
    """Values [N, C] of the avatar's splats as pictures of it mix them.

    The values as they are without numba, and where there is nothing to look at.
    """
    if not available():
        return values
    from glsplat.authoring.optimize.pictures import looks_at
    from glsplat.authoring.optimize.rasterizer import Rasterizer

    antialias, drawing = avatar.splats.antialias, Rasterizer(len(avatar.splats))
    looks = list(looks_at(avatar))
    held = np.concatenate([values, np.zeros((len(values), -values.shape[1] % 3))], axis=1)
    low, span = held.min(axis=0, initial=0), np.maximum(np.ptp(held, axis=0), 1e-9) if len(held) else 1.0
    held = (held - low) / span  # colours
    for _ in range(_ROUNDS):
        total, weight = held * _OWN, np.full(len(held), _OWN)
        for splats, cameras in looks:
            for camera in cameras:
                for first in range(0, held.shape[1], 3):
                    mine = slice(first, first + 3)
                    drawn = drawing.draw(splats._replace(rgb=np.ascontiguousarray(held[:, mine])), camera, antialias)
                    covered = np.maximum(drawn[:, :, 3:], 1e-3)
                    slope = np.concatenate([drawn[:, :, :3] / covered, np.zeros_like(covered)], axis=2)
                    found = drawing.backward(slope, np.zeros_like(drawn[:, :, 0]))
                    total[:, mine] += found.rgb
                weight += found.weight
        held = total / weight[:, None]
    return np.asarray((held * span + low)[:, : values.shape[1]])
