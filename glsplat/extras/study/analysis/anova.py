"""The aligned rank transform (ART), a table's model, and F tests and contrasts on aligned ranks.

ART removes all effects but one from the answers, then ranks them to test that effect: Wobbrock, Findlater, Gergle and
Higgins (2011), "The aligned rank transform for nonparametric factorial analyses using only ANOVA procedures"; for
contrasts Elkin, Kay, Higgins and Wobbrock (2021), "An aligned rank transform procedure for multifactor contrast tests"
(ART-C). Means weight all answers equally, as in ARTool, also in unbalanced designs.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import numpy as np
from scipy.special import stdtr

from glsplat.arrays import F64
from glsplat.errors import FormatError
from glsplat.extras.statistics.nonparametric import TIE, average_ranks, holm

from . import mixed, repeated
from .repeated import FTest
from .table import Effect, Table, effects_of

DRAWS = 25

ModelName = Literal["auto", "rm", "mixed"]


def aligned(table: Table, effect: Effect, values: F64 | None = None) -> F64:
    """Return residuals plus the estimated effect (Wobbrock et al. 2011, steps 1 to 3), [..., N].

    ``values``: other answers on the same rows, [..., N]. The estimate is the alternating sum of the means over all
    subsets of the effect's factors.
    """
    y = table.values if values is None else values
    out = y - _means(table, tuple(range(len(table.factors))), y)
    for size in range(len(effect) + 1):
        for subset in combinations(effect, size):
            out = out + (-1) ** (len(effect) - size) * _means(table, subset, y)
    return out


def ranked(table: Table, effect: Effect, values: F64 | None = None) -> F64:
    """Return the ranks of :func:`aligned` from 1, mean ranks for ties, [..., N]."""
    return average_ranks(_settled(aligned(table, effect, values), table.values if values is None else values))


def spread_ranks(table: Table, effect: Effect, step: float, values: F64 | None = None, seed: int = 0) -> F64:
    """Return aligned ranks averaged over 25 draws that spread each answer evenly over one ``step``, [..., N].

    On a coarse scale alignment splits ties along the estimated effect, and ranking enlarges the split: ART finds
    effects that do not exist (Luepsen 2017, "The aligned rank transform and discrete variables: a warning"). Spread
    answers have no ties. ARTool does not do this.
    """
    y = table.values if values is None else values
    rng = np.random.default_rng(seed)
    total = np.zeros(y.shape)
    for _ in range(DRAWS):
        total += average_ranks(aligned(table, effect, y + step * (rng.random(y.shape) - 0.5)))
    return total / DRAWS


def step_of(values: F64) -> float | None:
    """Return the smallest difference between answers [N] on a scale; None if fewer than half are tied, or all."""
    known, counts = np.unique(average_ranks(values), return_counts=True)
    if len(known) < 2 or counts[counts > 1].sum() < len(values) / 2:
        return None
    ordered = np.sort(values)
    gaps = np.diff(ordered)
    return float(gaps[gaps > TIE * np.abs(values).max()].min())


def aligned_for_contrasts(table: Table, effect: Effect, values: F64 | None = None) -> F64:
    """Return answers aligned as if the combinations of the effect's levels were one factor (ART-C), [..., N]."""
    y = table.values if values is None else values
    whole = tuple(range(len(table.factors)))
    return y - _means(table, whole, y) + _means(table, effect, y) - _means(table, (), y)


def ranked_for_contrasts(table: Table, effect: Effect) -> F64:
    """Return the ranks of :func:`aligned_for_contrasts`, [..., N]."""
    return average_ranks(_settled(aligned_for_contrasts(table, effect), table.values))


def _settled(out: F64, y: F64) -> F64:
    """Return aligned values with those within rounding error of the answers ``y`` set to 0, so that they are tied."""
    size = np.abs(y).max(axis=-1, keepdims=True, initial=0.0)
    return np.where(np.abs(out) <= 1e-12 * size, 0.0, out)


def _means(table: Table, subset: Effect, y: F64) -> F64:
    """Return each row's mean over all rows with the same levels of these factors, [..., N]."""
    place = table.combination(subset)
    member = np.zeros((len(place), int(place.max()) + 1))
    member[np.arange(len(place)), place] = 1
    return (y @ (member / np.maximum(member.sum(axis=0), 1)))[..., place]


@dataclass(frozen=True, eq=False)
class Model:
    """A table and its model: ``kind`` is rm (repeated-measures ANOVA) or mixed (random intercepts, REML)."""

    table: Table
    kind: Literal["rm", "mixed"]
    left_out: tuple[str, ...] = ()  # participants who lack a condition, left out by rm (listwise)


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
    p_holm: float  # corrected for all pairs of this effect


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
    return [_test(model, effect, ranked(model.table, effect)) for effect in effects_of(len(model.table.factors))]


def art_spread(model: Model) -> list[FTest] | None:
    """Return the F tests of :func:`art` on ranks with ties spread; None unless the scale is coarse."""
    step = step_of(model.table.values)
    if step is None:
        return None
    effects = effects_of(len(model.table.factors))
    return [_test(model, effect, spread_ranks(model.table, effect, step)) for effect in effects]


def stray(model: Model) -> float:
    """Return the largest F of another effect on answers aligned for one effect; 0 if alignment removes them all.

    ARTool's summary prints it. It is above 0 in unbalanced designs; the larger it is, the less exact is ART.
    """
    table, worst = model.table, 0.0
    effects = effects_of(len(table.factors))
    for effect in effects:
        rows = aligned(table, effect)
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
    rows = ranked_for_contrasts(table, effect)
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
