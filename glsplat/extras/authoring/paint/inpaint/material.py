"""The material at points of the surface: cloth or skin, its colour, and how far its colours may differ."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.dress.skirt import unlike
from glsplat.extras.authoring.paint.ramps import ramp
from glsplat.rotations import lengths

F64 = NDArray[np.float64]

_SAME_TOLERANCES, _OTHER_TOLERANCES = 1.0, 1.5  # from a cloth's colour: surely the same cloth, surely another one

NECKLINE_DISTANCE = 0.1
"""From the face's colour, in square roots of linear light: nearer colours above the armpits are a neckline."""


@dataclass(frozen=True, slots=True, eq=False)
class Material:
    """The most likely material at M points."""

    colour: F64  # [M, 3] linear, unlit
    tolerance: F64  # [M] distance in square roots of linear light within which a colour is the same cloth
    known: F64  # [M] 1 where there is a material, else 0
    pattern: NDArray[np.bool_]  # [M] whether it has other colours besides, all around the body
    skin: F64  # [M, 3] square roots of the colour that is no part of a pattern there; NaN without one

    def at(self, some: NDArray[np.intp]) -> Material:
        """Return the material of N of the points."""
        fields = ("colour", "tolerance", "known", "pattern", "skin")
        return Material(*(getattr(self, field)[some] for field in fields))

    def distance(self, look: F64, shading: float | F64 = 0.0) -> F64:
        """Return [M] distances of square roots of unlit linear colours [M, 3] from its colour, in tolerances.

        What the fraction ``shading`` of more or less light explains is left out.
        """
        return np.asarray(unlike(look, np.sqrt(self.colour), shading) / self.tolerance)

    def likeness(self, plain: F64, patterned: bool = True, shading: float | F64 = 0.0) -> F64:
        """Return [M] from 0 to 1: how surely unlit linear colours [M, 3] are this material.

        With ``patterned``, colours of its pattern are, too. For ``shading`` see ``distance``.
        """
        look = np.sqrt(np.maximum(plain, 0))
        sure = ramp(self.distance(look, shading), _OTHER_TOLERANCES, _SAME_TOLERANCES)
        if patterned:
            sure[self.pattern & ~(lengths(look - self.skin) < NECKLINE_DISTANCE)] = 1.0
        return np.where(self.known > 0, sure, 1.0)
