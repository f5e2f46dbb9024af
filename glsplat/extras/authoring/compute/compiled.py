"""numba, where it is installed: compiles functions on first use, and keeps what it compiled."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from typing import Any, TypeVar

__all__ = ["MISSING", "available", "compiled"]

F = TypeVar("F", bound=Callable[..., Any])

MISSING = "numba is not installed, without which splats are not fitted as they could be; pip install 'glsplat[make]'"
"""What to say where there is none."""


def available() -> bool:
    """True where kernels can be compiled."""
    return importlib.util.find_spec("numba") is not None


def compiled(function: F) -> F:
    """``function`` of numpy arrays and numbers as machine code that lets other threads run.

    Sums may be taken in another order than written (fastmath), the same one each time. Nothing is spread over threads
    here: who calls gives each thread its part, so results do not hang on their number.
    """
    from numba import njit

    options = {"nogil": True, "fastmath": {"contract", "reassoc", "arcp", "nsz", "afn"}, "error_model": "numpy"}
    try:
        made: F = njit(cache=True, **options)(function)
    except RuntimeError:  # neither the package's folder nor the user's can be written to
        made = njit(**options)(function)
    return made
