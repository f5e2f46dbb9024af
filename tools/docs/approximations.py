"""Draw docs/images/precision-others.png: cost against error of steps besides drawing, from docs/measured."""

from __future__ import annotations

import re
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from apps.figures import png_of

ABOUT = (
    "The body solver (tracking.md), size and quality of JPEGs (ladder.md), the number of splats (avatars.md) and late "
    "pictures on a plane or on their depth (more.md), drawn from the tables of those pages."
)
"""Caption of the picture."""

Row = dict[str, str]


def others_plot(folder: Path) -> bytes:
    """Plot four tables of ``folder`` (docs/measured) as one PNG. Raises ValueError if one is missing."""
    figure = Figure(figsize=(15, 9), layout="constrained")
    (solver, ladder), (splats, late) = figure.subplots(2, 2)
    _solvers(solver, _rows(folder / "tracking.md", "scores"))
    for heading, marker in (("moments", "o"), ("set-aside", "x")):
        _ladder(ladder, _rows(folder / "ladder.md", heading), heading, marker)
    ladder.legend(fontsize=8)
    ladder.minorticks_off()
    _splats(splats, _rows(folder / "avatars.md", "Number of splats"))
    _late(late, _rows(folder / "more.md", "Depth on the page"))
    for axes in (solver, ladder, splats, late):
        axes.grid(alpha=0.3)
    return png_of(figure)


def _rows(page: Path, heading: str) -> list[Row]:
    """Return the rows of the first table below a heading, by column."""
    text = page.read_text(encoding="utf-8").partition(f"\n## {heading}\n")[2].partition("\n## ")[0]
    head, _, *rows = [_cells(line) for line in text.splitlines() if line.startswith("|")] or [[], []]
    if not rows:
        raise ValueError(f"{page.name}: expected a table below {heading!r}, found none")
    return [dict(zip(head, row, strict=True)) for row in rows]


def _cells(line: str) -> list[str]:
    return [cell.strip().strip("*") for cell in line.strip("|").split("|")]


def _number(text: str) -> float:
    """Return the last number of a cell."""
    return float(re.findall(r"[\d.,]*\d", text)[-1].replace(",", ""))


def _solvers(axes: Axes, rows: list[Row]) -> None:
    for row in rows:
        if row["clip"] != "all":
            continue
        error = _number(row["MPJPE cm"])
        if row["ms"] == "-":
            axes.axhline(error, color="0.6", linewidth=0.8, linestyle="--")
            axes.text(0.02, error, f"{row['solver']} (not timed)", fontsize=8, va="bottom",
                      transform=axes.get_yaxis_transform())  # fmt: skip
        else:
            axes.plot(1e3 * _number(row["ms"]), error, "o", color="C0")
            axes.annotate(row["solver"], (1e3 * _number(row["ms"]), error), fontsize=8, va="bottom")
    axes.margins(0.15)
    axes.set(xlabel="microseconds a sample", ylabel="MPJPE (cm)", title="Body solver, held-out and known clips")


def _ladder(axes: Axes, rows: list[Row], name: str, marker: str) -> None:
    for index, size in enumerate(("1", "0.875", "0.75", "0.625", "0.5")):
        own = [row for row in rows if row["size"] == size]
        x, y = ([_number(row[key]) for row in own] for key in ("kB an eye, box", "LPIPS"))
        axes.plot(x, y, marker, markersize=4, color=f"C{index}", label=f"{size} x, {name}")
    axes.set(
        xscale="log",
        yscale="log",
        xticks=(3, 5, 10, 20, 40),
        xticklabels=("3", "5", "10", "20", "40"),
        xlabel="kB an eye",
        ylabel="LPIPS",
        title="Size and quality of JPEGs, 4:2:0",
    )


def _splats(axes: Axes, rows: list[Row]) -> None:
    name, cost, error = next(iter(rows[0])), "stereo pair of 1024 (ms)", "body, worst / mean (dB)"
    for row in rows:
        x, y = _number(row[cost]), _number(row[error])
        axes.plot(x, y, "o", color="C0")
        axes.annotate(row[name], (x, y), fontsize=8, va="bottom")
    axes.margins(0.12)
    axes.set(xlabel="ms a pair of 1024 x 1024", ylabel="PSNR, mean (dB)", title="Splats of a fit (150 steps)")


def _late(axes: Axes, rows: list[Row]) -> None:
    for index, row in enumerate(rows):
        plane, mesh = (float(text) for text in re.findall(r"[\d.]+", row["PSNR, dB"]))
        axes.plot([plane, mesh], [index, index], color="0.6", linewidth=0.8, zorder=0)
        axes.plot(plane, index, "o", color="C1", label="plane" if index == 0 else None)
        axes.plot(mesh, index, "o", color="C0", label="depth, 2 kB a pair more" if index == 0 else None)
    axes.set_yticks(range(len(rows)), [f"{row['seen']}, {row['the head moved']}" for row in rows])
    axes.set(xlabel="PSNR of the late picture (dB)", title="Late pictures after the head moved")
    axes.legend(fontsize=8)
