"""What a point of the surface is most likely to be: which cloth, or skin, and how far its colours may lie apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glsplat.rotations import component_sums, lengths

__all__ = ["BARE", "Ground"]

F64 = NDArray[np.float64]

_SAME = 1.0, 1.5  # tolerances of the cloth's own colour within which it is the same cloth, and beyond which it is not
_PALM = 0.7, 1.8  # of a hand's colour, how bright its parts may be

BARE = 0.1
"""In square roots of linear light, from the face: so near to it, a pattern above the armpits is a neckline."""


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """What M points are most likely to be."""

    colour: F64  # [M, 3] linear, without light
    tolerance: F64  # [M] how far another colour may be away, in square roots, to be the same cloth
    there: F64  # [M] 1 where anything is known, else 0
    pattern: NDArray[np.bool_]  # [M] whether it has other colours besides, all around
    skin: F64  # [M, 3] square roots of what is no part of a pattern there; not a number where nothing is
    hand: NDArray[np.bool_]  # [M]

    def at(self, some: NDArray[np.intp]) -> Ground:
        """Of N of the points."""
        fields = ("colour", "tolerance", "there", "pattern", "skin", "hand")
        return Ground(*(getattr(self, field)[some] for field in fields))

    def away(self, look: F64) -> F64:
        """[M] how far square roots of linear colours [M, 3] without light lie from it, in tolerances.

        A hand's brightness says nothing: palms, nails and backs of hands are of different ones.
        """
        own = np.sqrt(self.colour)
        scale = component_sums(look * own) / np.maximum(component_sums(own**2), 1e-9)
        own[self.hand] *= scale.clip(*_PALM)[self.hand, None]
        return np.asarray(lengths(look - own) / self.tolerance)

    def alike(self, plain: F64, patterned: bool = True) -> F64:
        """[M] from 0 to 1: how surely linear colours [M, 3] without light are the cloth that is there.

        With ``patterned`` those of its pattern are, too.
        """
        look = np.sqrt(np.maximum(plain, 0))
        away = self.away(look)
        sure = (_SAME[1] - away).clip(0, _SAME[1] - _SAME[0]) / (_SAME[1] - _SAME[0])
        if patterned:
            sure[self.pattern & ~(lengths(look - self.skin) < BARE)] = 1.0
        return np.where(self.there > 0, sure, 1.0)
