"""F tests by repeated-measures analysis of variance: each effect against its own error stratum.

Results equal R's aov with Error(participant / (within factors)) for groups of one size, and type III sums of squares
(car's Anova on the multivariate model) for others. Every participant needs every combination of the within factors.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import helmert
from scipy.special import fdtrc

from glsplat.arrays import F64

from .table import Effect, Table, averages, hypothesis, kron

NOTHING = 1e-12  # sums of squares below this share of the total are rounding errors


@dataclass(frozen=True)
class FTest:
    """An F test. ``f`` is NaN if nothing varies, infinite if the error is 0."""

    effect: Effect
    f: float
    df1: float
    df2: float
    p: float
    epsilon: float | None = None
    """Greenhouse and Geisser's (1959) departure from sphericity; None with two levels, or in a mixed model."""

    @property
    def p_corrected(self) -> float | None:
        """p with both degrees of freedom times epsilon."""
        if self.epsilon is None or not self.f >= 0:
            return None
        return float(fdtrc(self.epsilon * self.df1, self.epsilon * self.df2, self.f))


@dataclass(frozen=True, eq=False)
class Split:
    """Means [..., P, K] of each participant in each combination of the within factors, and the groups [P]."""

    values: F64
    group: NDArray[np.intp]
    sizes: F64
    within_shape: tuple[int, ...]
    between_shape: tuple[int, ...]

    @property
    def df(self) -> int:
        """Degrees of freedom between participants within groups."""
        return len(self.group) - len(self.sizes)

    def means(self, scores: F64) -> F64:
        """Return means over the participants of each group: [..., P, d] to [..., G, d]."""
        member = np.eye(len(self.sizes))[self.group]
        return (member / self.sizes).T @ scores


def split(table: Table, rows: F64) -> Split:
    """Return rows [..., N] of a table as [..., P, K]; several answers to one combination are averaged."""
    shape = tuple(table.shape[i] for i in table.within)
    count = math.prod(shape)
    target = table.participant * count + table.combination(table.within)
    sums = np.zeros((*rows.shape[:-1], len(table.names) * count))
    if len(np.unique(target)) == len(target):
        sums[..., target] = rows
    else:
        np.add.at(np.moveaxis(sums, -1, 0), target, np.moveaxis(rows, -1, 0))
    values = sums.reshape(*rows.shape[:-1], len(table.names), count) / table.answers
    between = tuple(table.shape[i] for i in table.between)
    sizes = np.bincount(table.group, minlength=math.prod(between)).astype(float)
    return Split(values, table.group, sizes, shape, between)


def f_tests(table: Table, effect: Effect, rows: F64) -> tuple[F64, int, int, F64, F64]:
    """Return F, its two degrees of freedom, p and epsilon of one effect on rows [..., N]; arrays are [...].

    The scores of each participant on orthonormal contrasts of the within part are tested by the between part
    (Maxwell and Delaney 2004, chapters 12 and 14). The table needs more participants than groups.
    """
    parts = split(table, rows)
    own = _own_contrasts(table, effect)
    scores = parts.values @ own.T
    means = parts.means(scores)
    between = tuple(table.between.index(i) for i in effect if i in table.between)
    L = hypothesis(parts.between_shape, between)
    found = L @ means
    middle = np.linalg.inv((L / parts.sizes) @ L.T)
    explained = np.einsum("...ad,ab,...bd->...", found, middle, found)
    left = scores - means[..., parts.group, :]
    error = (left**2).sum(axis=(-1, -2))
    df1, df2 = len(L) * len(own), parts.df * len(own)
    total = ((rows - rows.mean(axis=-1, keepdims=True)) ** 2).sum(axis=-1)
    rounding = NOTHING * total + NOTHING**2 * (rows**2).sum(axis=-1)
    explained, error = (np.where(part <= rounding, 0.0, part) for part in (explained, error))
    with np.errstate(divide="ignore", invalid="ignore"):
        f = (explained / df1) / (error / df2)
        spread = np.swapaxes(left, -1, -2) @ left
        epsilon = np.trace(spread, axis1=-2, axis2=-1) ** 2 / (len(own) * (spread**2).sum(axis=(-1, -2)))
    return f, df1, df2, fdtrc(df1, df2, f), epsilon


def contrast_rows(table: Table, effect: Effect, rows: F64, weights: F64) -> tuple[F64, F64, F64]:
    """Return estimates, standard errors and degrees of freedom [C] of contrasts [C, cells] of marginal means.

    A contrast has a part between and a part within participants, each with its stratum's error; the degrees of
    freedom of their sum are Satterthwaite's (1946).
    """
    parts = split(table, rows)
    inside = tuple(table.within.index(i) for i in effect if i in table.within)
    scores = parts.values @ averages(parts.within_shape, inside).T  # [P, levels]
    levels = scores.shape[-1]
    means = parts.means(scores)
    left = scores - means[parts.group]
    between_error = levels * float((left.mean(axis=1) ** 2).sum()) / parts.df
    inner = left - left.mean(axis=1, keepdims=True)
    df_inner = parts.df * (levels - 1)
    inner_error = float((inner**2).sum()) / df_inner if df_inner else 0.0
    outside = tuple(table.between.index(i) for i in effect if i in table.between)
    over = averages(parts.between_shape, outside)  # [cells of the between part, G]
    # the effect's cells are in the table's order of factors; here between factors come first
    grid = np.arange(len(over) * levels).reshape(
        [table.shape[i] for i in (*(table.between[k] for k in outside), *(table.within[k] for k in inside))]
    )
    order = [i for i in effect if i in table.between] + [i for i in effect if i in table.within]
    turned = grid.transpose([order.index(i) for i in effect]).ravel()
    by_part = np.zeros_like(weights)
    by_part[:, turned] = weights
    coefficients = np.einsum("cbl,bg->cgl", by_part.reshape(len(weights), len(over), levels), over)
    estimate = np.einsum("cgl,gl->c", coefficients, means)
    level = coefficients.mean(axis=2, keepdims=True)
    outer_part = (levels * level[..., 0] ** 2 / parts.sizes).sum(axis=1) * between_error
    inner_part = (((coefficients - level) ** 2).sum(axis=2) / parts.sizes).sum(axis=1) * inner_error
    whole = outer_part + inner_part
    with np.errstate(divide="ignore", invalid="ignore"):
        share = outer_part**2 / parts.df + (inner_part**2 / df_inner if df_inner else 0.0)
        df = np.where(whole > 0, whole**2 / share, parts.df)
    return estimate, np.sqrt(whole), df


def _own_contrasts(table: Table, effect: Effect) -> F64:
    """Return orthonormal contrasts [d, K] of the effect's within factors, constant over the others."""
    shapes = [(i in effect, table.shape[i]) for i in table.within]
    rows = [helmert(n) if own else np.full((1, n), 1 / math.sqrt(n)) for own, n in shapes]
    return kron(rows)
