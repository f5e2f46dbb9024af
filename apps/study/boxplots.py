"""Boxplots of a study's answers as PNG: a panel per response, a point per answer."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from glsplat.extras.study.analysis.analysis import Analysis

from ..figures import png_of

_COLUMNS = 3
MAX_LABEL = 24  # characters of a level
_SPREAD = 0.22  # half width of the strip of points, relative to the distance of boxes


def boxplots(analyses: Sequence[Analysis]) -> bytes:
    """Return boxplots: quartiles and median, whiskers up to 1.5 interquartile ranges; the diamond is the mean.

    Points are answers, those of a participant at the same offset in each box. Colours are the last factor's levels.
    """
    columns = min(_COLUMNS, len(analyses))
    rows = -(-len(analyses) // columns)
    widest = max(len(analysis.cells) for analysis in analyses)
    figure = Figure(figsize=(max(4.5, 0.75 * widest + 1.5) * columns, 4.6 * rows), layout="constrained")
    places = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, analysis in zip(places, analyses, strict=False):
        _panel(axes, analysis)
    for axes in places[len(analyses) :]:
        axes.set_axis_off()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing", UserWarning)  # a letter that the font lacks is a box
        return png_of(figure)


def _panel(axes: Axes, analysis: Analysis) -> None:
    table = analysis.table
    last = table.shape[-1]
    people = len(table.names)
    aside = _SPREAD * (2 * np.arange(people) / max(people - 1, 1) - 1)
    for place, cell in enumerate(analysis.cells):
        own = table.cell == place
        colour = f"C{place % last % 10}"
        box = axes.boxplot(table.values[own], positions=[place], widths=0.6, showfliers=False, patch_artist=True)
        box["boxes"][0].set(facecolor=colour, alpha=0.25)
        box["medians"][0].set(color="k")
        axes.plot(place + aside[table.participant[own]], table.values[own], ".", color=colour, alpha=0.7, markersize=5)
        axes.plot([place], [cell.mean], "D", color="k", markersize=4)
    labels = [_literal(cell.condition.replace(", ", "\n")) for cell in analysis.cells]
    axes.set_xticks(range(len(labels)), labels, fontsize=8)
    axes.set(ylabel=_literal(table.response))
    axes.grid(axis="y", alpha=0.3)
    axes.set_axisbelow(True)


def _literal(text: str) -> str:
    """Return the text with dollars escaped and long lines shortened."""
    lines = (line if len(line) <= MAX_LABEL else line[: MAX_LABEL - 3] + "..." for line in text.split("\n"))
    return "\n".join(lines).replace("$", r"\$")
