"""Analyse one response: descriptive statistics, F tests, contrasts, effect sizes, and plain nonparametric tests.

>>> result = analyse(read_table("scores.csv", ["type", "method"]))
>>> [(row.effect, round(row.f, 2)) for row in result.effects]
[('type', 66.13), ('method', 90.64), ('type:method', 7.52)]
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from glsplat.errors import FormatError
from glsplat.extras.statistics.nonparametric import LEVEL

from .anova import Contrast, Model, ModelName, art, art_contrasts, art_spread, choose, conditions, name_of, stray
from .plain import MOST_CONDITIONS, EffectSize, Omnibus, partial_eta_squared, plain_tests
from .repeated import FTest
from .table import Table, effects_of

ALPHA = 0.05


@dataclass(frozen=True)
class Cell:
    """Descriptive statistics of the answers in one condition."""

    condition: str
    n: int
    mean: float
    sd: float
    q1: float
    median: float
    q3: float


@dataclass(frozen=True)
class EffectRow:
    """The F test of one effect. ``epsilon`` and ``p_corrected`` (Greenhouse-Geisser) are set if sphericity matters."""

    effect: str
    f: float
    df1: float
    df2: float
    p: float
    epsilon: float | None
    p_corrected: float | None
    eta_squared: EffectSize  # partial eta squared
    f_spread: float | None = None
    """F and p with ties spread (:func:`~.anova.spread_ranks`), for answers on a coarse scale."""
    p_spread: float | None = None

    @property
    def clear(self) -> bool:
        """Whether p < .05, also with ties spread."""
        return self.p < ALPHA and (self.p_spread is None or self.p_spread < ALPHA)


@dataclass(frozen=True, eq=False)
class Analysis:
    """The analysis of one response. ``contrasts``: of main effects and two-way interactions, a family per effect."""

    table: Table
    model: Model
    cells: tuple[Cell, ...]
    effects: tuple[EffectRow, ...]
    contrasts: tuple[Contrast, ...]
    plain: tuple[Omnibus, ...]
    plain_left_out: tuple[str, ...]
    """Participants left out of the plain tests because an answer is missing."""
    stray_f: float
    """See :func:`~glsplat.extras.study.analysis.anova.stray`."""

    @property
    def unanswered(self) -> int:
        """Number of missing answers: empty values, and conditions without a row."""
        lost = int((self.table.answers == 0).sum())
        return max(lost, self.table.unanswered)

    def to_json(self) -> dict[str, Any]:
        """Return the analysis as JSON values; None for numbers that are not finite."""
        table, model = self.table, self.model
        whole: dict[str, Any] = {
            "response": table.response,
            "participants": len(table.names),
            "answers": len(table.values),
            "missing": self.unanswered,
            "factors": [asdict(factor) for factor in table.factors],
            "model": model.kind,
            "left_out": list(model.left_out),
            "plain_left_out": list(self.plain_left_out),
            "stray_f": self.stray_f,
            "level": LEVEL,
        }
        for name in ("cells", "effects", "contrasts", "plain"):
            whole[name] = [asdict(row) for row in getattr(self, name)]
        known: dict[str, Any] = _known(whole)
        return known


def analyse(table: Table, kind: ModelName = "auto", seed: int = 0) -> Analysis:
    """Return ART's F tests by the model ``kind``, with descriptive statistics, contrasts and plain tests.

    ``seed``: of the bootstrap intervals of Cliff's delta. Raises FormatError if the table does not suit the model.
    """
    model = choose(table, kind)
    whole = tuple(range(len(table.factors)))
    cells = []
    for place, condition in enumerate(conditions(table, whole)):
        own = table.values[table.cell == place]
        quartiles = map(float, np.quantile(own, [0.25, 0.5, 0.75]))
        sd = float(own.std(ddof=1)) if len(own) > 1 else math.nan
        cells.append(Cell(condition, len(own), float(own.mean()), sd, *quartiles))
    tests = art(model)
    spread: Sequence[FTest | None] = art_spread(model) or [None] * len(tests)
    effects = []
    for test, other in zip(tests, spread, strict=True):
        size = partial_eta_squared(test.f, test.df1, test.df2)
        tested = (test.f, test.df1, test.df2, test.p, test.epsilon, test.p_corrected)
        row = EffectRow(name_of(table, test.effect), *tested, size)
        effects.append(replace(row, f_spread=other.f, p_spread=other.p) if other else row)
    contrasts = [
        contrast
        for effect in effects_of(len(table.factors))
        if len(effect) <= 2 and len(conditions(table, effect)) <= MOST_CONDITIONS
        for contrast in art_contrasts(model, effect)
    ]
    try:
        complete = choose(table, "rm")
        plain, left_out = tuple(plain_tests(complete.table, seed)), complete.left_out
    except FormatError:  # too few complete participants
        plain, left_out = (), table.incomplete
    return Analysis(table, model, tuple(cells), tuple(effects), tuple(contrasts), plain, left_out, stray(model))


def _known(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _known(inner) for key, inner in value.items()}
    return [_known(inner) for inner in value] if isinstance(value, (list, tuple)) else value
