"""Read the sidecar of a study's table: factors with ordered levels, and measures with their items.

``glsplat study export`` writes it to ``scores.json`` beside ``scores.csv``, under the key "Study".
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from glsplat.arrays import F64
from glsplat.errors import FormatError
from glsplat.io.files import read_json

from .table import number_of, read_rows

MOST_BYTES = 4 << 20


@dataclass(frozen=True)
class Measure:
    """A response: its items as questionnaire.item, the reversed ones, and the scale's ends."""

    name: str
    items: tuple[str, ...] = ()
    reversed: frozenset[str] = frozenset()
    ends: tuple[float, float] | None = None


@dataclass(frozen=True)
class Codebook:
    """Factors by name with their levels, and the measures."""

    factors: Mapping[str, tuple[str, ...]]
    measures: tuple[Measure, ...]


def read_codebook(path: Path) -> Codebook | None:
    """Return the sidecar in a file; None if there is no file, or no key "Study" in it. Raises FormatError."""
    if not path.is_file():
        return None
    whole = read_json(path, "a sidecar", MOST_BYTES)
    if not isinstance(whole, dict) or "Study" not in whole:
        return None
    try:
        study = whole["Study"]
        factors = {name: _texts(factor["levels"]) for name, factor in study["factors"].items()}
        measures = tuple(_measure(name, said) for name, said in study.get("measures", {}).items())
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise FormatError(
            f"{path}: its key Study does not list factors and measures correctly ({error!r:.80})"
        ) from None
    return Codebook(factors, measures)


def item_answers(path: str | Path, measure: Measure) -> F64:
    """Return answers [N, K] to a measure's items, NaN where missing, with reversed items turned back.

    A row is one participant and step. ``path``: a CSV file with the columns participant, step, questionnaire, item
    and value. Raises FormatError.
    """
    wanted = ("participant", "step", "questionnaire", "item", "value")
    asked: dict[tuple[str, str], F64] = {}
    place = {item: i for i, item in enumerate(measure.items)}
    for line, row in read_rows(path, wanted):
        item = f"{row['questionnaire']}.{row['item']}"
        if item in place:
            value = number_of(path, line, "value", row["value"])
            own = asked.setdefault((row["participant"], row["step"]), np.full(len(place), np.nan))
            own[place[item]] = np.nan if value is None else value
    answers = np.array(list(asked.values())).reshape(-1, len(place))
    for item in measure.reversed & set(place):
        if measure.ends is None:
            raise FormatError(f"{measure.name}: item {item} is reversed, but the sidecar lacks the scale's range")
        answers[:, place[item]] = sum(measure.ends) - answers[:, place[item]]
    return answers


def wide_items(path: str | Path, items: Sequence[str]) -> F64:
    """Return answers [N, K] from a table with one column per item, NaN for an empty cell. Raises FormatError."""
    found = [[number_of(path, line, name, row[name]) for name in items] for line, row in read_rows(path, items)]
    return np.array([[np.nan if value is None else value for value in row] for row in found])


def _measure(name: str, said: Any) -> Measure:
    ends = said.get("range")
    known = (float(ends[0]), float(ends[1])) if ends is not None else None
    return Measure(name, _texts(said.get("items", [])), frozenset(_texts(said.get("reversed", []))), known)


def _texts(values: Any) -> tuple[str, ...]:
    if not isinstance(values, list) or not all(isinstance(value, str) for value in values):
        raise TypeError("expected a list of texts")
    return tuple(values)
