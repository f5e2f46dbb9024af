"""Plots of ``glsplat evaluate`` as PNG: measures by method and participant."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from glsplat.extras.evaluate.statistics import Values, summarise

from ..figures import png_of

_COLUMNS = 4
_SPREAD = 0.16  # width of the strip of points, as a share of the distance between two methods
_GROUP = 0.8  # width of a group's bars, as a share of the distance between two groups


def methods_plot(panels: Mapping[str, Values], seed: int = 0) -> bytes:
    """Return a panel per measure, by its label: a point per participant, joined by a line over the methods.

    The box has the quartiles and the median; the diamond is the mean with its 95 % bootstrap interval.
    """
    figure, axes = _panels(len(panels), 4.4)
    for place, (label, values) in zip(axes, panels.items(), strict=False):
        _strips(place, values, seed)
        place.set(ylabel=label)
    return png_of(figure)


def groups_plot(panels: Mapping[str, Mapping[str, Values]], label: str, seed: int = 0) -> bytes:
    """Return bars of the measure ``label``: a panel per grouping, such as by side or body part.

    A group's bars are the methods' means over participants, with their 95 % bootstrap intervals.
    """
    figure, axes = _panels(len(panels), 3.9, columns=2)
    for place, (title, groups) in zip(axes, panels.items(), strict=False):
        methods = list(dict.fromkeys(method for values in groups.values() for method in values))
        for index, method in enumerate(methods):
            found = [summarise({method: values.get(method, {})}, seed)[0] for values in groups.values()]
            at = [
                (position + _GROUP * ((index + 0.5) / len(methods) - 0.5), row.mean, row.low, row.high)
                for position, row in enumerate(found)
                if row.mean is not None
            ]
            if not at:
                continue
            middles, means, lows, highs = zip(*at, strict=True)
            place.bar(middles, means, _GROUP / len(methods) * 0.92, color=_colour(index), label=method)
            for x, low, high in zip(middles, lows, highs, strict=True):
                if low is not None:
                    place.plot([x, x], [low, high], color="0.15", linewidth=1)
        place.set_xticks(range(len(groups)), list(groups))
        place.set(title=title, ylabel=label)
        place.grid(axis="y", alpha=0.3)
        place.set_axisbelow(True)
    if axes:
        axes[-1].legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return png_of(figure)


def _strips(axes: Axes, values: Values, seed: int) -> None:
    """Draw a panel of ``methods_plot``."""
    rows = summarise(values, seed)
    people = list(dict.fromkeys(name for own in values.values() for name in own))
    aside = dict(zip(people, _SPREAD * (np.arange(len(people)) / max(len(people) - 1, 1) - 0.5), strict=True))
    # a missing value breaks the participant's line and has no point
    points = np.array([[own.get(name) for own in values.values()] for name in people], float)
    points = points.reshape(len(people), len(values))
    points[~np.isfinite(points)] = np.nan
    for name, line in zip(people, points, strict=True):
        axes.plot(np.arange(len(values)) + aside[name], line, color="0.8", linewidth=0.6, zorder=1)
    for index, row in enumerate(rows):
        column = points[:, index]
        known = np.isfinite(column)
        colour = _colour(index)
        places = index + np.array([aside[name] for name in people])
        axes.scatter(places[known], column[known], s=14, color=colour, alpha=0.8, linewidth=0, zorder=2)
        if row.mean is None:
            continue
        axes.boxplot(
            [column[known]],
            positions=[index],
            widths=0.42,
            showfliers=False,
            showcaps=False,
            whis=0.0,
            manage_ticks=False,
            medianprops={"color": "0.2"},
            boxprops={"color": "0.4"},
        )
        axes.plot([index + 0.32], [row.mean], marker="D", markersize=5, color="k", zorder=3)
        if row.low is not None and row.high is not None:
            axes.plot([index + 0.32] * 2, [row.low, row.high], color="k", linewidth=1.2, zorder=3)
    names = [f"{row.method} ({row.n})" for row in rows]
    axes.set_xticks(range(len(rows)), names, fontsize=9, rotation=15, ha="right", rotation_mode="anchor")
    axes.set_xlim(-0.6, len(rows) - 0.4)
    axes.grid(axis="y", alpha=0.3)


def _panels(count: int, height: float, columns: int = _COLUMNS) -> tuple[Figure, list[Axes]]:
    """Return a figure 16 inches wide with ``count`` panels; the last row may have empty places."""
    across = max(1, min(columns, count))
    lines = max(1, -(-count // across))
    figure = Figure(figsize=(16, height * lines), layout="constrained")
    axes: list[Axes] = list(figure.subplots(lines, across, squeeze=False).flat)
    for place in axes[count:]:
        place.set_axis_off()
    return figure, axes[:count]


def _colour(index: int) -> str:
    return f"C{index % 10}"
