"""Comparisons of methods: a table by hand, and what is degenerate."""

from __future__ import annotations

import math
from dataclasses import asdict

import pytest

from glsplat.extras.evaluate.statistics import compare, holm, summarise


def test_a_table() -> None:
    ours = {f"p{i:02}": 30 + 0.1 * i for i in range(1, 9)}
    values = {
        "ours": ours,
        "mesh": {name: value - 1 - 0.01 * i for i, (name, value) in enumerate(ours.items())},
        "scan": {**{name: value + (-1) ** i * (i + 1) for i, (name, value) in enumerate(ours.items())}, "p09": 31.0},
    }
    values["scan"]["p01"] = math.nan
    values["mesh"]["p02"] = None
    rows = compare(values)
    assert [(row.first, row.second) for row in rows] == [("ours", "mesh"), ("ours", "scan"), ("mesh", "scan")]
    assert [row.n for row in rows] == [7, 7, 6]
    assert [row.missing for row in rows] == [("p02", "p09"), ("p01", "p09"), ("p01", "p02", "p09")]
    first = rows[0]
    assert first.mean == pytest.approx(1 + 0.01 * (0 + 2 + 3 + 4 + 5 + 6 + 7) / 7)
    assert first.median == pytest.approx(1.04)
    assert first.effect == 1 and first.p == 2 / 128 and first.low < first.mean < first.high
    # against scan the differences are 2 -3 4 -5 6 -7 8
    assert rows[1].effect == pytest.approx((1 - 2 + 3 - 4 + 5 - 6 + 7) / 28)
    assert [row.p_holm for row in rows] == pytest.approx(holm([row.p for row in rows]))
    assert compare({"ours": ours, "mesh": values["mesh"]})[0].low == first.low  # others do not move it
    assert asdict(compare(values)[0]) == asdict(first)

    summary = {row.method: row for row in summarise(values)}
    assert summary["ours"].n == 8 and summary["ours"].missing == ("p09",)
    assert summary["ours"].mean == pytest.approx(30.45)
    assert summary["ours"].deviation == pytest.approx(math.sqrt(0.06))  # of 0.1 .. 0.8: 0.01 x 42 / 7
    assert summary["scan"].n == 8 and summary["scan"].missing == ("p01",)


def test_what_is_degenerate() -> None:
    (row,) = compare({"a": {"p": 1.0}, "b": {"p": 0.5}})
    assert (row.n, row.mean, row.median, row.effect, row.p, row.p_holm) == (1, 0.5, 0.5, 1.0, 1.0, 1.0)
    assert row.low is None and row.high is None
    same = dict.fromkeys("pqr", 0.25)
    (row,) = compare({"a": same, "b": same})
    assert (row.n, row.mean, row.low, row.high, row.effect, row.p) == (3, 0, 0, 0, 0, 1)
    (row,) = compare({"a": {"p": 1.0}, "b": {"q": 1.0}})
    assert row.n == 0 and row.missing == ("p", "q")
    assert {row.mean, row.low, row.high, row.median, row.effect, row.p, row.p_holm} == {None}
    rows = compare({"a": {"p": 1.0}, "b": {"q": 1.0}, "c": {"p": 2.0, "q": math.inf}})
    assert [row.p_holm for row in rows] == [None, 1.0, None]  # an untested pair is not of the family
    (single, none) = summarise({"a": {"p": 1.0}, "b": {}})
    assert (single.n, single.mean, single.deviation, single.low) == (1, 1.0, None, None)
    assert (none.n, none.mean, none.missing) == (0, None, ("p",)) and compare({"a": same}) == [] and summarise({}) == []
