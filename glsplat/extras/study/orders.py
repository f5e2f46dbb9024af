"""Orders of conditions for each participant: balanced Latin squares, blocked, random or fixed.

Williams (1949), Australian Journal of Scientific Research A 2, 149-168: each condition occurs once per row, equally
often in each position and equally often after each other one. An even number k needs k rows, an odd one 2k.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np

from glsplat.extras.study.design import Study


def williams(count: int) -> list[list[int]]:
    """Return rows of the numbers 0 to count - 1, balanced for position and predecessor.

    >>> glsplat.extras.study.orders.williams(4)
    [[0, 3, 1, 2], [1, 0, 2, 3], [2, 1, 3, 0], [3, 2, 0, 1]]
    """
    first = [0]
    for step in range(1, count):
        first.append((first[-1] + step * (-1 if step % 2 else 1)) % count)
    rows = [[(number + row) % count for number in first] for row in range(count)]
    return rows if count % 2 == 0 or count == 1 else rows + [row[::-1] for row in rows]


def orders_of(study: Study) -> list[tuple[str, ...]]:
    """Return the condition names in order, for each participant. Deterministic for a study.

    Balanced within each group of participants if their number permits, else over all of them.
    """
    rng = np.random.default_rng([study.seed, 1])
    blocks = _blocks(study)
    rows = _rows(study, blocks)
    out: list[tuple[str, ...]] = []
    names = [_shuffled(rng, block) if study.order.scheme == "williams" else block for block in blocks]
    groups = [tuple(group.values()) for group in groups_of(study)]
    by_group = study.participants % (len(rows) * len(set(groups))) == 0
    decks: dict[tuple[str, ...], list[int]] = {}  # rows that a group has left in this round
    for group in groups:
        if study.order.scheme == "random":
            shown = [names[number] for number in rng.permutation(len(names))]
            out.append(tuple(name for block in shown for name in _shuffled(rng, block)))
            continue
        deck = decks.setdefault(group if by_group else (), [])
        if not deck:
            deck += rng.permutation(len(rows)).tolist() if study.order.scheme == "williams" else range(len(rows))
        out.append(tuple(names[block][place] for block, place in rows[deck.pop(0)]))
    return out


def groups_of(study: Study) -> list[dict[str, str]]:
    """Return the between-subject levels of each participant: equally many of each, in random order."""
    factors = [factor for factor in study.factors if factor.between]
    cells = list(product(*(factor.levels for factor in factors)))
    rng = np.random.default_rng([study.seed, 2])
    out: list[dict[str, str]] = []
    while len(out) < study.participants:
        for number in rng.permutation(len(cells)):
            out.append({factor.name: level for factor, level in zip(factors, cells[number], strict=True)})
    return out[: study.participants]


def cycle(study: Study) -> int:
    """Return the number of participants after which orders are balanced; 1 for random and fixed orders."""
    return len(_rows(study, _blocks(study))) if study.order.scheme == "williams" else 1


def _blocks(study: Study) -> list[list[str]]:
    """Return the conditions by block."""
    block = study.order.block
    if not block:
        return [[one.name for one in study.conditions]]
    levels = next(factor.levels for factor in study.factors if factor.name == block)
    found = [[one.name for one in study.conditions if one.levels[block] == level] for level in levels]
    return [names for names in found if names]


def _rows(study: Study, blocks: list[list[str]]) -> list[list[tuple[int, int]]]:
    """Return orders as (block, number in block). Each order of blocks is combined with all rows within blocks."""
    if study.order.scheme != "williams":
        return [[(block, place) for block, names in enumerate(blocks) for place in range(len(names))]]
    inner = [williams(len(names)) for names in blocks]
    turns = int(np.lcm.reduce([len(rows) for rows in inner]))
    return [
        [(block, place) for at, block in enumerate(outer) for place in inner[block][(turn + at) % len(inner[block])]]
        for outer in williams(len(blocks))
        for turn in range(turns)
    ]


def _shuffled(rng: np.random.Generator, names: Sequence[str]) -> list[str]:
    return [names[number] for number in rng.permutation(len(names))]
