"""evaluation.html: a self-contained page with every table and contact sheet of a comparison."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from glsplat.extras.evaluate.comparison.measure import BOXED, MEASURES, OVERLAP, PARTED
from glsplat.extras.evaluate.comparison.performance import CONTROLS

from ..page import document, escaped, image_of, table_of
from .outcome import LOWER, NAMES

_BY = {"tracking": "head and hands, through the solver", "pose": "the true pose"}
_ROLES = {
    "photo": "one photograph to splats (the paper's own role)",
    "mesh-image": "one photograph to a textured mesh (the paper's image-based role)",
    "mesh-video": "a turning video to a textured mesh (the paper's video-based role)",
    "scan": "the participant's own mesh to splats (no part in the paper)",
}


def page(found: Mapping[str, Any], pictures: Mapping[str, bytes]) -> str:
    """Return the document; ``pictures`` are PNG and JPEG by file name."""
    parts = ["<h1>Avatars compared</h1>", *_facts(found)]
    for control in CONTROLS:
        rows = [row for row in found["table1"] if row["control"] == control]
        parts += [f"<h2>Table 1, driven by {escaped(_BY[control])}</h2>", _table1(rows, found)]
    parts += _failures(found["failures"])
    parts += _statistics(found["statistics"])
    parts += _along("By side", "view", found["views"])
    parts += _parts(found["parts"])
    parts += _along("By pose", "moment", found["moments"])
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


def _failures(rows: Sequence[Mapping[str, str]]) -> list[str]:
    if not rows:
        return []
    lines = [[row["participant"], row["method"], row["why"]] for row in rows]
    classes = ["failed"] * len(lines)
    return ["<h2>What failed</h2>", table_of(["participant", "method", "why"], lines, classes)]


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


def _along(title: str, key: str, rows: Sequence[Mapping[str, Any]]) -> list[str]:
    measures = [*MEASURES, *BOXED, OVERLAP]
    out = [f"<h2>{escaped(title)}</h2>"]
    for control in CONTROLS:
        lines = [
            [row[key], row["method"], row[measures[0]]["n"], *(spread_text(row[name], name) for name in measures)]
            for row in sorted((r for r in rows if r["control"] == control), key=lambda r: _place(rows, key, r[key]))
        ]
        out += [f"<h3>Driven by {escaped(_BY[control])}</h3>"]
        out.append(table_of([key, "method", "n", *(_head(name) for name in measures)], lines))
    return out


def _parts(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    out = ["<h2>By body part</h2><p>Over the pixels nearest to the part, in pictures that show it.</p>"]
    for control in CONTROLS:
        mine = sorted((r for r in rows if r["control"] == control), key=lambda r: _place(rows, "part", r["part"]))
        lines = [
            [row["part"], row["method"], row["l1"]["n"], *(spread_text(row[name], name) for name in PARTED)]
            for row in mine
        ]
        out += [f"<h3>Driven by {escaped(_BY[control])}</h3>"]
        out.append(table_of(["part", "method", "n", *(_head(name) for name in PARTED)], lines))
    return out


def _timing(timing: Mapping[str, Any]) -> list[str]:
    if not timing:
        return []
    heads = ["method", "pixels an eye", "both eyes at once (ms)", "two renders (ms)", "gain", "pairs a second"]
    heads += ["triangles or splats", "GPU memory (MB)", "LPIPS at this size", "paper: batched (ms)", "paper: gain"]
    lines = []
    for row in timing["costs"]:
        paper = row.get("paper", {})
        lines.append(
            [
                row["method"],
                f"{row['size']} x {row['size']}",
                row["pair_ms"],
                row["two_ms"],
                round(row["two_ms"] / row["pair_ms"], 2),
                round(1000 / row["pair_ms"], 1),
                f"{row['count']:,} {row['kind']}",
                row["bytes"] / 1e6,
                row["lpips"],
                paper.get("pair_ms", ""),
                paper.get("gain", ""),
            ]
        )
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


def spread_text(spread: Mapping[str, Any] | None, name: str) -> str:
    """Return mean and standard deviation as text of a table."""
    if spread is None:
        return "-"
    digits = 2 if name.endswith("psnr") else 4
    deviation = "" if spread["sd"] is None else f" ± {spread['sd']:.{digits}f}"
    return f"{spread['mean']:.{digits}f}{deviation}"


def _head(name: str) -> str:
    return f"{NAMES[name]} {'↓' if name in LOWER else '↑'}"


def _place(rows: Sequence[Mapping[str, Any]], key: str, value: str) -> int:
    return list(dict.fromkeys(row[key] for row in rows)).index(value)
