"""Balanced Latin squares, counted; plans that stay."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import pytest

from glsplat.errors import FormatError
from glsplat.extras.study import plan as plan_module
from glsplat.extras.study.design import read_study
from glsplat.extras.study.plan import (
    PLAN,
    checked_plan,
    cycle,
    groups_of,
    label,
    make_plan,
    orders_of,
    read_plan,
    williams,
    write_plan,
)
from tests.extras.study.designs import SMALL, planned, write


def positions(orders: Sequence[Sequence[str]]) -> dict[str, list[int]]:
    """Return how often each condition occurs in each position."""
    names = sorted({name for order in orders for name in order})
    return {name: [sum(order[at] == name for order in orders) for at in range(len(orders[0]))] for name in names}


def carryover(orders: Sequence[Sequence[str]]) -> dict[tuple[str, str], int]:
    """Return how often each pair of conditions occurs in succession."""
    names = sorted({name for order in orders for name in order})
    counts = {(a, b): 0 for a in names for b in names if a != b}
    for order in orders:
        for pair in pairwise(order):
            counts[pair] += 1
    return counts


def test_williams_is_balanced() -> None:
    """Every row a permutation; each number as often in each place, and after each other one."""
    for count in range(1, 14):
        rows = williams(count)
        assert len(rows) == (count if count % 2 == 0 or count == 1 else 2 * count)
        assert all(sorted(row) == list(range(count)) for row in rows)
        places = Counter((at, number) for row in rows for at, number in enumerate(row))
        assert len(set(places.values())) == 1 and len(places) == count**2
        follow = Counter(pair for row in rows for pair in pairwise(row))
        assert len(set(follow.values())) <= 1 and len(follow) == count * (count - 1)


def design(tmp_path: Path, levels: tuple[int, ...], participants: int, order: str, seed: int = 1) -> Path:
    names = "abcdefg"
    factors = [f"f{at} = {[names[n] for n in range(count)]}" for at, count in enumerate(levels)]
    cells = [[]]
    for count in levels:
        cells = [[*cell, names[n]] for cell in cells for n in range(count)]
    conditions = "".join(
        f'[[condition]]\nname = "{"-".join(cell)}"\n' + "".join(f'f{at} = "{one}"\n' for at, one in enumerate(cell))
        for cell in cells
    )
    head = f'name = "x"\ntitle = "x"\nparticipants = {participants}\nseed = {seed}\nconsent = "x"\n'
    asked = '[questionnaires]\neach = ["movement"]\n'
    return write(tmp_path, "\n".join([head, "[factors]", *factors, "[order]", order, conditions, asked]))


@pytest.mark.parametrize(("levels", "rows"), [((4,), 4), ((5,), 10), ((2, 2), 4), ((3,), 6)])
def test_whole_cycles_are_balanced(tmp_path: Path, levels: tuple[int, ...], rows: int) -> None:
    study = read_study(design(tmp_path, levels, 3 * rows, 'scheme = "williams"', seed=9))
    orders = orders_of(study)
    assert cycle(study) == rows
    assert len({count for counts in positions(orders).values() for count in counts}) == 1
    assert len(set(carryover(orders).values())) == 1
    assert [set(orders[n : n + rows]) for n in (0, rows)] == [set(orders[:rows])] * 2  # each cycle has every row once


def test_blocks_stay_together_and_are_balanced(tmp_path: Path) -> None:
    study = read_study(design(tmp_path, (2, 3), 24, 'block = "f0"'))
    orders = orders_of(study)
    assert cycle(study) == 12
    for order in orders:
        assert len({name[0] for name in order[:3]}) == len({name[0] for name in order[3:]}) == 1
    assert sum(order[0][0] == "a" for order in orders) == 12
    assert {count for counts in positions(orders).values() for count in counts} == {4}
    within = [count for (one, other), count in carryover(orders).items() if one[0] == other[0]]
    assert set(within) == {8}


def test_chance_is_the_seeds(tmp_path: Path) -> None:
    def orders(seed: int) -> list[tuple[str, ...]]:
        return orders_of(read_study(design(tmp_path, (2, 2), 200, 'scheme = "random"', seed)))

    one = orders(1)
    assert one == orders(1) != orders(2)
    assert all(30 < count < 70 for counts in positions(one).values() for count in counts)  # 50 expected, +- 3.2 s.d.
    fixed = orders_of(read_study(design(tmp_path, (3,), 4, 'scheme = "fixed"')))
    assert fixed == [("a", "b", "c")] * 4


def test_levels_between_are_dealt_evenly(tmp_path: Path) -> None:
    study = read_study(write(tmp_path, SMALL.replace("participants = 6", "participants = 40")))
    groups = groups_of(study)
    assert Counter(group["group"] for group in groups) == {"old": 20, "young": 20}
    assert all({a["group"], b["group"]} == {"old", "young"} for a, b in zip(groups[::2], groups[1::2], strict=True))
    assert groups[0] != groups[1] and groups == groups_of(study)


def test_a_plan_stays(tmp_path: Path) -> None:
    study, plan = planned(tmp_path)
    path = write_plan(tmp_path / "data", plan)
    before = path.read_bytes()
    with pytest.raises(FormatError, match="stays"):
        write_plan(tmp_path / "data", make_plan(study))
    assert path.read_bytes() == before and [p.name for p in path.parent.iterdir()] == [PLAN]
    assert read_plan(tmp_path / "data") == plan == checked_plan(tmp_path / "data", study)
    people = json.loads(before)["participants"]
    assert list(people) == [label(n) for n in range(1, 7)]


def test_no_plan_is_written_that_would_not_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _, plan = planned(tmp_path)
    size = write_plan(tmp_path / "data", plan).stat().st_size
    monkeypatch.setattr(plan_module, "MAX_PLAN_BYTES", size - 1)
    with pytest.raises(FormatError, match="a plan has at most"):
        write_plan(tmp_path / "other", plan)
    assert not (tmp_path / "other").exists()
    monkeypatch.setattr(plan_module, "MAX_PLAN_BYTES", size)
    write_plan(tmp_path / "other", plan)
    assert read_plan(tmp_path / "other") == plan


def test_a_changed_design_is_refused(tmp_path: Path) -> None:
    _, plan = planned(tmp_path)
    write_plan(tmp_path / "data", plan)
    for before, after, where in (
        ("latency = 150", "latency = 1", "conditions 2.latency"),
        ('"Wave."', '"Wave, please."', "tasks 1.text"),
        ("seed = 5", "seed = 6", "seed"),
        ("rest_s = 2", "rest_s = 3", "rest"),
    ):
        with pytest.raises(FormatError, match=where):
            checked_plan(tmp_path / "data", read_study(write(tmp_path, SMALL.replace(before, after))))


def test_no_plan(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="no plan yet"):
        read_plan(tmp_path)
    for data in (b"", b"{}", b"[]", b'{"version": 1, "participants": {"sub-002": {}}}', b"\xff", b"[" * 10**5):
        (tmp_path / PLAN).write_bytes(data)
        with pytest.raises(FormatError, match="not a plan"):
            read_plan(tmp_path)


def test_no_plan_without_texts(tmp_path: Path) -> None:
    study = read_study(write(tmp_path, SMALL.replace('["movement"]', '["veq"]')))
    with pytest.raises(FormatError, match=r"12 items have no text yet, the first is veq.vbo1"):
        make_plan(study)
    texts = "[text.veq]\n" + "".join(f'{item.partition(".")[2]} = "x"\n' for item in study.items_without_text)
    assert make_plan(read_study(write(tmp_path, SMALL.replace('["movement"]', '["veq"]') + texts)))
