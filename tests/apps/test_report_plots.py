"""Names in the report's plots can be read: none lies on another or leaves its panel."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text

from apps.report import plots as report_plots


def scene(points: dict[str, list[tuple[float, float]]]) -> dict:
    rows = [
        {"knob": knob, "setting": f"margin -0.{i}", "ms": {"median": ms, "p95": ms * 1.2}, "psnr": psnr}
        | {"pareto": i == 0, "truth": "shared", "bytes": 1000}
        for knob, places in points.items()
        for i, (ms, psnr) in enumerate(places)
    ]
    return {"scene": "s", "splats": 1, "views": 2, "size": [8, 8], "settings": rows}


@pytest.mark.check
@pytest.mark.parametrize("case", ["as measured", "random"])
def test_names_do_not_overlap(monkeypatch, rng, case):
    points = {
        "as measured": {
            "period": [(46.2, 103.5), (46.0, 71.0), (45.9, 64.2), (46.1, 57.1), (46.0, 70.5)],
            "hidden": [(46.5, 103.5), (32.0, 47.0), (29.0, 45.0), (26.0, 42.5), (25.0, 41.0)],
            "sorter": [(46.0, 103.5), (57.0, 103.5)],
            "resolution": [(46.0, 103.5), (41.0, 40.5), (41.0, 34.5)],
        },
        "random": {f"k{k}": list(zip(rng.uniform(1, 9, 6), rng.uniform(20, 160, 6), strict=True)) for k in range(8)},
    }[case]
    monkeypatch.setattr(report_plots, "png_of", lambda figure: figure)
    figure = report_plots.knob_plot(scene(points))
    FigureCanvasAgg(figure).draw()
    for axes in figure.axes:
        boxes = [Text.get_window_extent(text) for text in axes.texts if text.get_text()]  # without its line
        assert len(boxes) == sum(len(places) for knob, places in points.items() if knob == axes.get_title())
        panel = axes.get_window_extent()
        assert all(panel.x0 <= box.x0 and box.x1 <= panel.x1 for box in boxes)
        assert all(panel.y0 <= box.y0 and box.y1 <= panel.y1 for box in boxes)
        for one, other in combinations(boxes, 2):
            assert (
                not (np.array([one.x0, one.y0]) < [other.x1, other.y1]).all()
                or not (np.array([other.x0, other.y0]) < [one.x1, one.y1]).all()
            )
