"""Read TOML strictly: values are requested by kind and range; unknown keys are errors."""

from __future__ import annotations

import difflib
import re
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from glsplat.errors import FormatError
from glsplat.io.files import open_regular

NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,39}")
"""Names usable as columns, file names and BIDS labels."""

MAX_FILE_BYTES = 1 << 20


class Table:
    """One table of a TOML file. ``where`` begins each message: the file and the path of keys."""

    def __init__(self, where: str, values: Any) -> None:
        if not isinstance(values, Mapping):
            raise FormatError(f"{where}: expected a table, not {_shown(values)}")
        self.where, self._values = where, dict(values)

    def __contains__(self, key: str) -> bool:
        return key in self._values

    def __getitem__(self, key: str) -> Any:
        return self._values[key]

    @property
    def keys(self) -> tuple[str, ...]:
        """Keys in the order of the file."""
        return tuple(self._values)

    def error(self, key: str, what: str) -> FormatError:
        """Return an error that names the key."""
        return FormatError(f"{self.where}: {key}: {what}")

    def _checked(self, key: str, value: Any, good: object, what: str) -> Any:
        if not good:
            raise self.error(key, f"expected {what}, not {_shown(value)}")
        return value

    def known(self, *keys: str) -> None:
        """Raise FormatError for any other key."""
        for key in self._values:
            if key not in keys:
                near = difflib.get_close_matches(key, keys, 1)
                hint = f"is it {near[0]}?" if near else f"there are {', '.join(keys)}"
                raise FormatError(f"{self.where}: there is no key {key!r:.60}; {hint}")

    def text(self, key: str, default: str | None = None, most: int = 20_000) -> str:
        """Return a text of at most ``most`` characters; without a default it is required and not blank."""
        value = self._values.get(key, default)
        good = isinstance(value, str) and len(value) <= most and (default is not None or value.strip())
        return str(self._checked(key, value, good, f"a text of at most {most} characters"))

    def name(self, key: str) -> str:
        """Return a name: lower-case letters, digits, - and _."""
        return self.checked_name(key, self._values.get(key))

    def checked_name(self, key: str, value: Any) -> str:
        """Return ``value``, which has to be a name."""
        good = isinstance(value, str) and NAME.fullmatch(value)
        return str(self._checked(key, value, good, "1 to 40 small letters, digits, - and _"))

    def choice(self, key: str, options: Sequence[str], default: str | None = None) -> str:
        """Return one of ``options``."""
        value = self._values.get(key, default)
        good = isinstance(value, str) and value in options
        return str(self._checked(key, value, good, f"one of {', '.join(filter(None, options))}"))

    def number(self, key: str, low: float, high: float, default: float | None = None) -> float:
        """Return a number from ``low`` to ``high``."""
        value: Any = self._values.get(key, default)
        good = is_number(value) and low <= value <= high
        found: float = self._checked(key, value, good, f"a number from {low:g} to {high:g}")
        return found

    def count(self, key: str, low: int, high: int, default: int | None = None) -> int:
        """Return a whole number from ``low`` to ``high``."""
        value: Any = self._values.get(key, default)
        good = is_number(value) and isinstance(value, int) and low <= value <= high
        return int(self._checked(key, value, good, f"a whole number from {low} to {high}"))

    def flag(self, key: str, default: bool) -> bool:
        """Return a boolean."""
        value = self._values.get(key, default)
        return bool(self._checked(key, value, isinstance(value, bool), "true or false"))

    def texts(self, key: str, least: int = 0, most: int = 200) -> tuple[str, ...]:
        """Return a list of distinct texts."""
        value = self._values.get(key, [])
        good = isinstance(value, list) and all(isinstance(one, str) and one.strip() for one in value)
        good = good and least <= len(value) <= most
        self._checked(key, value, good, f"a list of {least} to {most} texts")
        if twice := [one for one in value if value.count(one) > 1]:
            raise self.error(key, f"{twice[0]!r:.60} is there twice; leave one out")
        return tuple(value)

    def table(self, key: str) -> Table:
        """Return a nested table; empty if it is missing."""
        return Table(f"{self.where}: {key}", self._values.get(key, {}))

    def tables(self, key: str) -> list[Table]:
        """Return the tables of a [[key]]."""
        value = self._values.get(key, [])
        self._checked(key, value, isinstance(value, list), f"[[{key}]] once or more")
        return [Table(f"{self.where}: {key} {number}", one) for number, one in enumerate(value, 1)]


def read_toml(path: str | Path) -> Table:
    """Return the table of a whole file. Raises FormatError naming it."""
    with open_regular(path) as (file, size):
        if size > MAX_FILE_BYTES:
            raise FormatError(f"{path}: expected at most {MAX_FILE_BYTES >> 10} KiB, not {size >> 10}")
        data = file.read()
    try:
        return Table(str(path), tomllib.loads(data.decode()))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise FormatError(f"{path}: not TOML ({' '.join(str(error).split())})") from None


def is_number(value: Any) -> bool:
    """Return whether a value is a number and no boolean."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def _shown(value: Any) -> str:
    return "nothing" if value is None else f"{value!r:.60}"
