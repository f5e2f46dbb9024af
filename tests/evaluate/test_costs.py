"""Costs of avatars of different kinds side by side."""

from __future__ import annotations

import pytest

from glsplat.data import default_avatar
from glsplat.evaluate.frames import WARM_UP
from glsplat.evaluate.sections.batching import PAPER
from glsplat.evaluate.sections.costs import costs
from glsplat.gl.context import Context
from tests.net.legacy.test_legacy import thinned
from tests.scene.people import boxes

pytestmark = pytest.mark.gl


def test_rows(context: Context) -> None:
    """A row an avatar and size, of what each holds; interleaved, and nothing is left on the context."""
    told: list[int] = []
    figures = {"splats": thinned(default_avatar(), 100), "mesh": boxes()}
    with context:
        rows = costs(context, figures, sizes=(32, 48), frames=3, tick=told.append)
    assert [(row.name, row.size) for row in rows] == [("splats", 32), ("mesh", 32), ("splats", 48), ("mesh", 48)]
    assert sum(told) == 2 * 2 * (WARM_UP + 3)
    for row in rows:
        figure = figures[row.name]
        expected = ("triangles", len(figure.faces)) if row.name == "mesh" else ("splats", len(figure.splats))
        assert (row.kind, row.count) == expected and row.nbytes > 1000
        assert 0 < row.pair.median <= row.pair.p95 and row.two.median > 0 and row.in_turn.median > 0
        assert row.gain == pytest.approx(row.two.median / row.pair.median, abs=1e-3)
        assert row.row()["pair_ms"] == row.pair.median and "paper" not in row.row()
    by_size = {(row.name, row.size): row for row in rows}
    assert by_size["mesh", 48].nbytes > by_size["mesh", 32].nbytes  # its targets grow, a splat's records do not


def test_the_papers_row(context: Context) -> None:
    with context:
        (row,) = costs(context, {"mesh": boxes()}, sizes=(512,), frames=1)
    assert row.row()["paper"]["pair_ms"] == PAPER[512][0] and costs(context, {}) == []
