"""What values are made of: arrays of numbers in one type that nobody else can change, and plain numbers.

A value (Camera, Pose, Skin, Splats, Skeleton) is checked once, when it is made. That holds later only if the arrays
are its own: they are copied and made read-only. An array that is read-only already, down to the memory it owns, is
kept as it is, so that a million splats are not copied by every ``replace()``.
"""

from __future__ import annotations

import operator
from math import isfinite
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glsplat.errors import FormatError, GlsplatError

__all__ = ["count", "frozen", "number", "own", "own_whole", "plain", "restored"]

Kind = TypeVar("Kind", bound=np.generic)


def frozen(array: NDArray[Kind]) -> NDArray[Kind]:
    """The same array, read-only from now on: for one just made, that nobody else holds."""
    array.flags.writeable = False
    return array


def plain(value: ArrayLike, what: str, error: type[GlsplatError] = FormatError) -> NDArray[Any]:
    """``value`` as an array of integers or floats, not copied. Text, booleans, complex numbers and None are refused."""
    try:
        array = np.asarray(value)
    except (TypeError, ValueError, RuntimeError, OverflowError):  # ragged lists, tensors on a GPU
        raise error(f"{what} needs an array of numbers, not {_shown(value)}") from None
    if array.dtype.kind not in "iuf":
        raise error(f"{what} needs an array of numbers, not {_shown(value)}")
    return array


def own(value: ArrayLike, dtype: type[Kind], what: str, error: type[GlsplatError] = FormatError) -> NDArray[Kind]:
    """``value`` as a read-only C-contiguous array of the float type ``dtype``; copied unless it is one already."""
    array = plain(value, what, error)
    if array.dtype == dtype and array.flags.c_contiguous and _constant(array):
        return array
    if array.dtype == dtype:
        return frozen(np.array(array, order="C"))
    with np.errstate(over="ignore"):  # a double beyond float32 becomes infinite, and infinity has a fate of its own
        return frozen(array.astype(dtype, order="C"))


def own_whole(value: ArrayLike, dtype: type[Kind], what: str, error: type[GlsplatError] = FormatError) -> NDArray[Kind]:
    """``value`` as a read-only array of the integer type ``dtype``; numbers that do not fit it are refused."""
    array = plain(value, what, error)
    if array.dtype == dtype and array.flags.c_contiguous and _constant(array):
        return array
    if array.dtype.kind == "f" and not (np.isfinite(array) & (array == np.rint(array))).all():
        raise error(f"{what} needs whole numbers, found fractions, NaN or infinity")
    limits = np.iinfo(dtype)  # type: ignore[type-var]
    if array.size and (int(array.min()) < limits.min or int(array.max()) > limits.max):
        raise error(f"{what} needs whole numbers from {limits.min} to {limits.max}, found {_span(array)}")
    return frozen(np.array(array, dtype, order="C"))


def number(value: Any, what: str, error: type[GlsplatError] = FormatError) -> float:
    """``value`` as a float; NaN and infinity, booleans and text are refused."""
    if type(value) is not float:
        kind = getattr(getattr(value, "dtype", None), "kind", "f")
        vector = isinstance(value, np.ndarray) and value.ndim > 0
        if isinstance(value, (bool, str, bytes, complex)) or kind not in "iuf" or vector:
            raise error(f"{what} needs a number, not {_shown(value)}")
        try:
            value = float(value)
        except (TypeError, ValueError, OverflowError):
            raise error(f"{what} needs a number, not {_shown(value)}") from None
    if not isfinite(value):
        raise error(f"{what} needs a finite number, not {value}")
    return value


def count(value: Any, what: str, error: type[GlsplatError] = FormatError) -> int:
    """``value`` as an int: any integer type, but no float, no boolean, no text."""
    if type(value) is int:
        return value
    try:
        if isinstance(value, (bool, np.bool_)):
            raise TypeError
        return operator.index(value)
    except TypeError:
        raise error(f"{what} needs a whole number, not {_shown(value)}") from None


def restored(kind: type[Any], values: dict[str, Any]) -> Any:
    """A value as it was when it was pickled or copied, without checking it again; its arrays are read-only again."""
    made = object.__new__(kind)
    for name, value in values.items():
        object.__setattr__(made, name, frozen(value) if isinstance(value, np.ndarray) else value)
    return made


def _constant(array: NDArray[Any]) -> bool:
    """Whether no one can write to this memory through an array that it is known by."""
    memory: Any = array
    while isinstance(memory, np.ndarray):
        if memory.flags.writeable:
            return False
        memory = memory.base
    return memory is None or isinstance(memory, bytes)


def _span(array: NDArray[Any]) -> str:
    return f"{array.min():g} to {array.max():g}"


def _shown(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"an array of {value.dtype}"
    text = " ".join(repr(value).split())
    return f"{type(value).__name__} {text if len(text) <= 40 else text[:37] + '...'}"
