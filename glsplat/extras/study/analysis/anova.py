"""Choose a table's model; compute F tests and contrasts on aligned ranks."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import numpy as np
from scipy.special import stdtr

from glsplat.arrays import F64
from glsplat.errors import FormatError
from glsplat.extras.statistics.holm import holm

from . import align, mixed, repeated
from .effects import Effect, effects_of
from .repeated import FTest
from .table import Table

ModelName = Literal["auto", "rm", "mixed"]


@dataclass(frozen=True, eq=False)
class Model:
    """A table and its model: ``kind`` is rm (repeated-measures ANOVA) or mixed (random intercepts, REML)."""

    table: Table
    kind: Literal["rm", "mixed"]
    left_out: tuple[str, ...] = ()
    """Participants who lack a condition, left out by rm (listwise)."""


@dataclass(frozen=True)
class Contrast:
    """The difference of two conditions of an effect in aligned ranks (ART-C), two-sided t test."""

    effect: str
    first: str
    second: str
    estimate: float
    se: float
    df: float
    t: float
    p: float
    p_holm: float
    """Corrected for all pairs of this effect."""


def choose(table: Table, kind: ModelName = "auto") -> Model:
    """Return the model of a table. ``auto``: rm for a balanced design, else mixed, which uses all answers.

    ``auto`` is also rm, an ordinary ANOVA, for one answer per participant and groups of any size. ``rm`` leaves out
    participants who lack a condition. Raises FormatError if too few remain.
    """
    if kind == "auto":
        single = not table.within and bool((table.answers == 1).all())
        kind = "rm" if single or table.balanced else "mixed"
    if kind == "mixed":
        return Model(table, "mixed")
    gone = table.incomplete
    kept = [name for name in table.names if name not in gone]
    if len(kept) < 2:
        raise FormatError(
            f"expected two participants or more with every condition, found {len(kept)} of {len(table.names)}; "
            "a mixed model accepts participants with gaps"
        )
    model = Model(table.of(kept) if gone else table, "rm", gone)
    if [f.within for f in model.table.factors] != [f.within for f in table.factors]:
        raise FormatError("without the incomplete participants a within factor is lost; use a mixed model")
    groups = int(np.prod([model.table.shape[i] for i in model.table.between]))
    if len(kept) <= groups:
        raise FormatError(f"expected more participants than groups, found {len(kept)} in {groups}")
    return model


def art(model: Model) -> list[FTest]:
    """Return an F test for every main effect and interaction, each on its own aligned ranks."""
    return [_test(model, effect, align.ranked(model.table, effect)) for effect in effects_of(len(model.table.factors))]


def art_spread(model: Model) -> list[FTest] | None:
    """Return the F tests of :func:`art` on ranks with ties spread; None unless the scale is coarse."""
    step = align.step_of(model.table.values)
    if step is None:
        return None
    effects = effects_of(len(model.table.factors))
    return [_test(model, effect, align.spread_ranks(model.table, effect, step)) for effect in effects]


def stray(model: Model) -> float:
    """Return the largest F of another effect on answers aligned for one effect; 0 if alignment removes them all.

    ARTool's summary prints it. It is above 0 in unbalanced designs; the larger it is, the less exact is ART.
    """
    table, worst = model.table, 0.0
    effects = effects_of(len(table.factors))
    for effect in effects:
        rows = align.aligned(table, effect)
        if np.ptp(rows) == 0:
            continue
        rows = rows / np.abs(rows).max()  # F is scale-free; avoid overflow
        fitted = mixed.fit(table, rows) if model.kind == "mixed" else None
        others = [other for other in effects if other != effect]
        found = (
            [mixed.test(table, other, fitted) for other in others]
            if model.kind == "mixed"
            else [_test(model, other, rows) for other in others]
        )
        worst = max([worst, *(test.f for test in found if np.isfinite(test.f))])
    return worst if worst > 1e-9 else 0.0


def art_contrasts(model: Model, effect: Effect) -> list[Contrast]:
    """Return ART-C contrasts of all pairs of the effect's conditions, corrected by Holm; [] if nothing varies."""
    table = model.table
    rows = align.ranked_for_contrasts(table, effect)
    names = conditions(table, effect)
    pairs = list(combinations(range(len(names)), 2))
    weights = np.zeros((len(pairs), len(names)))
    for row, (first, second) in zip(weights, pairs, strict=True):
        row[first], row[second] = 1, -1
    if model.kind == "rm":
        estimate, se, df = repeated.contrast_rows(table, effect, rows, weights)
    else:
        fitted = mixed.fit(table, rows)
        if fitted is None:
            return []
        estimate, se, df = mixed.contrasts(table, effect, fitted, weights)
    if not (se > 1e-9 * len(rows)).all():
        return []
    t = estimate / se
    p = 2 * stdtr(df, -np.abs(t))
    name = name_of(table, effect)
    return [
        Contrast(
            name, names[a], names[b], float(estimate[i]), float(se[i]), float(df[i]), float(t[i]), float(p[i]), adjusted
        )
        for i, ((a, b), adjusted) in enumerate(zip(pairs, holm(p.tolist()), strict=True))
    ]


def name_of(table: Table, effect: Iterable[int]) -> str:
    """Return the effect's name as R writes it: type:method."""
    return ":".join(table.factors[i].name for i in effect)


def conditions(table: Table, effect: Effect) -> list[str]:
    """Return the combinations of the effect's levels, such as "self, ours"; the last factor varies fastest."""
    places = np.ndindex(*(table.shape[i] for i in effect))
    return [", ".join(table.factors[i].levels[k] for i, k in zip(effect, place, strict=True)) for place in places]


def _test(model: Model, effect: Effect, rows: F64) -> FTest:
    if model.kind == "mixed":
        return mixed.test(model.table, effect, mixed.fit(model.table, rows))
    f, df1, df2, p, epsilon = repeated.f_tests(model.table, effect, rows)
    several = np.prod([model.table.shape[i] - 1 for i in effect if i in model.table.within]) > 1
    return FTest(effect, float(f), df1, df2, float(p), float(epsilon) if several and np.isfinite(epsilon) else None)
