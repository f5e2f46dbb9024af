"""The outcome of a comparison: one JSON object, a table as text, plots, and evaluation.html, a self-contained page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from glsplat.extras.evaluate.comparison import tables
from glsplat.extras.evaluate.comparison.measure import BOXED, MEASURES, OVERLAP, PARTED
from glsplat.extras.evaluate.comparison.participant import Participant
from glsplat.extras.evaluate.comparison.protocol import CONTROLS, Protocol
from glsplat.extras.evaluate.comparison.work import Result
from glsplat.io.provenance import machine

from ..page import document, escaped, image_of, table_of

LOWER = ("l1", "lpips", "box_l1", "flip", "lpips-vgg")  # measures for which smaller is better

NAMES = {"l1": "L1", "lpips": "LPIPS", "psnr": "PSNR (dB)", "ssim": "SSIM", "flip": "FLIP", "lpips-vgg": "LPIPS, VGG"}
NAMES |= {"box_l1": "L1, box", "box_psnr": "PSNR, box (dB)", "box_ssim": "SSIM, box", OVERLAP: "overlap"}
"""Display names of measures."""

_BY = {"tracking": "head and hands, through the solver", "pose": "the true pose"}
_ROLES = {
    "photo": "one photograph to splats (the paper's own role)",
    "mesh-image": "one photograph to a textured mesh (the paper's image-based role)",
    "mesh-video": "a turning video to a textured mesh (the paper's video-based role)",
    "scan": "the participant's own mesh to splats (no part in the paper)",
}

_ALL = (*MEASURES, *BOXED, OVERLAP)


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
        "views": tables.along(results, methods, "view"),
        "parts": tables.along(results, methods, "part"),
        "moments": tables.along(results, methods, "moment"),
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
                cells = "".join(f"{spread_text(row[name], name, ' ({})'):>18}" for name in MEASURES)
                lines.append(f"  {row['method']:14}{cells}   {row['n']} of {row['of']}")
    lines += [f"failed: {row['participant']}, {row['method']}: {row['why']}" for row in found["failures"]]
    return lines


def page(found: Mapping[str, Any], pictures: Mapping[str, bytes]) -> str:
    """Return the document; ``pictures`` are PNG and JPEG by file name."""
    parts = ["<h1>Avatars compared</h1>", *_facts(found)]
    for control in CONTROLS:
        rows = [row for row in found["table1"] if row["control"] == control]
        parts += [f"<h2>Table 1, driven by {escaped(_BY[control])}</h2>", _table1(rows, found)]
    if found["failures"]:
        lines = [[row["participant"], row["method"], row["why"]] for row in found["failures"]]
        parts += ["<h2>What failed</h2>", table_of(["participant", "method", "why"], lines, ["failed"] * len(lines))]
    parts += _statistics(found["statistics"])
    parts += ["<h2>By side</h2>", *_along("view", found["views"], _ALL)]
    parts += ["<h2>By body part</h2><p>Over the pixels nearest to the part, in pictures that show it.</p>"]
    parts += _along("part", found["parts"], PARTED)
    parts += ["<h2>By pose</h2>", *_along("moment", found["moments"], _ALL)]
    parts += [image_of(pictures, name) for name in sorted(pictures) if name.endswith(".png")]
    parts += _timing(found["timing"])
    parts += _people(found["participants"])
    parts += _sheets(found["participants"], pictures)
    return document("glsplat evaluate", "".join(parts))


def _facts(found: Mapping[str, Any]) -> list[str]:
    protocol = found["protocol"]
    versions = ", ".join(f"{name} {version}" for name, version in found["versions"].items())
    what = (
        f"{protocol['moments']} moments of {protocol['motion']}" if protocol["motion"] else ", ".join(protocol["tasks"])
    )
    light = "lit as in their photographs" if protocol["light"] == "capture" else "in their textures' own colours"
    facts = [
        f"{len(found['people'])} participants: {', '.join(found['people'])}",
        *(f"{name}: {_ROLES.get(name, 'of your own')}" for name in found["methods"]),
        f"Poses: {what}; sides: {', '.join(protocol['views'])}; both eyes, {protocol['size']}² each, the figure "
        f"{protocol['fill']:.0%} of the picture, on black; the participants {light}",
        f"Driver: {'; '.join(found['drivers']) or 'none'}",
        f"Machine: {found['machine']}, {found['cores']} cores",
        f"Versions: {versions}; results by glsplat {'; '.join(found['made_by']) or 'none'}; {found['date']} (UTC)"
        + ("; a quick run" if found["options"]["quick"] else ""),
    ]
    return ["<ul>", *(f"<li>{escaped(fact)}</li>" for fact in facts), "</ul>"]


def _table1(rows: Sequence[Mapping[str, Any]], found: Mapping[str, Any]) -> str:
    extra = [name for name in ("flip", "lpips-vgg") if any(name in row for row in rows)]
    measures = [*MEASURES, *extra, *BOXED, OVERLAP]
    heads = ["method", *(_head(name) for name in measures), "participants", *(f"paper: {NAMES[n]}" for n in MEASURES)]
    lines = []
    for row in rows:
        paper = row.get("paper", {})
        cells = [spread_text(row.get(name), name) for name in measures]
        lines.append([row["method"], *cells, f"{row['n']} of {row['of']}", *(paper.get(name, "") for name in MEASURES)])
    note = (
        "Mean and standard deviation over participants of each one's mean, over the whole square or the box around "
        "the participant. The paper's figures are of photographs of 24 other people in poses and crops that it does "
        "not state: compare orders, not numbers."
    )
    return table_of(heads, lines) + f"<p>{escaped(note)}</p>"


def _statistics(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    heads = ["measure", "first", "second", "n", "difference", "95 % interval", "effect", "p", "p, Holm"]
    out = ["<h2>Methods in pairs</h2>"]
    out.append(
        "<p>Differences (first - second) over common participants: mean, its bootstrap interval, the matched-pairs "
        "rank-biserial correlation, and Wilcoxon's signed-rank test, corrected by Holm for the pairs of a "
        "measure.</p>"
    )
    for control in CONTROLS:
        lines = []
        shown = (*MEASURES, OVERLAP)  # the JSON has all
        for row in (row for row in rows if row["control"] == control and row["n"] and row["measure"] in shown):
            digits = 2 if row["measure"].endswith("psnr") else 4
            low, high = row["low"], row["high"]
            interval = "-" if low is None else f"{low:+.{digits}f} to {high:+.{digits}f}"
            sure = ["-" if row[key] is None else f"{row[key]:.2g}" for key in ("p", "p_holm")]
            effect = "-" if row["effect"] is None else f"{row['effect']:+.2f}"
            names = [_head(row["measure"]), row["first"], row["second"], row["n"]]
            lines.append([*names, f"{row['mean']:+.{digits}f}", interval, effect, *sure])
        out += [f"<h3>Driven by {escaped(_BY[control])}</h3>", table_of(heads, lines)]
    return out


def _along(key: str, rows: Sequence[Mapping[str, Any]], measures: Sequence[str]) -> list[str]:
    """Return the tables by side, pose or body part; groups are in the order of their first row."""
    order = list(dict.fromkeys(row[key] for row in rows))
    out = []
    for control in CONTROLS:
        own = sorted((row for row in rows if row["control"] == control), key=lambda row: order.index(row[key]))
        lines = [
            [row[key], row["method"], row[measures[0]]["n"], *(spread_text(row[name], name) for name in measures)]
            for row in own
        ]
        heads = [key, "method", "n", *(_head(name) for name in measures)]
        out += [f"<h3>Driven by {escaped(_BY[control])}</h3>", table_of(heads, lines)]
    return out


def _timing(timing: Mapping[str, Any]) -> list[str]:
    if not timing:
        return []
    heads = ["method", "pixels an eye", "both eyes at once (ms)", "two renders (ms)", "gain", "pairs a second"]
    heads += ["triangles or splats", "GPU memory (MB)", "LPIPS at this size", "paper: batched (ms)", "paper: gain"]
    lines = []
    for row in timing["costs"]:
        paper = row.get("paper", {})
        gain, pairs = round(row["two_ms"] / row["pair_ms"], 2), round(1000 / row["pair_ms"], 1)
        times = [row["pair_ms"], row["two_ms"], gain, pairs]
        size = [f"{row['count']:,} {row['kind']}", row["bytes"] / 1e6, row["lpips"]]
        published = [paper.get("pair_ms", ""), paper.get("gain", "")]
        lines.append([row["method"], f"{row['size']} x {row['size']}", *times, *size, *published])
    out = [
        f"<h2>Table 2: rendering time and memory ({escaped(timing['participant'])})</h2>",
        "<p>Medians of interleaved frames on this driver, read back. Both eyes of splats are one draw; those of a mesh "
        "are drawn in turn within one call. LPIPS is of the left eye from the front, over the tasks, in the true pose. "
        "The paper's figures are of its authors' GPU.</p>",
        table_of(heads, lines),
    ]
    for latency in timing["latency"]:
        head, *rows = latency["rows"]
        out += [f"<h2>Latency, {escaped(latency['method'])} (ms)</h2>", table_of(head, rows)]
    return out


def _people(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    heads = ["participant", "method", "made in (s)", "file (MB)", "of"]
    heads += [
        f"{NAMES[name]}, {'tracked' if control == 'tracking' else 'posed'}" for control in CONTROLS for name in MEASURES
    ]
    lines, classes = [], []
    for row in rows:
        classes.append("failed" if "failed" in row else "")
        if "failed" in row:
            lines.append([row["participant"], row["method"], row["failed"], *[""] * (len(heads) - 3)])
            continue
        made = row["product"]
        seconds = "elsewhere" if made["seconds"] is None else made["seconds"]
        size = "" if made["bytes"] is None else made["bytes"] / 1e6
        values = [row[control][name] for control in CONTROLS for name in MEASURES]
        lines.append([row["participant"], row["method"], seconds, size, f"{made['count']:,} {made['kind']}", *values])
    return ["<h2>Participants</h2>", table_of(heads, lines, classes)]


def _sheets(rows: Sequence[Mapping[str, Any]], pictures: Mapping[str, bytes]) -> list[str]:
    out = ["<h2>Contact sheets</h2>"]
    for row in rows:
        name = f"sheets/{row['method']}/{row['participant']}.jpg"
        if name in pictures:
            title = f"{escaped(row['participant'])}, {escaped(row['method'])}"
            out.append(f"<details><summary>{title}</summary>{image_of(pictures, name)}</details>")
    return out


def spread_text(spread: Mapping[str, Any] | None, name: str, deviation: str = " ± {}") -> str:
    """Return mean and standard deviation as text of a table."""
    if spread is None:
        return "-"
    digits = 2 if name.endswith("psnr") else 4
    mean = f"{spread['mean']:.{digits}f}"
    return mean if spread["sd"] is None else mean + deviation.format(f"{spread['sd']:.{digits}f}")


def _head(name: str) -> str:
    return f"{NAMES[name]} {'↓' if name in LOWER else '↑'}"
