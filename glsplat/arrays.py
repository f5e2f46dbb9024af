"""Validate the parts of immutable values: read-only arrays of one type, and plain numbers.

A value (Camera, Pose, Skin, Splats, Skeleton) is checked once, when it is made, so its arrays must not change later:
they are copied and made read-only. An array that is already read-only, down to the memory it owns, is not copied, so
that ``replace()`` of a million splats is cheap.
"""

from __future__ import annotations

import operator
import sys
from collections.abc import Mapping
from dataclasses import fields
from math import isfinite
from types import NoneType
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glsplat.errors import FormatError, GlsplatError

__all__ = [
    "Value",
    "colour",
    "count",
    "flag",
    "frozen",
    "frozen_mapping",
    "instance",
    "listed",
    "number",
    "own",
    "own_whole",
    "pixels",
    "plain",
    "restored",
    "rows",
    "shares",
]

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Kind = TypeVar("Kind", bound=np.generic)


class Value:
    """Base of frozen dataclasses whose ``__init__`` checks and copies its arguments."""

    __slots__ = ()

    def _keep(self, **values: Any) -> None:
        """Set fields, in ``__init__``."""
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def __reduce__(self) -> tuple[Any, ...]:
        return restored, (type(self), {f.name: getattr(self, f.name) for f in fields(self)})  # type: ignore[arg-type]


def frozen(array: NDArray[Kind]) -> NDArray[Kind]:
    """Make an array read-only and return it. The caller must hold its only reference."""
    array.flags.writeable = False
    return array


def plain(value: ArrayLike, what: str, error: type[GlsplatError] = FormatError) -> NDArray[Any]:
    """Return ``value`` as an array of integers or floats, without a copy where possible.

    Raises ``error`` for text, booleans, complex numbers, None and masked values.
    """
    if _masked(value):
        raise error(f"{what} needs an array without masked values; fill them (filled()) or leave them out")
    try:
        array = np.asarray(value)
    except (TypeError, ValueError, RuntimeError, OverflowError):  # ragged lists, tensors on a GPU
        raise error(f"{what} needs an array of numbers, not {_shown(value)}") from None
    if array.dtype.kind not in "iuf":
        raise error(f"{what} needs an array of numbers, not {_shown(value)}")
    return array


def own(value: ArrayLike, dtype: type[Kind], what: str, error: type[GlsplatError] = FormatError) -> NDArray[Kind]:
    """Return ``value`` as a read-only C-contiguous float array of ``dtype``, copied unless it is one already."""
    array = plain(value, what, error)
    if array.dtype == dtype and array.flags.c_contiguous and _constant(array):
        return array
    if array.dtype == dtype:
        return frozen(np.array(array, order="C"))
    with np.errstate(over="ignore"):  # a double beyond float32 becomes infinite, which is checked elsewhere
        return frozen(array.astype(dtype, order="C"))


def own_whole(value: ArrayLike, dtype: type[Kind], what: str, error: type[GlsplatError] = FormatError) -> NDArray[Kind]:
    """Return ``value`` as a read-only integer array of ``dtype``. Raises ``error`` for numbers that do not fit."""
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
    """Return ``value`` as a float. Raises ``error`` for NaN, infinity, booleans and text."""
    if type(value) is not float:
        kind = getattr(getattr(value, "dtype", None), "kind", "f")
        vector = isinstance(value, np.ndarray) and value.ndim > 0
        if isinstance(value, (bool, str, bytes, complex)) or kind not in "iuf" or vector or _masked(value):
            raise error(f"{what} needs a number, not {_shown(value)}")
        try:
            value = float(value)
        except (TypeError, ValueError, OverflowError):
            raise error(f"{what} needs a number, not {_shown(value)}") from None
    if not isfinite(value):
        raise error(f"{what} needs a finite number, not {value}")
    return value


def count(value: Any, what: str, error: type[GlsplatError] = FormatError, least: int | None = None) -> int:
    """Return ``value`` as an int of 63 bits, at least ``least``. Raises ``error`` for floats, booleans and text."""
    value = bits(value, what, error)
    if abs(value) >= 2**63:
        raise error(f"{what} needs a whole number of at most 19 digits")
    if least is not None and value < least:
        raise error(f"{what} needs at least {least}, not {value}")
    return value


def bits(value: Any, what: str, error: type[GlsplatError] = FormatError) -> int:
    """Return ``value`` as an int of any length (-1: all bits). Raises ``error`` for floats, booleans and text."""
    if type(value) is int:
        return value
    try:
        if isinstance(value, (bool, np.bool_)):
            raise TypeError
        return operator.index(value)
    except TypeError:
        raise error(f"{what} needs a whole number, not {_shown(value)}") from None


def flag(value: Any, what: str, error: type[GlsplatError] = FormatError) -> bool:
    """Return ``value`` as a bool. Raises ``error`` for other types, because the text "no" would be true."""
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    raise error(f"{what} is True or False, not {_shown(value)}")


def pixels(value: Any, error: type[GlsplatError] = FormatError) -> tuple[int, int]:
    """Return width and height as ints. Raises ``error`` unless both are whole numbers of at least 1."""
    if isinstance(value, np.ndarray) and value.ndim == 1:
        value = tuple(value)
    if not isinstance(value, (tuple, list)) or len(value) != 2:
        raise error(f"size needs two whole numbers, width and height, not {_shown(value)}")
    width, height = count(value[0], "size's width", error), count(value[1], "size's height", error)
    if min(width, height) < 1:
        raise error(f"size needs at least 1x1 pixels, not {width}x{height}")
    return width, height


def shares(value: ArrayLike, what: str, error: type[GlsplatError] = FormatError, hint: str = "") -> NDArray[Any]:
    """Return ``value`` as an array of fractions from 0 to 1. Raises ``error`` for a range of 0 to 255.

    Floats from -1 to 2 are accepted, as spherical harmonics overshoot. NaN and infinity are not checked.
    """
    array = plain(value, what, error)
    finite = array[np.isfinite(array)]
    brightest, darkest = finite.max(initial=0), finite.min(initial=0)
    if brightest > (2 if array.dtype.kind == "f" else 1):
        raise error(f"{what} needs 0 to 1, found {brightest:g}; divide 0 to 255 by 255{hint}")
    if darkest < -1:
        raise error(f"{what} needs 0 to 1, found {darkest:g}")
    return array


def colour(value: ArrayLike, what: str, error: type[GlsplatError] = FormatError) -> tuple[float, float, float]:
    """Return red, green and blue from 0 to 1 as floats."""
    if isinstance(value, tuple) and len(value) == 3 and all(type(v) is float and -1 <= v <= 2 for v in value):
        return value  # as nearly always: checked without an array
    array = shares(value, what, error)
    if array.shape != (3,) or not np.isfinite(array).all():
        raise error(f"{what} is three finite numbers, not {value!r:.60}")
    red, green, blue = map(float, array.tolist())
    return red, green, blue


class FrozenDict(dict[Any, Any]):
    """A dict that refuses changes; ``dict(it)`` is a mutable copy."""

    def _refuse(self, *_: Any, **__: Any) -> Any:
        raise TypeError(
            "this belongs to a value and cannot be changed; make a dict or list of it, and replace() the value"
        )

    __setitem__ = __delitem__ = __ior__ = clear = pop = popitem = setdefault = update = _refuse

    def __reduce__(self) -> tuple[Any, ...]:
        return FrozenDict, (dict(self),)


class FrozenList(list[Any]):
    """A list that refuses changes."""

    _refuse = FrozenDict._refuse
    __setitem__ = __delitem__ = __iadd__ = __imul__ = append = clear = extend = insert = pop = remove = _refuse
    reverse = sort = _refuse

    def __reduce__(self) -> tuple[Any, ...]:
        return FrozenList, (list(self),)


def frozen_mapping(value: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return an immutable copy of a mapping, and of the dicts and lists in it."""
    return value if isinstance(value, FrozenDict) else FrozenDict({key: _frozen(one) for key, one in value.items()})


def _frozen(value: Any) -> Any:
    if isinstance(value, dict):
        return frozen_mapping(value)
    return FrozenList(map(_frozen, value)) if type(value) is list else value


def instance(
    value: Any,
    kinds: type[Any] | tuple[type[Any], ...],
    what: str,
    error: type[GlsplatError] = FormatError,
    hint: str = "",
) -> Any:
    """Return ``value`` if it is an instance of ``kinds``, else raise ``error``, whose message ends with ``hint``."""
    if isinstance(value, kinds):
        return value
    listed = kinds if isinstance(kinds, tuple) else (kinds,)
    names = " or ".join(kind.__name__ for kind in listed if kind is not NoneType)
    raise error(f"{what} needs a {names}, not {_shown(value)}{hint and '; ' + hint}")


def restored(kind: type[Any], values: dict[str, Any]) -> Any:
    """Return an unpickled or copied value without validating it again; its arrays are made read-only."""
    made = object.__new__(kind)
    for name, value in values.items():
        object.__setattr__(made, name, frozen(value) if isinstance(value, np.ndarray) else value)
    return made


def _masked(value: Any) -> bool:
    """Return whether a value, or an array in a list of them, has masked entries (numpy.ma)."""
    if "numpy.ma" not in sys.modules:  # no masked array can exist
        return False
    if isinstance(value, (list, tuple)):
        return any(map(_masked, value))
    return isinstance(value, np.ma.MaskedArray) and bool(np.ma.getmaskarray(value).any())


def listed(value: Any, what: str, error: type[GlsplatError] = FormatError) -> tuple[Any, ...]:
    """Return the members of an iterable as a tuple. Raises ``error`` if it is none."""
    try:
        return tuple(value)
    except TypeError:
        raise error(f"{what} needs a list, not {_shown(value)}") from None


def rows(index: ArrayLike, count: int) -> NDArray[np.intp]:
    """Return an integer or boolean index of ``count`` rows as integers. Raises FormatError if one is out of range."""
    try:
        i = np.asarray(index)
    except (TypeError, ValueError, RuntimeError, OverflowError):
        i = np.zeros(())
    if i.dtype == bool and i.shape == (count,):
        i = np.flatnonzero(i)
    if _masked(index) or i.ndim != 1 or (i.size and (i.dtype.kind not in "iu" or i.min() < -count or i.max() >= count)):
        raise FormatError(f"take() needs a list of whole numbers below {count}, or {count} booleans")
    return i.astype(np.intp)  # an empty list has no integer type


def _constant(array: NDArray[Any]) -> bool:
    """Return whether the array and every array that it is a view of are read-only."""
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
