"""Compile functions with numba, on first use and with a cache on disk."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from typing import Any, TypeVar

F = TypeVar("F", bound=Callable[..., Any])

NUMBA_MISSING = "numba is not installed, so splats are not fitted; pip install 'glsplat[make]'"
"""The message for users without numba."""


def available() -> bool:
    """Return whether numba is installed."""
    return importlib.util.find_spec("numba") is not None


def compiled(function: F) -> F:
    """Return ``function``, which takes numpy arrays and numbers, as machine code that releases the GIL.

    fastmath may reorder sums, the same way on each call. The function itself uses one thread; callers split the work,
    so results do not depend on the number of threads.
    """
    from numba import njit

    options = {"nogil": True, "fastmath": {"contract", "reassoc", "arcp", "nsz", "afn"}, "error_model": "numpy"}
    try:
        made: F = njit(cache=True, **options)(function)
    except RuntimeError:  # neither the package's folder nor the user's cache is writable
        made = njit(**options)(function)
    return made
