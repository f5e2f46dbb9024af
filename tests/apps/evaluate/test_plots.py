"""The pictures of an evaluation: every participant is a point where it should be, and gaps are gaps."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

pytest.importorskip("matplotlib")

from matplotlib.figure import Figure

from apps.evaluate import plots
from glsplat.extras.evaluate.statistics import Values

VALUES: Values = {
    "photo": {"p01": 1.0, "p02": 2.0, "p03": 4.0},
    "mesh": {"p01": 2.0, "p02": None, "p03": 3.0},
    "scan": {},
}


def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """The figures that become PNG."""
    figures: list[Figure] = []
    real = plots.png_of
    monkeypatch.setattr(plots, "png_of", lambda figure: (figures.append(figure), real(figure))[1])
    return figures


def picture(data: bytes) -> np.ndarray:
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None and image.std() > 5
    return image


@pytest.mark.check
def test_methods(monkeypatch: pytest.MonkeyPatch) -> None:
    figures = drawn(monkeypatch)
    image = picture(plots.methods_plot({"PSNR (dB)": VALUES, "L1": {"photo": {"p01": 1.0}}}))
    assert image.shape[1] == 16 * 90
    axes = figures[0].axes[0]
    points = [np.asarray(strip.get_offsets()) for strip in axes.collections]
    assert [sorted(strip[:, 1]) for strip in points] == [[1, 2, 4], [2, 3], []]
    assert all(np.abs(strip[:, 0] - index).max(initial=0) < 0.2 for index, strip in enumerate(points))
    assert [label.get_text() for label in axes.get_xticklabels()] == ["photo (3)", "mesh (2)", "scan (0)"]
    lines = [np.asarray(line.get_ydata(), float) for line in axes.lines if len(line.get_ydata()) == 3]
    assert np.array_equal(lines[1], [2.0, np.nan, np.nan], equal_nan=True)
    means = [line.get_ydata()[0] for line in axes.lines if line.get_marker() == "D"]
    assert means == pytest.approx([7 / 3, 2.5])
    picture(plots.groups_plot({"by side": {"front": VALUES, "back": {"mesh": {"p01": 5.0}}}}, "PSNR (dB)"))
    assert sorted(bar.get_height() for bar in figures[1].axes[0].patches) == pytest.approx([7 / 3, 2.5, 5.0])
    assert plots.methods_plot({}).startswith(b"\x89PNG") and plots.groups_plot({}, "L1").startswith(b"\x89PNG")
