"""The outcome of a comparison as one JSON object, and its first table as text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from glsplat.extras.evaluate.comparison import tables
from glsplat.extras.evaluate.comparison.measure import MEASURES, OVERLAP
from glsplat.extras.evaluate.comparison.participant import Participant
from glsplat.extras.evaluate.comparison.performance import CONTROLS
from glsplat.extras.evaluate.comparison.protocol import Protocol
from glsplat.extras.evaluate.comparison.work import Result
from glsplat.io.provenance import machine

LOWER = ("l1", "lpips", "box_l1", "flip", "lpips-vgg")
"""Measures for which smaller is better."""

NAMES = {"l1": "L1", "lpips": "LPIPS", "psnr": "PSNR (dB)", "ssim": "SSIM", "flip": "FLIP", "lpips-vgg": "LPIPS, VGG"}
NAMES |= {"box_l1": "L1, box", "box_psnr": "PSNR, box (dB)", "box_ssim": "SSIM, box", OVERLAP: "overlap"}
"""Display names of measures."""


def outcome(
    results: Sequence[Result],
    methods: Sequence[str],
    people: Sequence[Participant],
    protocol: Protocol,
    options: Mapping[str, Any],
    timing: Mapping[str, Any],
) -> dict[str, Any]:
    """Return all data of the page. Table 1 depends only on files, protocol and options."""
    good = [result for result in results if not result.failed]
    return {
        **machine(),
        "drivers": sorted({result.data["driver"] for result in good}),
        "made_by": sorted({result.data["made_by"] for result in good}),
        "protocol": protocol.to_json(),
        "options": dict(options),
        "methods": list(methods),
        "people": [one.name for one in people],
        "table1": tables.summary(results, methods, len(people)),
        "statistics": tables.compared(results, methods, int(options["seed"])),
        "views": tables.by_view(results, methods),
        "parts": tables.by_part(results, methods),
        "moments": tables.by_moment(results, methods),
        "participants": tables.by_participant(results, methods),
        "failures": tables.failures(results),
        "timing": dict(timing),
    }


def plots(results: Sequence[Result], methods: Sequence[str], seed: int) -> dict[str, bytes]:
    """Return PNG plots by file name: every measure by method, L1 by side, pose and body part; a set per control."""
    from .plots import groups_plot, methods_plot  # here: matplotlib takes a second

    drawn = {}
    for control in CONTROLS:
        panels = {NAMES[name]: {m: tables.means(results, m, control, name) for m in methods} for name in MEASURES}
        drawn[f"methods-{control}.png"] = methods_plot(panels, seed)
        groups = {
            title: tables.grouped(results, methods, control, "l1", key)
            for title, key in (("by side", "view"), ("by pose", "moment"), ("by body part", "part"))
        }
        drawn[f"groups-{control}.png"] = groups_plot(groups, NAMES["l1"], seed)
    return drawn


def table_lines(found: Mapping[str, Any]) -> list[str]:
    """Return table 1 as lines of text."""
    lines = []
    for control in CONTROLS:
        by = "head and hands" if control == "tracking" else "the true pose"
        lines.append(f"driven by {by}:")
        lines.append(f"  {'':14}" + "".join(f"{name + ('  v' if name in LOWER else '  ^'):>18}" for name in MEASURES))
        for row in found["table1"]:
            if row["control"] == control:
                cells = "".join(f"{_cell(row[name], name):>18}" for name in MEASURES)
                lines.append(f"  {row['method']:14}{cells}   {row['n']} of {row['of']}")
    lines += [f"failed: {row['participant']}, {row['method']}: {row['why']}" for row in found["failures"]]
    return lines


def _cell(spread: Mapping[str, Any] | None, name: str) -> str:
    if spread is None:
        return "-"
    digits = 2 if name == "psnr" else 4
    deviation = "" if spread["sd"] is None else f" ({spread['sd']:.{digits}f})"
    return f"{spread['mean']:.{digits}f}{deviation}"
