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
        if not isinstance(value, str) or len(value) > most or (default is None and not value.strip()):
            raise self.error(key, f"expected a text of at most {most} characters, not {_shown(value)}")
        return value

    def name(self, key: str) -> str:
        """Return a name: lower-case letters, digits, - and _."""
        return self.checked_name(key, self._values.get(key))

    def checked_name(self, key: str, value: Any) -> str:
        """Return ``value``, which has to be a name."""
        if not isinstance(value, str) or not NAME.fullmatch(value):
            raise self.error(key, f"expected 1 to 40 small letters, digits, - and _, not {_shown(value)}")
        return value

    def choice(self, key: str, options: Sequence[str], default: str | None = None) -> str:
        """Return one of ``options``."""
        value = self._values.get(key, default)
        if value not in options or not isinstance(value, str):
            raise self.error(key, f"expected one of {', '.join(filter(None, options))}, not {_shown(value)}")
        return value

    def number(self, key: str, low: float, high: float, default: float | None = None) -> float:
        """Return a number from ``low`` to ``high``."""
        value = self._values.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
            raise self.error(key, f"expected a number from {low:g} to {high:g}, not {_shown(value)}")
        return value

    def count(self, key: str, low: int, high: int, default: int | None = None) -> int:
        """Return a whole number from ``low`` to ``high``."""
        value = self._values.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            raise self.error(key, f"expected a whole number from {low} to {high}, not {_shown(value)}")
        return value

    def flag(self, key: str, default: bool) -> bool:
        """Return a boolean."""
        value = self._values.get(key, default)
        if not isinstance(value, bool):
            raise self.error(key, f"expected true or false, not {_shown(value)}")
        return value

    def texts(self, key: str, least: int = 0, most: int = 200) -> tuple[str, ...]:
        """Return a list of distinct texts."""
        value = self._values.get(key, [])
        good = isinstance(value, list) and all(isinstance(one, str) and one.strip() for one in value)
        if not good or not least <= len(value) <= most:
            raise self.error(key, f"expected a list of {least} to {most} texts, not {_shown(value)}")
        twice = [one for one in value if value.count(one) > 1]
        if twice:
            raise self.error(key, f"{twice[0]!r:.60} is there twice; leave one out")
        return tuple(value)

    def table(self, key: str) -> Table:
        """Return a nested table; empty if it is missing."""
        return Table(f"{self.where}: {key}", self._values.get(key, {}))

    def tables(self, key: str) -> list[Table]:
        """Return the tables of a [[key]]."""
        value = self._values.get(key, [])
        if not isinstance(value, list):
            raise self.error(key, f"expected [[{key}]] once or more, not {_shown(value)}")
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


def _shown(value: Any) -> str:
    return "nothing" if value is None else f"{value!r:.60}"
