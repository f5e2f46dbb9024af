"""A tidy table, with a row for each participant and condition and a column for each factor; the effects of a design.

>>> table = read_table("scores.csv", ["type", "method"])
>>> [factor.name for factor in table.factors if factor.within]
['type', 'method']
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import helmert

from glsplat.arrays import F64
from glsplat.errors import FormatError
from glsplat.io.files import open_regular

Ints = NDArray[np.intp]

MOST_CELLS = 256  # conditions of a design
_NOTHING = {"", "na", "nan", "n/a", "null", "none"}  # how programs write a missing answer

Effect = tuple[int, ...]
"""Indices of an effect's factors: (0,) is a main effect, (0, 2) an interaction."""


@dataclass(frozen=True)
class Factor:
    """An independent variable. ``within``: participants saw more than one of its levels."""

    name: str
    levels: tuple[str, ...]
    within: bool


@dataclass(frozen=True, eq=False)
class Table:
    """N answers to one response of a study.

    ``participant`` [N] and ``codes`` [N, F] index ``names`` and each factor's levels; ``values`` [N] are finite.
    """

    response: str
    names: tuple[str, ...]
    factors: tuple[Factor, ...]
    participant: Ints
    codes: Ints
    values: F64
    unanswered: int = 0  # number of rows left out because their value was missing

    @cached_property
    def shape(self) -> tuple[int, ...]:
        """Number of levels of each factor."""
        return tuple(len(factor.levels) for factor in self.factors)

    @cached_property
    def cell(self) -> Ints:
        """Each row's cell of the whole design, [N]."""
        return self.combination(range(len(self.factors)))

    @cached_property
    def within(self) -> tuple[int, ...]:
        """Indices of the factors that vary within participants."""
        return tuple(i for i, factor in enumerate(self.factors) if factor.within)

    @cached_property
    def between(self) -> tuple[int, ...]:
        """Indices of the factors that vary only between participants."""
        return tuple(i for i, factor in enumerate(self.factors) if not factor.within)

    @cached_property
    def answers(self) -> Ints:
        """Number of each participant's answers to each combination of the within factors, [P, K]."""
        counts = np.zeros((len(self.names), math.prod(self.shape[i] for i in self.within)), np.intp)
        np.add.at(counts, (self.participant, self.combination(self.within)), 1)
        return counts

    @cached_property
    def group(self) -> Ints:
        """Each participant's combination of the between factors, [P]."""
        out = np.zeros(len(self.names), np.intp)
        out[self.participant] = self.combination(self.between)
        return out

    @property
    def incomplete(self) -> tuple[str, ...]:
        """Participants without any answer to some combination of the within factors."""
        return tuple(np.array(self.names)[(self.answers == 0).any(axis=1)].tolist())

    @property
    def balanced(self) -> bool:
        """Whether all participants answered all combinations equally often, and groups are of one size."""
        sizes = np.bincount(self.group)
        return bool((self.answers == self.answers[0, 0]).all() and (sizes == sizes[0]).all())

    def combination(self, factors: Sequence[int]) -> Ints:
        """Return each row's combination of the levels of some factors, [N]; the last factor varies fastest."""
        if not factors:
            return np.zeros(len(self.codes), np.intp)
        return np.asarray(np.ravel_multi_index(tuple(self.codes[:, factors].T), [self.shape[i] for i in factors]))

    def of(self, names: Sequence[str]) -> Table:
        """Return the table of these participants alone. Raises FormatError if a combination loses all its answers."""
        kept = np.isin(np.array(self.names)[self.participant], names)
        rows = [
            (self.names[p], [f.levels[c] for f, c in zip(self.factors, codes, strict=True)], value)
            for p, codes, value in zip(self.participant[kept], self.codes[kept], self.values[kept], strict=True)
        ]
        levels = {factor.name: factor.levels for factor in self.factors}
        return replace(make_table(self.response, levels, rows), unanswered=self.unanswered)


def read_table(
    path: str | Path,
    factors: Sequence[str] | Mapping[str, Sequence[str]],
    *,
    participant: str = "participant",
    response: str = "value",
    measure: str | None = None,
) -> Table:
    """Return one response of a CSV file (UTF-8, a header, decimal points).

    ``factors`` names columns, with their levels in order (else sorted). ``measure`` selects the rows with this value in
    the column "measure". An empty value, NA or an absent row is a missing answer. Raises FormatError naming line and
    column.
    """
    wanted = [participant, *factors, response, *(["measure"] if measure is not None else [])]
    if measure is None:
        measures = {row["measure"] for _, row in read_rows(path, wanted) if "measure" in row}
        if len(measures) > 1:
            some = ", ".join(sorted(measures)[:8])
            raise FormatError(f"{path}: expected one measure, found several; choose one of {some}")
    if len(set(wanted)) < len(wanted):
        raise FormatError(f"{path}: expected participant, factors and response to be different columns")
    answers, unanswered = [], 0
    for line, row in read_rows(path, wanted):
        if measure is not None and row["measure"] != measure:
            continue
        value = number_of(path, line, response, row[response])
        if value is None:
            unanswered += 1
            continue
        for name in (participant, *factors):
            if not row[name]:
                raise FormatError(f"{path}, line {line}: column {name!r} is empty; each row needs one")
        answers.append((row[participant], [row[name] for name in factors], value))
    if measure is not None and not answers and not unanswered:
        raise FormatError(f"{path}: no row has the measure {measure!r}")
    levels = {name: tuple(factors[name]) if isinstance(factors, Mapping) else () for name in factors}
    try:
        table = make_table(measure or response, levels, answers)
    except FormatError as error:
        raise FormatError(f"{path}: {error}") from None
    return replace(table, unanswered=unanswered)


def make_table(
    response: str, factors: Mapping[str, Sequence[str]], rows: Sequence[tuple[str, Sequence[str], float]]
) -> Table:
    """Return a table from rows of participant, levels in the order of ``factors``, and value.

    A factor without levels gets those that occur, sorted, numbers by value. Raises FormatError if a factor has fewer
    than two levels, a combination has no answer, or there are fewer than two participants.
    """
    if not factors:
        raise FormatError("expected at least one factor, got none")
    names = sorted({row[0] for row in rows}, key=_natural)
    if len(names) < 2:
        raise FormatError(f"expected answers of at least two participants, found {len(names)}")
    columns = [[row[1][i] for row in rows] for i in range(len(factors))]
    place = {name: i for i, name in enumerate(names)}
    participant = np.array([place[row[0]] for row in rows], np.intp)
    made, codes = [], []
    for (name, given), column in zip(factors.items(), columns, strict=True):
        found = set(column)
        levels = tuple(given) or tuple(sorted(found, key=_natural))
        if unknown := found - set(levels):
            raise FormatError(f"factor {name!r} knows {', '.join(levels)}, not {min(unknown)!r}")
        if len(levels) < 2 or len(set(levels)) < len(levels):
            raise FormatError(f"factor {name!r} needs two levels or more, each once; found {', '.join(levels)}")
        code = np.array([levels.index(text) for text in column], np.intp)
        seen = np.zeros((len(names), len(levels)), bool)
        seen[participant, code] = True
        made.append(Factor(name, levels, bool((seen.sum(axis=1) > 1).any())))
        codes.append(code)
    if math.prod(len(factor.levels) for factor in made) > MOST_CELLS:
        raise FormatError(f"expected at most {MOST_CELLS} conditions, found more; are all of these columns factors?")
    table = Table(
        response, tuple(names), tuple(made), participant, np.stack(codes, 1), np.array([row[2] for row in rows], float)
    )
    empty = np.flatnonzero(np.bincount(table.cell, minlength=math.prod(table.shape)) == 0)
    if len(empty):
        one = np.unravel_index(empty[0], table.shape)
        words = ", ".join(f"{f.name} = {f.levels[i]}" for f, i in zip(made, one, strict=True))
        raise FormatError(f"nobody answered in {words}; a full factorial analysis needs every combination")
    return table


def read_rows(path: str | Path, wanted: Sequence[str] = ()) -> Iterator[tuple[int, dict[str, str]]]:
    """Yield line number and stripped texts by column for each row of a CSV file.

    Raises FormatError, also if a column of ``wanted`` is missing.
    """
    with open_regular(path) as (file, _):
        reader = csv.reader(io.TextIOWrapper(file, encoding="utf-8-sig", newline=""), strict=True)
        count = 0
        try:
            header = [name.strip() for name in next(reader, [])]
            if len(set(header)) < len(header) or not header:
                raise FormatError(f"{path}: expected a header that names each column once")
            if lost := [name for name in wanted if name not in header]:
                raise FormatError(f"{path}: no column {', '.join(map(repr, lost))}; there are {', '.join(header)}")
            for row in filter(None, reader):
                if len(row) != len(header):
                    raise FormatError(
                        f"{path}, line {reader.line_num}: {len(row)} columns, but the header has {len(header)}"
                    )
                count += 1
                yield reader.line_num, dict(zip(header, (cell.strip() for cell in row), strict=True))
        except UnicodeDecodeError as error:
            raise FormatError(f"{path}: expected a CSV file in UTF-8, but {error}") from None
        except csv.Error as error:
            raise FormatError(f"{path}: not a CSV file ({error})") from None
    if not count:
        raise FormatError(f"{path}: expected rows below the header, found none")


def number_of(path: str | Path, line: int, column: str, text: str) -> float | None:
    """Return the number in a cell; None for an empty one or NA. Raises FormatError naming line and column."""
    if text.lower() in _NOTHING:
        return None
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not abs(value) < 1e100 or "_" in text:
        raise FormatError(f"{path}, line {line}: column {column!r} needs a number, not {text!r:.40}")
    return value


def _natural(text: str) -> tuple[tuple[int, float, str], ...]:
    """Return a key that sorts P2 before P10 and 0.5 before 10."""
    parts = re.split(r"(\d+(?:\.\d+)?)", text)
    return tuple((1, float(part), "") if i % 2 else (0, 0.0, part) for i, part in enumerate(parts))


def effects_of(count: int) -> list[Effect]:
    """Return all main effects and interactions of ``count`` factors, those of few factors first (the order of R)."""
    return [effect for size in range(1, count + 1) for effect in combinations(range(count), size)]


@lru_cache(maxsize=256)
def hypothesis(shape: tuple[int, ...], effect: Effect) -> F64:
    """Return the contrasts [d, prod(shape)] of cell means that are 0 without the effect; rows are orthonormal.

    Cells weigh the same, however many answers they have: type III sums of squares (sum contrasts in R).
    """
    parts = [helmert(n) if i in effect else np.full((1, n), 1 / math.sqrt(n)) for i, n in enumerate(shape)]
    out = kron(parts)
    out.flags.writeable = False  # cached
    return out


def averages(shape: Sequence[int], effect: Effect) -> F64:
    """Return the weights [K, prod(shape)] of estimated marginal means, a row for each of the effect's K cells."""
    parts = [np.eye(n) if i in effect else np.full((1, n), 1 / n) for i, n in enumerate(shape)]
    return kron(parts)


def kron(parts: Sequence[F64]) -> F64:
    """Return the Kronecker product of all ``parts``; [[1]] for none."""
    out: F64 = np.ones((1, 1))
    for part in parts:
        out = np.asarray(np.kron(out, part), np.float64)
    return out
