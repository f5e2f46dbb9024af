"""Two hundred made-up studies, the same on every machine: 2 to 4 factors within and between, ties, imbalance, gaps.

Only ``random.Random.random`` is drawn from, which Python keeps as it is; what R says of them lies beside the tests.
"""

from __future__ import annotations

import itertools
import math
import random
from dataclasses import dataclass

from glsplat.extras.study.analysis.table import Table, make_table

__all__ = ["COUNT", "Design", "design"]

COUNT = 200
KINDS = ("likert5", "likert7", "normal", "skewed", "coarse")


@dataclass(frozen=True)
class Design:
    """Rows of participant, levels and answer (None: not answered), and what is special about them."""

    number: int
    factors: dict[str, tuple[str, ...]]
    rows: list[tuple[str, tuple[str, ...], float | None]]
    kind: str
    between: tuple[str, ...]

    def table(self) -> Table:
        return make_table("y", self.factors, [row for row in self.rows if row[2] is not None])  # type: ignore[misc]


def design(number: int) -> Design:
    """The study of this number, from 0 to COUNT - 1."""
    draw = random.Random(4100 + number)

    def pick(options: tuple[int, ...]) -> int:
        return options[int(draw.random() * len(options))]

    def normal() -> float:
        return math.sqrt(-2 * math.log(1 - draw.random())) * math.cos(2 * math.pi * draw.random())

    count = 2 + number % 3
    shape = [pick((2, 3, 4) if count == 2 else (2, 2, 3)) if place < 3 else 2 for place in range(count)]
    within = [draw.random() < 0.65 for _ in shape]
    letters = "ABCD"[:count]
    factors = {
        letter: tuple(f"{letter.lower()}{i + 1}" for i in range(n)) for letter, n in zip(letters, shape, strict=True)
    }
    groups = math.prod(n for n, inside in zip(shape, within, strict=True) if not inside)
    each = pick((3, 4, 6)) if groups > 2 else pick((5, 7, 9))
    unequal, gaps = draw.random() < 0.3, draw.random() < 0.35
    kind = KINDS[number // 3 % len(KINDS)]
    spread = pick((0, 1, 1, 2)) * 0.7
    effect = {cell: 0.5 * normal() for cell in itertools.product(*factors.values())}
    outside = [names for names, inside in zip(factors.values(), within, strict=True) if not inside]
    inner = [names for names, inside in zip(factors.values(), within, strict=True) if inside]
    rows: list[tuple[str, tuple[str, ...], float | None]] = []
    person = 0
    for group in itertools.product(*outside):
        for _ in range(each + (pick((-1, 0, 1, 2)) if unequal else 0)):
            person += 1
            own = spread * normal()
            for inside in itertools.product(*inner):
                places = {True: iter(inside), False: iter(group)}
                cell = tuple(next(places[inside_too]) for inside_too in within)
                value = _answer(kind, effect[cell] + own + normal())
                rows.append((f"P{person:02}", cell, None if gaps and inner and draw.random() < 0.08 else value))
    between = tuple(letter for letter, inside in zip(letters, within, strict=True) if not inside)
    return Design(number, factors, rows, kind, between)


def _answer(kind: str, value: float) -> float:
    if kind == "likert5":
        return float(min(5, max(1, round(3 + value))))
    if kind == "likert7":
        return float(min(7, max(1, round(4 + 1.3 * value))))
    if kind == "skewed":
        return round(1000 * math.exp(0.6 * value), 3)
    return round(value, 1 if kind == "coarse" else 6)
