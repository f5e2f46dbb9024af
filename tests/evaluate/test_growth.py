"""Growth: lines through points are those by hand, larger scenes keep their area, budgets leave points out."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from glsplat.evaluate.knobs import base_config, settings_of
from glsplat.evaluate.sections import growth as report_growth
from glsplat.evaluate.sections.growth import Grid, fitted, grid_of, growth, growth_cost, resampled
from glsplat.evaluate.sections.measure import agreement, measure
from glsplat.evaluate.subjects import Subject
from glsplat.gl.context import Context
from tests.api.current_context import nothing_current
from tests.scenes import limb

pytest.importorskip("flip_evaluator")

SMALL = Grid((1024, 2048, 4096), (16, 32, 64), (1, 2, 4), size=32, frames=2, alone=False)


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
    done: list[float] = []
    result = growth(context, SMALL, tick=done.append)
    assert sum(done) == pytest.approx(growth_cost(SMALL))
    assert [row["splats"] for row in result["splats"]] == [1024, 2048, 4096]
    assert [row["size"] for row in result["pixels"]] == [16, 32, 64]
    assert [row["views"] for row in result["views"]] == [1, 2, 4]
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


@pytest.mark.check
@pytest.mark.gl
def test_memory_of_a_process_of_its_own() -> None:
    grown = report_growth._grown_apart(1000, 256, 2, None)
    assert grown is None or grown > 2 * 256 * 256 * 16  # the float target alone


def test_a_quick_grid_is_part_of_the_whole() -> None:
    quick, whole = grid_of(True), grid_of(False)
    assert set(quick.splats) <= set(whole.splats) and max(whole.splats) == 1_000_000
    assert set(quick.pixels) <= set(whole.pixels) == {256, 512, 1024, 2048}
    assert set(quick.views) <= set(whole.views) == {1, 2, 4, 8}
    assert growth_cost(quick) < growth_cost(whole) / 5


@pytest.mark.check
@pytest.mark.gl
def test_agreement_with_bench(context: Context) -> None:
    """The same work by both; a report that took twice as long is not called equal."""
    subject = Subject("limb", limb(2000), 64, moving=True)
    scene = measure(context, subject, settings_of(subject, base_config(context))[:2], 6, [7])
    nothing_current()  # as other tests and libraries may leave it
    (row,) = agreement(context, [subject], [scene], 6, lambda _: None)
    assert 0.3 < row["ratio"] < 3  # on a machine that does other things as well
    slow: dict[str, Any] = {"settings": [{"ms": {"median": 1000.0, "p95": 1001.0}}]}
    (row,) = agreement(context, [subject], [slow], 3, lambda _: None)
    assert not row["agree"] and row["ratio"] > 3
