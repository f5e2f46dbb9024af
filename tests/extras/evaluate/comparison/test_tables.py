"""Tables against means and deviations that NumPy takes of the same figures."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest

from glsplat.extras.evaluate.comparison import tables
from glsplat.extras.evaluate.comparison.measure import MEASURES, OVERLAP, PARTED
from glsplat.extras.evaluate.comparison.protocol import CONTROLS
from glsplat.extras.evaluate.comparison.stage import PARTS
from glsplat.extras.evaluate.comparison.work import Result

PEOPLE, METHODS = ("p01", "p02", "p03"), ("first", "second")
TASKS, VIEWS = ("standing", "turning"), ("front", "left")
MEASURED = (*MEASURES, OVERLAP)


@pytest.fixture(scope="module")
def figures() -> np.ndarray:
    """[participant, method, control, measure, moment, view, eye]."""
    return np.random.default_rng(4).random((3, 2, 2, len(MEASURED), 2, 2, 2))


@pytest.fixture(scope="module")
def results(figures: np.ndarray) -> list[Result]:
    """Two methods of three people, of whom the last failed with the second method; nobody's hands are seen."""

    def of(rows: np.ndarray) -> dict[str, Any]:
        return {name: row.tolist() for name, row in zip(MEASURED, rows, strict=True)}

    found = []
    for person, methods in zip(PEOPLE, figures, strict=True):
        for method, controls in zip(METHODS, methods, strict=True):
            if (person, method) == ("p03", "second"):
                found.append(Result(person, method, "no idea"))
                continue
            values = {control: of(rows) for control, rows in zip(CONTROLS, controls, strict=True)}
            none = {name: [[[None] * 2] * 2] * 2 for name in PARTED}
            parts = {control: {part: values[control] for part in PARTS} | {"hands": none} for control in CONTROLS}
            data = {"product": {"count": 7}, "moments": list(TASKS), "views": list(VIEWS), "values": values}
            found.append(Result(person, method, data=data | {"parts": parts}))
    return found


def good(figures: np.ndarray, row: dict[str, Any]) -> np.ndarray:
    """[participant, measure, moment, view, eye] of the row's method and control, without what failed."""
    people = slice(0, 2 if row["method"] == "second" else 3)
    return figures[people, METHODS.index(row["method"]), CONTROLS.index(row["control"])]


def check(row: dict[str, Any], values: np.ndarray, names: tuple[str, ...] = MEASURED) -> None:
    """``values`` [participant, measure]."""
    for name, column in zip(names, values.T, strict=False):
        assert row[name]["mean"] == pytest.approx(column.mean(), abs=1e-5)
        assert row[name]["sd"] == pytest.approx(column.std(ddof=1), abs=1e-5)


def test_summary(results: list[Result], figures: np.ndarray) -> None:
    rows = tables.summary(results, METHODS, 3)
    assert [(row["method"], row["n"], row["of"]) for row in rows[:2]] == [("first", 3, 3), ("second", 2, 3)]
    for row in rows:
        check(row, good(figures, row).mean(axis=(2, 3, 4)))
    assert tables.failures(results) == [{"participant": "p03", "method": "second", "why": "no idea"}]


def test_by_participant(results: list[Result], figures: np.ndarray) -> None:
    *rows, last = tables.by_participant(results[::-1], METHODS)
    assert last == {"participant": "p03", "method": "second", "failed": "no idea"}
    for row, control in itertools.product(rows, CONTROLS):
        person = PEOPLE.index(row["participant"])
        wanted = good(figures, row | {"control": control})[person].mean(axis=(1, 2, 3))
        assert list(row[control].values()) == pytest.approx(wanted[: len(row[control])], abs=1e-5)


@pytest.mark.parametrize(("key", "labels", "axes"), [("moment", TASKS, (3, 4)), ("view", VIEWS, (2, 4))])
def test_along_an_axis(
    results: list[Result], figures: np.ndarray, key: str, labels: tuple[str, ...], axes: tuple[int, ...]
) -> None:
    rows = tables.along(results, METHODS, key)
    assert len(rows) == len(METHODS) * len(CONTROLS) * 2
    for row in rows:
        check(row, good(figures, row).mean(axis=axes)[..., labels.index(row[key])])


def test_parts_that_are_not_seen_have_no_row(results: list[Result], figures: np.ndarray) -> None:
    rows = tables.along(results, METHODS, "part")
    assert {row["part"] for row in rows} == set(PARTS) - {"hands"}
    for row in rows:
        columns = [MEASURED.index(name) for name in PARTED]
        check(row, good(figures, row).mean(axis=(2, 3, 4))[:, columns], PARTED)


def test_methods_are_compared_on_common_participants(results: list[Result], figures: np.ndarray) -> None:
    (row,) = [
        row for row in tables.compared(results, METHODS, 0) if (row["control"], row["measure"]) == ("pose", "ssim")
    ]
    away = (figures[:2, 0] - figures[:2, 1])[:, CONTROLS.index("pose"), MEASURED.index("ssim")].mean()
    assert row["n"] == 2 and row["missing"] == ["p03"] and row["mean"] == pytest.approx(away, abs=1e-5)
