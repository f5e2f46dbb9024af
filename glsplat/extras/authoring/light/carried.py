"""The surface of splats that were made of others, which have one."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from glsplat.light.surface import Surface
from glsplat.rotations import unit_vectors
from glsplat.splats import Splats

__all__ = ["surface_carried"]

_AS_MANY = 4  # splats of a finer one that a coarser one's surface is the mean of, at most


def surface_carried(surface: Surface | None, before: Splats, after: Splats) -> Surface | None:
    """The surface of splats that were made of others: the mean of as many of the nearest as each stands for.

    Where there are as many they are the same ones moved a little, and each takes the nearest's.
    """
    usable = np.flatnonzero(before.finite())
    if surface is None or not len(usable):
        return None
    k = int(np.clip(round(len(before) / max(len(after), 1)), 1, min(_AS_MANY, len(usable))))
    means = np.nan_to_num(after.means.astype(np.float64), posinf=0, neginf=0)
    near = usable[cKDTree(before.means[usable].astype(np.float64)).query(means, k)[1].reshape(len(means), k)]
    normals = unit_vectors(surface.units[near].sum(axis=1))
    shade = None if surface.shade is None else np.exp2(np.log2(surface.shades[near]).mean(axis=1))
    return Surface.of(normals, surface.ao[near].mean(axis=1), shade)
