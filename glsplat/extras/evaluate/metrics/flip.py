"""FLIP (Andersson et al. 2020): the visible difference of two alternating pictures, by NVIDIA's own program."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from glsplat.optional import require_package

from .pixels import WHOLE, Box, checked


def flip(picture: NDArray[np.floating], truth: NDArray[np.floating], box: Box = WHOLE) -> float:
    """Return mean FLIP over ``box``, for low dynamic range and its default of 67 pixels per degree; 0 is equal.

    Raises GlsplatError if the package flip-evaluator is missing.
    """
    picture, truth = checked(picture, truth)
    require_package("FLIP", "flip_evaluator", "evaluate")
    import flip_evaluator

    pair = [np.ascontiguousarray(one, np.float32) for one in (truth, picture)]
    errors, mean, _ = flip_evaluator.evaluate(*pair, "LDR", applyMagma=False)
    return float(mean) if box == WHOLE else float(np.asarray(errors)[box].mean())
