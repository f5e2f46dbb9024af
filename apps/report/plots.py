"""Plots of ``glsplat report`` as PNG."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter
from numpy.typing import NDArray

from glsplat.extras.evaluate.difference import PSNR_CAP

from ..figures import png_of

__all__ = ["batching_plot", "error_plot", "growth_plot", "hidden_plot", "knob_plot", "left_out_plot"]

_MEASURES = (
    ("psnr", "PSNR (dB, higher is closer)", False),
    ("maximum", "maximum error (of 1)", True),
    ("flip", "mean FLIP (0 is equal)", True),
)
_MARKERS = "osD^v<>PX*hpd"
_COLOURS = ("k", *(f"C{i}" for i in range(10)), "navy", "olive", "0.6")
_NAME_LINE = 0.07  # height of a line of names, share of a panel
_FLOOR = 1e-7  # where a logarithmic axis begins


def error_plot(scene: dict[str, Any]) -> bytes:
    """Plot PSNR, maximum error and FLIP against ms per frame, a colour per setting, with the Pareto front in PSNR."""
    figure = Figure(figsize=(16, 5.2), layout="constrained")
    rows = [row for row in scene["settings"] if row["truth"] == "shared"]
    knobs = list(dict.fromkeys(row["knob"] for row in rows))
    for axes, (key, label, logarithmic) in zip(figure.subplots(1, 3), _MEASURES, strict=True):
        for index, knob in enumerate(knobs):
            own = [row for row in rows if row["knob"] == knob]
            axes.errorbar(
                [row["ms"]["median"] for row in own],
                [max(row[key], _FLOOR) if logarithmic else row[key] for row in own],
                xerr=[[0.0] * len(own), [max(0.0, row["ms"]["p95"] - row["ms"]["median"]) for row in own]],
                fmt=_MARKERS[index % len(_MARKERS)],
                color=_COLOURS[index % len(_COLOURS)],
                elinewidth=0.4,
                markersize=6,
                label=knob,
            )
        front = sorted((r for r in rows if r["pareto"]), key=lambda r: (r["ms"]["median"], r["psnr"]))
        values = [max(r[key], _FLOOR) if logarithmic else r[key] for r in front]
        axes.plot([r["ms"]["median"] for r in front], values, color="0.3", linewidth=1, label="Pareto front (PSNR)")
        axes.set(xlabel="ms a frame (median; line to the 95th percentile)", ylabel=label)
        if logarithmic:
            axes.set_yscale("log")
        axes.grid(alpha=0.3)
    figure.axes[-1].legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    figure.suptitle(_title(scene))
    return png_of(figure)


def knob_plot(scene: dict[str, Any]) -> bytes:
    """Plot a panel per setting: its named values, PSNR against ms, on common axes."""
    knobs = [k for k in dict.fromkeys(row["knob"] for row in scene["settings"]) if k != "default"]
    columns = 4
    lines = -(-len(knobs) // columns)
    figure = Figure(figsize=(16, 3.4 * lines), layout="constrained")
    panels: list[Axes] = list(figure.subplots(lines, columns, squeeze=False, sharex=True, sharey=True).flat)
    limits = _limits(scene["settings"])
    panels[0].set(xlim=limits[0], ylim=limits[1])
    for axes, knob in zip(panels, knobs, strict=False):
        own = sorted((r for r in scene["settings"] if r["knob"] == knob), key=lambda r: r["ms"]["median"])
        axes.plot([r["ms"]["median"] for r in own], [r["psnr"] for r in own], color="0.8", zorder=1)
        for row in own:
            axes.scatter(row["ms"]["median"], row["psnr"], color="C3" if row["pareto"] else "C0", zorder=2)
        named = ""
        for row in sorted(own, key=lambda r: -r["psnr"]) if knob == "JPEG" else ():  # they lie on top of each other
            named += f"{row['psnr']:5.1f} dB  {row['setting']}, {row['bytes'] / 1024:.0f} KiB\n"
        axes.text(0.03, 0.97, named, transform=axes.transAxes, va="top", fontsize=8)
        if knob != "JPEG":
            _name(axes, [(r["ms"]["median"], r["psnr"], r["setting"]) for r in own], limits)
        axes.set_title(knob + (" (against an exact order an eye)" if knob == "order" else ""), fontsize=10)
        axes.grid(alpha=0.3)
    for axes in panels[len(knobs) :]:
        axes.set_axis_off()
    figure.supxlabel("ms a frame (median)")
    figure.supylabel("PSNR (dB)")
    figure.suptitle(_title(scene) + "; red: on the Pareto front")
    return png_of(figure)


def _limits(rows: Sequence[dict[str, Any]]) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return (left, right) and (bottom, top) that show all points, with room for names on the right."""
    ms, psnr = [row["ms"]["median"] for row in rows], [row["psnr"] for row in rows]
    span = max(max(ms) - min(ms), 1e-3)
    bottom, top = min(psnr) - 6, min(PSNR_CAP + 10, max(psnr) + 12)
    return (min(ms) - 0.08 * span, max(ms) + 0.55 * span), (bottom, max(top, bottom + 20))


def _name(axes: Axes, points: list[tuple[float, float, str]], limits: tuple[tuple[float, float], ...]) -> None:
    """Write the names in a column right of the points, a line apart where the points are closer, each with a line."""
    (left, right), (bottom, top) = limits
    column = max(x for x, _, _ in points) + 0.06 * (right - left)
    line = _NAME_LINE * (top - bottom)
    points = sorted(points, key=lambda point: -point[1])
    places = [min(points[0][1], top - line)]
    for _, y, _ in points[1:]:
        places.append(min(y, places[-1] - line))
    lowest = bottom + line / 2
    for i in reversed(range(len(places))):
        places[i] = max(places[i], lowest)
        lowest = places[i] + line
    for (x, y, text), place in zip(points, places, strict=True):
        lead = {"arrowstyle": "-", "color": "0.6", "linewidth": 0.5, "shrinkA": 0, "shrinkB": 3}
        axes.annotate(text, (x, y), xytext=(column, place), va="center", fontsize=8, arrowprops=lead, zorder=1)


def batching_plot(rows: Sequence[dict[str, Any]]) -> bytes:
    """Plot our gain of batching beside the paper's, and the gain of each stage."""
    figure = Figure(figsize=(14, 4.8), layout="constrained")
    times, gains = figure.subplots(1, 2)
    names = [f"{row['size']}²" for row in rows]
    width = 0.2
    bars = [
        ("pair in one pass", "C0", {i: row["pair_ms"]["median"] for i, row in enumerate(rows)}),
        ("two renders", "C1", {i: row["two_ms"]["median"] for i, row in enumerate(rows)}),
        ("paper, batched", "C2", {i: row["paper"]["pair_ms"] for i, row in enumerate(rows) if "paper" in row}),
        ("paper, not batched", "C3", {i: row["paper"]["two_ms"] for i, row in enumerate(rows) if "paper" in row}),
    ]
    for index, (label, colour, values) in enumerate(bars):
        places = [i + (index - 1.5) * width for i in values]
        if values:
            drawn = times.bar(places, list(values.values()), width, label=label, color=colour)
            times.bar_label(drawn, fmt="%.4g", fontsize=7)
    times.set_xticks(range(len(rows)), names)
    times.set(ylabel="ms for both eyes", title="The paper's figures are of its authors' GPU and avatar")
    times.legend(fontsize=8)
    stages = [s["stage"] for s in rows[0]["stages"]] if rows else []
    for index, stage in enumerate(stages):
        saved = [next((s["saved_ms"] for s in row["stages"] if s["stage"] == stage), 0.0) for row in rows]
        places = [i + (index - len(stages) / 2 + 0.5) * 0.8 / len(stages) for i in range(len(rows))]
        gains.bar(places, saved, 0.8 / len(stages), label=stage)
    gains.set_xticks(range(len(rows)), names)
    gains.axhline(0, color="0.3", linewidth=0.8)
    gains.set(ylabel="ms saved by drawing both eyes at once", title="Where the gain lies (stages measured apart)")
    gains.legend(fontsize=8)
    return png_of(figure)


def left_out_plot(rows: Sequence[dict[str, Any]]) -> bytes:
    """Plot the slowdown of a frame by each feature that is compiled in but unused."""
    figure = Figure(figsize=(10, 0.45 * len(rows) + 1.6), layout="constrained")
    axes = figure.subplots()
    drawn = axes.barh([row["feature"] for row in rows], [row["cost"] for row in rows], color="C0")
    axes.axvline(1, color="0.3", linewidth=0.8)
    paper = {"facecolor": "white", "edgecolor": "none", "pad": 1}  # the line at 1 does not run through a number
    axes.bar_label(drawn, fmt="%.2f x", fontsize=8, padding=4, bbox=paper)
    axes.invert_yaxis()
    axes.set(xlabel="frame with the feature present but unused / frame without it")
    return png_of(figure)


def growth_plot(growth: dict[str, Any]) -> bytes:
    """Plot time against splats (and stages), pixels and views, and memory against splats, with fitted lines."""
    figure = Figure(figsize=(15, 9), layout="constrained")
    (splats, memory), (pixels, views) = figure.subplots(2, 2)
    fits, side = growth["fits"], growth["size"]
    rows = [row for row in growth["splats"] if "ms" in row]
    counts = [row["splats"] for row in rows]
    for stage in fits["stages_ns_a_splat"]:
        values = [max(row["stages_ms"].get(stage, 0.0), 1e-3) for row in rows]
        splats.plot(counts, values, linewidth=0.8, marker=".", label=stage)
    _measured(splats, rows, "splats", fits["ns_a_splat"], 1e-6, "{:.0f} ns a splat + {:.1f} ms")
    splats.set(xscale="log", yscale="log", xlabel="splats", ylabel="ms a frame", title=f"2 x {side}², in motion")
    for key, label in (("gpu_bytes", "buffers and textures"), ("process_bytes", "what a process grows by")):
        own = [row for row in rows if row[key]]
        if own:
            line = fits[f"{key}_a_splat"]
            text = f": {line['slope']:.0f} bytes a splat + {line['constant'] / 1e6:.1f} MB" if line else ""
            memory.plot([r["splats"] for r in own], [r[key] / 1e6 for r in own], marker="o", label=label + text)
    memory.set(xscale="log", yscale="log", xlabel="splats", ylabel="MB", title=f"Memory, 2 x {side}²")
    rows = [row for row in growth["pixels"] if "ms" in row]
    _measured(pixels, rows, "pixels", fits["ns_a_pixel"], 1e-6, "{:.1f} ns a pixel + {:.0f} ms")
    title = f"Pixels of a pair, {rows[0]['splats']:,} splats" if rows else ""
    pixels.set(xscale="log", yscale="log", ylabel="ms a frame", title=title)
    pixels.set_xticks([row["pixels"] for row in rows], [f"2 x {row['size']}²" for row in rows], minor=False)
    pixels.set_xticks([], minor=True)
    rows = [row for row in growth["views"] if "ms" in row]
    _measured(views, rows, "views", fits["ms_a_view"], 1.0, "{:.1f} ms a view + {:.1f} ms")
    views.set_xticks([row["views"] for row in rows])
    views.set(ylim=(0, None), xlabel="views", ylabel="ms a frame", title=f"Views of {side}², two of a head in one pass")
    for axis in (memory.yaxis, pixels.yaxis):
        axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter(NullFormatter())
    for axes in (splats, memory, pixels, views):
        axes.grid(alpha=0.3)
        if axes.get_legend_handles_labels()[0]:
            place = {"loc": "upper left", "bbox_to_anchor": (1.0, 1.0)} if axes is splats else {"loc": "upper left"}
            axes.legend(fontsize=8, **place)
    return png_of(figure)


def hidden_plot(row: dict[str, Any], picture: NDArray[np.float32]) -> bytes:
    """Plot the worst picture without hidden splats, with them, and the difference."""
    left, complete = np.split(picture[..., :3].clip(0, 1), 2, axis=1)
    figure = Figure(figsize=(15, 5.4), layout="constrained")
    images = (left, complete, (4 * np.abs(left - complete)).clip(0, 1))
    titles = (f"hidden splats left out: {row['worst']['psnr']:.1f} dB", "complete", "difference x 4")
    for axes, image, title in zip(figure.subplots(1, 3), images, titles, strict=True):
        axes.imshow(image)
        axes.set_title(title, fontsize=10)
        axes.set_axis_off()
    figure.suptitle(f"{row['scene']}, the worst of {row['worst']['pictures']} pictures: {row['worst']['where']}")
    return png_of(figure)


def _measured(
    axes: Axes, rows: Sequence[dict[str, Any]], key: str, line: dict[str, float] | None, factor: float, words: str
) -> None:
    """Plot medians with a line to the 95th percentile, and the fitted straight line."""
    x = [row[key] for row in rows]
    medians = [row["ms"]["median"] for row in rows]
    up = [max(0.0, row["ms"]["p95"] - row["ms"]["median"]) for row in rows]
    axes.errorbar(
        x, medians, yerr=[[0.0] * len(x), up], fmt="o", color="C3", label="whole frame (line to p95)", zorder=3
    )
    if line:
        fine = [float(x[0] * (x[-1] / x[0]) ** (i / 200)) for i in range(201)]  # also for logarithmic axes
        slope = line["slope"] * factor
        label = words.format(line["slope"], line["constant"])
        axes.plot(fine, [line["constant"] + slope * v for v in fine], color="0.4", linewidth=1, label=label)


def _title(scene: dict[str, Any]) -> str:
    width, height = scene["size"]
    return f"{scene['scene']}: {scene['splats']:,} splats, {scene['views']} x {width}x{height}"
