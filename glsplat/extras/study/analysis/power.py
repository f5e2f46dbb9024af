"""Power by simulation: how often a planned study finds an effect that exists, and one that does not.

>>> plan = Planned({"type": ("self", "other"), "method": ("ours", "video", "image")}, participants=24)
>>> [round(row.power, 2) for row in power(plan.draws({"type": (0.4,)}), plan.table, runs=1000)]
[0.88, 0.04, 0.04]
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.stats import binomtest

from glsplat.arrays import F64
from glsplat.errors import FormatError
from glsplat.extras.statistics.nonparametric import LEVEL

from .anova import choose, name_of, ranked, spread_ranks
from .repeated import f_tests, split
from .table import Effect, Table, effects_of, hypothesis, make_table

Draws = Callable[[np.random.Generator, int], F64]
"""Draws the answers [runs, N] of ``runs`` studies, on the rows of the planned table."""

CHUNK = 100  # studies drawn at once
MOST_ROWS = 20_000


@dataclass(frozen=True)
class Power:
    """Number of simulated studies with p below alpha, and the 95 % interval of their share (Clopper-Pearson)."""

    effect: str
    runs: int
    found: int
    low: float
    high: float

    @property
    def power(self) -> float:
        """Share of studies with p below alpha."""
        return self.found / self.runs


@dataclass(frozen=True)
class Planned:
    """A planned study: factors with levels, those ``between`` participants, and the total of participants.

    ``correlation``: of two answers of one participant. ``points``: of a rating scale, whose middle is the mean and
    whose step is 4 / (points - 1) standard deviations; None for a continuous scale. Raises FormatError.
    """

    factors: Mapping[str, Sequence[str]]
    participants: int
    between: frozenset[str] = field(default_factory=frozenset)
    correlation: float = 0.5
    points: int | None = None

    def __post_init__(self) -> None:
        if unknown := self.between - set(self.factors):
            raise FormatError(f"no factor is named {min(unknown)!r}; there are {', '.join(self.factors)}")
        if not 0 <= self.correlation < 1:
            raise FormatError(f"the correlation needs 0 or more and less than 1, not {self.correlation:g}")
        if self.points is not None and not 2 <= self.points <= 1000:
            raise FormatError(f"a scale needs 2 to 1000 points, not {self.points}")
        groups = int(np.prod([len(self.factors[name]) for name in self.between]))
        if self.participants < max(2 * groups, 2):
            raise FormatError(
                f"{groups} groups need {max(2 * groups, 2)} participants or more, not {self.participants}"
            )
        conditions = int(np.prod([len(levels) for name, levels in self.factors.items() if name not in self.between]))
        if (answers := self.participants * conditions) > MOST_ROWS:
            raise FormatError(f"a simulation takes at most {MOST_ROWS} answers a study, not {answers}")

    @cached_property
    def table(self) -> Table:
        """The study's table with all answers 0; participants are assigned to groups in turn."""
        groups = list(itertools.product(*(self.factors[name] for name in self.factors if name in self.between)))
        rows: list[tuple[str, Sequence[str], float]] = []
        for number in range(self.participants):
            own = dict(zip((n for n in self.factors if n in self.between), groups[number % len(groups)], strict=True))
            levels = [(own[name],) if name in own else tuple(self.factors[name]) for name in self.factors]
            rows += [(f"P{number + 1:05}", cell, 0.0) for cell in itertools.product(*levels)]
        return make_table("answer", self.factors, rows)

    def means(self, effects: Mapping[str, Sequence[float]]) -> F64:
        """Return the mean of each condition in standard deviations of an answer, [levels of each factor].

        Each effect ("type", "type:method") has one number, the largest difference between its conditions, or one
        number per condition. One number spaces levels evenly; interactions are products of such steps. Lower effects
        are removed from an interaction's numbers. Raises FormatError.
        """
        names = list(self.factors)
        shape = [len(self.factors[name]) for name in names]
        total = np.zeros(shape)
        for text, numbers in effects.items():
            parts = [part.strip() for part in text.split(":")]
            if not set(parts) <= set(names) or len(set(parts)) < len(parts):
                raise FormatError(f"effect {text!r}: expected factors with : between them, of {', '.join(names)}")
            if not np.isfinite(numbers).all():
                raise FormatError(f"effect {text!r}: expected finite numbers, in standard deviations")
            own = [names.index(part) for part in parts]
            order = tuple(sorted(own))
            part_shape = [shape[i] for i in own]
            if len(numbers) == 1:
                pattern = _steps(part_shape) * numbers[0]
            elif len(numbers) == np.prod(part_shape):
                pattern = _pure(np.array(numbers, float).reshape(part_shape))
            else:
                raise FormatError(
                    f"effect {text!r}: expected one number or {np.prod(part_shape)}, one a condition; got "
                    f"{len(numbers)}"
                )
            turned = pattern.transpose([own.index(i) for i in order])
            total += turned.reshape([n if i in order else 1 for i, n in enumerate(shape)])
        return total

    def draws(self, effects: Mapping[str, Sequence[float]]) -> Draws:
        """Return a function that draws normal answers with these effects, rounded to ``points`` if set."""
        table = self.table
        means = self.means(effects).ravel()[table.cell]

        def drawn(rng: np.random.Generator, runs: int) -> F64:
            own = rng.standard_normal((runs, len(table.names)))[:, table.participant]
            noise = rng.standard_normal((runs, len(table.cell)))
            answers = means + np.sqrt(self.correlation) * own + np.sqrt(1 - self.correlation) * noise
            if self.points is None:
                return answers
            middle, step = (self.points + 1) / 2, (self.points - 1) / 4
            return np.clip(np.rint(middle + step * answers), 1, self.points)

        return drawn


def from_pilot(pilot: Table, participants: int) -> tuple[Draws, Table]:
    """Return draws of ``participants`` from a pilot's complete ones, with replacement within groups, and their table.

    The draws have the pilot's effects, which may be chance in a small pilot. Raises FormatError.
    """
    model = choose(pilot, "rm")
    parts = split(model.table, model.table.values)
    factors = {factor.name: factor.levels for factor in pilot.factors}
    between = frozenset(factor.name for factor in pilot.factors if not factor.within)
    table = Planned(factors, participants, between).table
    place = table.combination(table.within)
    members = [np.flatnonzero(parts.group == group) for group in range(len(parts.sizes))]

    def drawn(rng: np.random.Generator, runs: int) -> F64:
        chosen = np.empty((runs, participants), np.intp)
        for group, own in enumerate(members):
            where = np.flatnonzero(table.group == group)
            chosen[:, where] = rng.choice(own, (runs, len(where)))
        return parts.values[chosen[:, table.participant], place]

    return drawn, table


def power(
    draws: Draws,
    table: Table,
    *,
    runs: int = 1000,
    alpha: float = 0.05,
    seed: int = 0,
    step: float | None = None,
    progress: Callable[[int], object] = lambda done: None,
) -> list[Power]:
    """Return the power of each effect, by the aligned rank transform and repeated-measures F tests on ``runs`` studies.

    ``step`` of the scale: spread ties (:func:`~glsplat.extras.study.analysis.anova.spread_ranks`). ``progress`` gets
    the number of studies finished since its last call. The same seed gives the same result. Raises FormatError.
    """
    if runs < 1 or not 0 < alpha < 1:
        raise FormatError(f"power needs at least one run and an alpha between 0 and 1, not {runs} and {alpha:g}")
    rng = np.random.default_rng(seed)
    effects = effects_of(len(table.factors))
    found: dict[Effect, int] = dict.fromkeys(effects, 0)
    chunk = max(1, min(CHUNK, 2_000_000 // len(table.cell)))
    for begin in range(0, runs, chunk):
        answers = draws(rng, min(chunk, runs - begin))
        for effect in effects:
            ranks = ranked(table, effect, answers) if step is None else spread_ranks(table, effect, step, answers)
            p = f_tests(table, effect, ranks)[3]
            found[effect] += int((p < alpha).sum())  # NaN (nothing varies) counts as not found
        progress(len(answers))
    intervals = {effect: binomtest(k, runs).proportion_ci(LEVEL, "exact") for effect, k in found.items()}
    return [Power(name_of(table, effect), runs, k, *map(float, intervals[effect])) for effect, k in found.items()]


def _steps(shape: Sequence[int]) -> F64:
    """Return the product of evenly spaced steps along every axis, scaled to a largest difference of 1."""
    out = np.ones(1)
    for n in shape:
        out = np.multiply.outer(out, np.linspace(-1, 1, n))
    return out[0] / np.ptp(out)


def _pure(pattern: F64) -> F64:
    """Return ``pattern`` without lower effects: its means over any of its factors are 0."""
    L = hypothesis(pattern.shape, tuple(range(pattern.ndim)))
    return (L.T @ (L @ pattern.ravel())).reshape(pattern.shape)
