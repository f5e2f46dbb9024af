"""Tables of streaming runs: stages of one as text, a comparison of several as Markdown."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from importlib.metadata import version

from glsplat.gl.software import is_software
from glsplat.io.provenance import machine
from glsplat.net.pace.stages import median_p95

from .streaming import STAGES, Result

_DEFERRED_NOTE = "This driver defers work: most of the drawing is in the stage that waits for it (resolve)."


def table_text(result: Result) -> str:
    """Return rows of stage, place, median and 95th percentile in ms; the parts of rendering are indented.

    A note follows for software rasterizers, which defer drawing.
    """
    lines = [f"{'stage':28}{'where':8}{'median':>9}{'p95':>9}   ms"]
    for name, place, median, p95 in _rows(result):
        lines.append(f"{name:28}{place:8}{median:9.2f}{p95:9.2f}")
    if is_software(result.driver):
        lines.append(_DEFERRED_NOTE)
    return "\n".join(lines)


def frame_text(result: Result) -> str:
    """Return two lines about frames, bytes, the age of shown pictures, and the time beyond rendering."""
    age, age95 = median_p95(result.ages)
    more, more95 = median_p95(result.beyond_render)
    size = sum(result.nbytes) / max(len(result.nbytes), 1) / 1e3
    return (
        f"{result.fps:.1f} pictures a second: {result.sent} asked, {result.shown} shown, {result.dropped} dropped, "
        f"{result.late} late, {result.errors} failed; {size:.0f} kB a frame; age on show {age:.0f} ms (p95 {age95:.0f})"
        f"\n{result.share:.2f} of what the renderer could draw without a pause; request to reply less render "
        f"{more:.1f} ms (p95 {more95:.1f})"
    )


def summary_text(result: Result) -> str:
    """Return the rate, the age of shown pictures, and the two stages that take the longest, in one line."""
    age, _ = median_p95(result.ages)
    stages = {key: median_p95(result.times.get(key, ()))[0] for key, _, _ in STAGES[:-1]}
    names = {key: name for key, name, _ in STAGES}
    longest = sorted(stages, key=stages.__getitem__, reverse=True)[:2]
    most = ", ".join(f"{names[key]} {stages[key]:.0f} ms" for key in longest)
    return f"{result.fps:5.1f} pairs a second, each {age:.0f} ms old when shown; longest: {most}"


def comparison_markdown(runs: Sequence[tuple[str, str, Result]]) -> str:
    """Return a table with a row per run (link, policy, rate, ages), then driver, machine, versions and date."""
    lines = [
        "| link | policy | shown a second | render, mean | share of render rate | reply - render, median | p95 "
        "| of it in the mailbox | age at reply, p95 | bound | age on show, median | p95 | kB a frame |",
        "|---|---|" + "--:|" * 11,
    ]
    for place, policy, result in runs:
        (more, more95), age = median_p95(result.beyond_render), median_p95(result.ages)
        reply95 = median_p95(result.replies)[1]
        size = sum(result.nbytes) / max(len(result.nbytes), 1) / 1e3
        lines.append(
            f"| {place} | {policy} | {result.fps:.1f} | {result.render_ms:.1f} | {result.share:.2f} "
            f"| {more:.1f} | {more95:.1f} | {median_p95(result.waits)[0]:.1f} "
            f"| {reply95:.0f} | {result.age_bound:.0f} | {age[0]:.0f} | {age[1]:.0f} | {size:.0f} |"
        )
    driver = next((result.driver for _, _, result in runs if result.driver), "unknown driver")
    facts = machine()
    packages = ", ".join(f"{name} {version(name)}" for name in ("moderngl", "numpy", "aiohttp", "simplejpeg"))
    lines += [
        "",
        f"Milliseconds. {driver}; {facts['machine']}, {facts['cores']} cores, {platform.system()}; "
        f"Python {platform.python_version()}, {packages};",
        f"{facts['date']}, client on this machine.",
    ]
    return "\n".join(lines) + "\n"


def _rows(result: Result) -> list[tuple[str, str, float, float]]:
    rows = []
    for key, name, place in STAGES:
        rows.append((name, place, *median_p95(result.times.get(key, []))))
        if key == "render":
            parts = [part for part in result.times if part.startswith("render/")]  # in the order of the frame
            rows += [(f"  {p.removeprefix('render/')}", place, *median_p95(result.times[p])) for p in parts]
    return rows
