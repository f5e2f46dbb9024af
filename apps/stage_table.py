"""The latency table of a streaming run, as text for the terminal and as markdown for the documentation."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence
from datetime import date
from importlib.metadata import version

from glsplat.net.stages import median_p95

from .streaming import STAGES, Result

__all__ = ["frame_text", "table_markdown", "table_text"]


def table_text(result: Result) -> str:
    """Rows of stage, place, median and 95th percentile in ms; the parts of rendering are indented."""
    lines = [f"{'stage':28}{'where':8}{'median':>9}{'p95':>9}   ms"]
    for name, place, median, p95 in _rows(result):
        lines.append(f"{name:28}{place:8}{median:9.2f}{p95:9.2f}")
    return "\n".join(lines)


def frame_text(result: Result) -> str:
    """One line about frames, bytes and the age of the picture on show."""
    age, age95 = median_p95(result.ages)
    size = sum(result.nbytes) / max(len(result.nbytes), 1) / 1e3
    return (
        f"{result.fps:.1f} pictures a second: {result.sent} asked, {result.shown} shown, {result.dropped} dropped, "
        f"{result.late} late, {result.errors} failed; {size:.0f} kB a frame; age on show {age:.0f} ms (p95 {age95:.0f})"
    )


def table_markdown(results: Sequence[tuple[str, Result]]) -> str:
    """One table, a pair of columns for each run, with driver, machine, versions and date below."""
    names = [name for name, _ in results]
    lines = [
        "| stage | where | " + " | ".join(f"{name}: median | p95" for name in names) + " |",
        "|---|---|" + "--:|--:|" * len(names),
    ]
    columns = [{(name, place): (m, p) for name, place, m, p in _rows(result)} for _, result in results]
    for key in columns[0]:
        cells = " | ".join(f"{c[key][0]:.2f} | {c[key][1]:.2f}" if key in c else " | " for c in columns)
        lines.append(f"| {key[0].replace('  ', '- ')} | {key[1]} | {cells} |")
    lines.append("| pictures a second | | " + " | ".join(f"{r.fps:.1f} | " for _, r in results) + " |")
    ages = [median_p95(r.ages) for _, r in results]
    lines.append("| age of the picture on show | client | " + " | ".join(f"{m:.0f} | {p:.0f}" for m, p in ages) + " |")
    sizes = [sum(r.nbytes) / max(len(r.nbytes), 1) / 1e3 for _, r in results]
    lines.append("| kB a frame | | " + " | ".join(f"{size:.0f} | " for size in sizes) + " |")
    driver = next((r.driver for _, r in results if r.driver), "unknown driver")
    packages = ", ".join(f"{name} {version(name)}" for name in ("moderngl", "numpy", "aiohttp", "simplejpeg"))
    lines += ["", f"Milliseconds. {driver}; {_machine()}; Python {platform.python_version()}, {packages};"]
    lines += [f"{date.today().isoformat()}, client and server on one machine."]
    return "\n".join(lines) + "\n"


def _rows(result: Result) -> list[tuple[str, str, float, float]]:
    rows = []
    for key, name, place in STAGES:
        rows.append((name, place, *median_p95(result.times.get(key, []))))
        if key == "render":
            parts = [part for part in result.times if part.startswith("render/")]  # in the order of the frame
            rows += [(f"  {p.removeprefix('render/')}", place, *median_p95(result.times[p])) for p in parts]
    return rows


def _machine() -> str:
    return f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores"
