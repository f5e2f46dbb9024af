"""Plots of ``glsplat report`` as PNG."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from ..figures import png_of

_MEASURES = (("psnr", "PSNR (dB, higher is closer)"), ("flip", "FLIP (0 is equal)"), ("lpips", "LPIPS (0 is equal)"))
_MARKERS = "osD^v<>P*hpd"
_MARKS = {"render": "s", "serve": "o", "--fps": "D"}
_MOST_CURVES = 10
_FLOOR = 1e-6  # lower end of a logarithmic axis


def precision_plot(results: Sequence[dict[str, Any]]) -> bytes:
    """Plot work against precision of one scene, one row per size: a curve per method, Pareto fronts, and defaults."""
    figure = Figure(figsize=(15, 5.2 * len(results)), layout="constrained")
    for line, result in zip(figure.subplots(len(results), 3, squeeze=False), results, strict=True):
        for axes, (key, label) in zip(line, _MEASURES, strict=True):
            if all(row[key] is None for row in result["rows"]):  # no LPIPS weights, or a picture below its minimum
                axes.set_axis_off()
                continue
            _precision(axes, result["rows"], key)
            axes.set(xscale="log", xlabel="ms a frame (median, line: 95 % interval)", ylabel=label)
            axes.xaxis.set_major_locator(LogLocator(subs=(1, 1.5, 2, 3, 4, 6, 8), numticks=20))
            axes.xaxis.set_major_formatter("{x:g}")
            axes.xaxis.set_minor_formatter(NullFormatter())
            axes.grid(alpha=0.3)
        searched = result["searched"]
        line[0].scatter([r["ms"] for r in searched], [r["psnr"] for r in searched], s=5, color="0.75", zorder=0)
        width, height = result["size"]
        line[0].set_title(f"{result['views']} x {width} x {height}", fontsize=10)
        line[-1].legend(*line[0].get_legend_handles_labels(), fontsize=7, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    figure.suptitle(f"{results[0]['scene']}: {results[0]['splats']:,} splats")
    return png_of(figure)


def _precision(axes: Axes, rows: Sequence[dict[str, Any]], key: str) -> None:
    """Draw the rows with a measure: methods with several rows as curves, others in grey, then fronts and defaults."""
    logarithmic = key != "psnr"

    def value(row: dict[str, Any]) -> float:
        return max(row[key], _FLOOR) if logarithmic else float(row[key])

    curves: dict[str, list[dict[str, Any]]] = {}
    for row in sorted(rows, key=lambda row: row["ms"]):
        method = f"JPEG {row['way']['jpeg'][1]}" if row["way"]["jpeg"] else row["method"]
        curves.setdefault(method, []).append(row)
    rows = [row for row in rows if row[key] is not None]
    for index, method in enumerate(sorted(curves, key=lambda name: -len(curves[name]))):  # one colour in all panels
        own, sent = [row for row in curves[method] if row[key] is not None], method.startswith("JPEG")
        few = len(curves[method]) < 2 or index >= _MOST_CURVES
        colour, label = ("0.45", None) if few else (f"C{index % 10}", method)
        x, spread = [r["ms"] for r in own], [[r["ms"] - r["low"] for r in own], [r["high"] - r["ms"] for r in own]]
        marker = "x" if sent else _MARKERS[index % len(_MARKERS)]
        joined = "none" if few or sent else "-"  # rows of a JPEG come from several pictures
        axes.errorbar(x, [value(r) for r in own], xerr=spread, marker=marker, linestyle=joined, linewidth=0.8,
                      elinewidth=0.4, markersize=4, color=colour, label=label)  # fmt: skip
    for sent, name in ((False, "front, drawn"), (True, "front, as JPEG")):
        front = [r for r in sorted(rows, key=lambda r: r["ms"]) if r["front"] and bool(r["way"]["jpeg"]) == sent]
        line = "--" if sent else "-"
        axes.plot([r["ms"] for r in front], [value(r) for r in front], line, color="k", linewidth=1.2, label=name)
    for mark, symbol in _MARKS.items():
        own = [r for r in rows if mark in r["marks"]]
        axes.scatter([r["ms"] for r in own], [value(r) for r in own], s=110, marker=symbol, facecolors="none",
                     edgecolors="C3", linewidths=1.4, zorder=5, label=f"default of {mark}")  # fmt: skip
    if logarithmic:
        axes.set_yscale("log")
        axes.yaxis.set_minor_formatter(NullFormatter())


def left_out_plot(rows: Sequence[dict[str, Any]]) -> bytes:
    """Plot the slowdown of a frame by each feature that is compiled in but unused."""
    figure = Figure(figsize=(10, 0.45 * len(rows) + 1.6), layout="constrained")
    axes = figure.subplots()
    drawn = axes.barh([row["feature"] for row in rows], [row["cost"] for row in rows], color="C0")
    axes.axvline(1, color="0.3", linewidth=0.8)
    paper = {"facecolor": "white", "edgecolor": "none", "pad": 1}  # keep the line at 1 off the numbers
    axes.bar_label(drawn, fmt="%.2f x", fontsize=8, padding=4, bbox=paper)
    axes.invert_yaxis()
    axes.set(xlabel="frame with the feature present but unused / frame without it")
    return png_of(figure)
