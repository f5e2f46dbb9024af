"""Blend between two limits."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
Floats = NDArray[np.floating[Any]]


def ramp(values: Floats | float, start: float | F64, end: float | F64) -> F64:
    """Return ``values`` mapped linearly to 0 at ``start`` and 1 at ``end``, clamped; ``end`` may be the lower one."""
    return np.asarray(np.clip((values - start) / (end - start), 0, 1))


def smoothstep(values: Floats, start: float | F64, end: float | F64) -> F64:
    """Return ``ramp`` with smooth ends, a cubic."""
    part = ramp(values, start, end)
    return np.asarray(part * part * (3 - 2 * part))
