"""Words that belong into a picture: the label of a person, and notices. What they say and where they belong.

lettering.py writes them into finished pictures; docs/consent.md has the rule.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["HEIGHT", "Label", "driven_by"]

HEIGHT = 0.045
"""Metres from the lower to the upper edge of a line of a label, unless that is too small or too large to be read."""

Box = NDArray[np.float64]
"""[2, 3] metres: lowest and highest corner."""


@dataclass(frozen=True, slots=True, eq=False)
class Label:
    """Words for a thing: in every picture that shows any of it, over ``place`` [3] (metres) where that is in sight."""

    text: str
    place: NDArray[np.float64]
    height: float = HEIGHT  # metres of a line
    opacity: float = 1.0
    box: Callable[[], Box | None] | None = None
    """The box that holds the thing, None: there is nothing of it. Without one the thing is no more than ``place``."""


def driven_by(name: str, notice: str = "") -> str:
    """Return the label of a person who is not there in the flesh; ``notice`` is added to it."""
    return ", ".join([f"driven by {name or 'somebody'}", "synthetic", *([notice] if notice else [])])
