"""Sections of a report: costs and growth."""

from __future__ import annotations

import numpy as np
import pytest

from glsplat.data import default_avatar
from glsplat.extras.evaluate.frames import WARM_UP
from glsplat.extras.evaluate.sections import growth as report_growth
from glsplat.extras.evaluate.sections.costs import costs
from glsplat.extras.evaluate.sections.growth import Grid, fitted, growth, resampled
from glsplat.gl.context import Context
from tests.net.legacy.test_legacy import thinned
from tests.scene.people import boxes
from tests.scenes import limb

pytestmark = [pytest.mark.gl, pytest.mark.usefixtures("gl")]

pytest.importorskip("flip_evaluator")

SMALL = Grid((1024, 2048, 4096), (16, 32, 64), (1, 2), size=32, frames=2, alone=False)


def test_lines() -> None:
    line = fitted([1, 2, 3, 10], [5, 7, 9, 23])
    assert line["slope"] == pytest.approx(2) and line["constant"] == pytest.approx(3)
    assert line["largest_relative_error"] == pytest.approx(0, abs=1e-9)
    bent = fitted([1, 2, 3], [1, 2, 6])
    assert bent is not None and bent["largest_relative_error"] > 0.1
    assert fitted([1, 2], [1, 2]) is None


def test_more_and_fewer_splats_cover_the_same_area() -> None:
    avatar = limb(600)
    for count in (100, 600, 1000, 3000):
        other = resampled(avatar, count)
        assert len(other.splats) == len(other.skin) == count
        area = (other.splats.scales[:, 0] * other.splats.scales[:, 1]).sum()
        assert area == pytest.approx((avatar.splats.scales[:, 0] * avatar.splats.scales[:, 1]).sum(), rel=0.25)
        np.testing.assert_allclose(other.splats.means.mean(axis=0), avatar.splats.means.mean(axis=0), atol=0.15)
    assert (resampled(avatar, 900).splats.means == resampled(avatar, 900).splats.means).all()


@pytest.mark.gl
def test_growth_has_a_row_a_point(context: Context, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(report_growth, "default_avatar", lambda: limb(200))
    result = growth(context, SMALL)
    assert [row["splats"] for row in result["splats"]] == [1024, 2048, 4096]
    assert [row["size"] for row in result["pixels"]] == [16, 32, 64]
    assert [row["views"] for row in result["views"]] == [1, 2]
    rows = [*result["splats"], *result["pixels"], *result["views"]]
    assert all(row["ms"]["p95"] >= row["ms"]["median"] > 0 for row in rows)
    assert {"skin", "sort", "draw"} <= set(result["splats"][0]["stages_ms"])
    # known without measuring: what the buffers hold
    fits = result["fits"]
    # attributes 68, posed 64, scratch of the skin pass 64 (up to 65,536 splats), colour 12, order 4, records 56
    assert fits["gpu_bytes_a_splat"]["slope"] == pytest.approx(268, abs=1)
    assert fits["gpu_bytes_a_splat"]["largest_relative_error"] < 0.01
    assert fits["process_bytes_a_splat"] is None


@pytest.mark.gl
def test_points_beyond_the_budget_are_left_out(context: Context, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(report_growth, "default_avatar", lambda: limb(200))
    result = growth(context, Grid((100, 10**9, 10**10), (16,), (1,), size=32, frames=2, alone=False))
    first, second, third = result["splats"]
    assert "ms" in first and second["left_out"].startswith("would ") and "larger than" in third["left_out"]
    monkeypatch.setattr(report_growth, "_available", lambda: 1000)
    result = growth(context, Grid((100, 400), (16,), (1,), size=32, frames=2, alone=False))
    assert "GB of memory" in result["splats"][1]["left_out"]


def test_rows(context: Context) -> None:
    """A row an avatar and size, of what each holds; interleaved, and nothing is left on the context."""
    told: list[None] = []
    figures = {"splats": thinned(default_avatar(), 100), "mesh": boxes()}
    with context:
        rows = costs(context, figures, sizes=(32, 48), frames=3, tick=lambda: told.append(None))
    assert [(row.name, row.size) for row in rows] == [("splats", 32), ("mesh", 32), ("splats", 48), ("mesh", 48)]
    assert len(told) == 2 * 2 * (WARM_UP + 3)
    for row in rows:
        figure = figures[row.name]
        expected = ("triangles", len(figure.faces)) if row.name == "mesh" else ("splats", len(figure.splats))
        assert (row.kind, row.count) == expected and row.nbytes > 1000
        assert 0 < row.pair.median <= row.pair.p95 and row.two.median > 0 and row.in_turn.median > 0
        assert row.gain == pytest.approx(row.two.median / row.pair.median, abs=1e-3)
        assert row.row()["pair_ms"] == row.pair.median and "paper" not in row.row()
    by_size = {(row.name, row.size): row for row in rows}
    assert by_size["mesh", 48].nbytes > by_size["mesh", 32].nbytes  # its targets grow, a splat's records do not
