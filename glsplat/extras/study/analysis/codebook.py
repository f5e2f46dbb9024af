"""The sidecar of a study's table, answers to the items of its measures, and the items' reliability.

``glsplat study export`` writes the sidecar, factors with ordered levels and measures with their items, to
``scores.json`` beside ``scores.csv``, under the key "Study". Reliability is Cronbach's alpha and McDonald's omega.

>>> reliability(items).alpha
0.838
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize
from scipy.special import fdtri

from glsplat.arrays import F64
from glsplat.errors import FormatError
from glsplat.extras.statistics.nonparametric import LEVEL
from glsplat.io.files import read_json

from .table import number_of, read_rows

MOST_BYTES = 4 << 20

SMALLEST = 0.005  # lower bound of an item's unique share of variance, as in R's factanal


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


@dataclass(frozen=True)
class Reliability:
    """Reliability of ``n`` complete rows of ``items`` items; None where undefined."""

    n: int
    items: int
    left_out: int  # rows with a missing item
    alpha: float | None
    low: float | None
    high: float | None  # 95 % interval of alpha
    standardised: float | None
    """Alpha of items scaled to equal variance, from their mean correlation."""
    omega: float | None
    """Omega total of one factor; None for fewer than three items, which do not determine a factor."""
    at_bound: bool
    """Whether the factor explains an item completely (a Heywood case), so that omega is unreliable."""


def reliability(items: F64) -> Reliability:
    """Return the reliability of answers [N, K], NaN where missing; rows with a missing item are left out.

    Alpha: Cronbach (1951), its interval Feldt (1965), exact for normal answers. Omega: McDonald (1999), from the
    loadings of one factor fitted by maximum likelihood (Joreskog 1967, as R's factanal), in the items' own units.
    Turn reversed items back first. Raises FormatError for fewer than two items or three complete rows.
    """
    kept = items[np.isfinite(items).all(axis=1)]
    n, k = kept.shape
    if k < 2 or n < 3:
        raise FormatError(f"reliability needs two items and three complete rows or more; there are {k} and {n}")
    left_out = len(items) - n
    covariance = np.cov(kept.T)
    deviations = np.sqrt(np.diag(covariance))
    total = covariance.sum()
    if not total > 1e-12 * np.abs(covariance).sum() or not (deviations > 1e-12 * np.abs(kept).max()).all():
        return Reliability(n, k, left_out, None, None, None, None, None, False)
    alpha = k / (k - 1) * (1 - np.trace(covariance) / total)
    df = n - 1, (n - 1) * (k - 1)
    low, high = (float(1 - (1 - alpha) * fdtri(*df, share)) for share in ((1 + LEVEL) / 2, (1 - LEVEL) / 2))
    correlation = covariance / np.outer(deviations, deviations)
    mean = (correlation.sum() - k) / (k * (k - 1))
    standardised = float(k * mean / (1 + (k - 1) * mean))
    omega, at_bound = _omega(correlation, deviations) if k > 2 else (None, False)
    return Reliability(n, k, left_out, float(alpha), low, high, standardised, omega, at_bound)


def _omega(correlation: F64, deviations: F64) -> tuple[float | None, bool]:
    """Return omega of one factor, and whether an item's unique variance reached its bound."""

    def loadings(own: F64) -> tuple[F64, F64]:
        values, vectors = np.linalg.eigh(correlation / np.sqrt(np.outer(own, own)))
        return np.sqrt(own) * vectors[:, -1] * np.sqrt(max(values[-1] - 1, 0.0)), np.maximum(values[:-1], 1e-300)

    def misfit(own: F64) -> tuple[float, F64]:
        loading, rest = loadings(own)
        gradient = np.diag(np.outer(loading, loading) + np.diag(own) - correlation) / own**2
        return float((rest - np.log(rest)).sum() - len(rest)), gradient

    try:
        begin = 0.5 / np.diag(np.linalg.inv(correlation))
    except np.linalg.LinAlgError:
        return None, True
    begin = np.clip(np.where(np.isfinite(begin), begin, 0.5), SMALLEST, 1.0)
    options = {"ftol": 1e-14, "gtol": 1e-9, "maxiter": 1000}
    found = minimize(misfit, begin, jac=True, method="L-BFGS-B", bounds=[(SMALLEST, 1.0)] * len(begin), options=options)
    common = float((loadings(found.x)[0] * deviations).sum() ** 2)
    whole = common + float((found.x * deviations**2).sum())
    return common / whole, bool((found.x <= SMALLEST * (1 + 1e-6)).any())
