"""report.html: a self-contained page with every table and picture of a report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from glsplat.extras.evaluate.frames import MAX_SHARE, Quiet
from glsplat.extras.evaluate.precision import VISIBLE_LPIPS, VISIBLE_PSNR, advice

from ..page import document, escaped, image_of, number_of, table_of

_DENSE = (
    "Drawn with at most eight joints per splat; the reference has all joints of the nearest triangle of the person's "
    "mesh."
)


def page(result: Mapping[str, Any], pictures: Mapping[str, bytes]) -> str:
    """Return the document; ``pictures`` are PNG by file name, also written beside it."""
    failed = [row for row in result["stability"] if row["verdict"] != "holds"]
    quiet = Quiet(**result["quiet"])
    versions = ", ".join(f"{name} {version}" for name, version in result["versions"].items())
    frames = f"{result['frames']} frames per setting ({result['frames_left_out']} in section 2)"
    facts = [
        f"Driver: {result['driver']} ({result['backend']})",
        f"Machine: {result['machine']}, {result['cores']} cores",
        f"Versions: {versions}; commit {result['commit'] or 'unknown'}; {result['date']} (UTC)",
        f"{frames}, settings interleaved frame by frame" + ("; a quick run" if result["quick"] else ""),
        f"Quiet: {quiet.words}" + ("" if quiet.ok else f"; above {MAX_SHARE:.0%}: compare CPU times only"),
        f"Stability: {len(result['stability']) - len(failed)} of {len(result['stability'])} cases hold",
    ]
    parts = ["<h1>Error against run time</h1><ul>", *(f"<li>{escaped(fact)}</li>" for fact in facts), "</ul>"]
    parts.append(
        "<p>Errors are against pictures computed in float64; times are whole frames with 8-bit output, read back. "
        "Timings of one run are comparable; machines are not.</p>"
    )
    parts.append("<h2>1. Error against run time</h2>")
    for scene in result["scenes"]:
        parts += _scene(scene, pictures)
    parts += _left_out(result, pictures)
    parts += _stability(result["stability"])
    parts += _advice(result["scenes"], result["driver"])
    return document("glsplat report", "".join(parts))


def _scene(scene: Mapping[str, Any], pictures: Mapping[str, bytes]) -> list[str]:
    width, height = scene["size"]
    heading = f"{scene['scene']}: {scene['splats']:,} splats, {scene['views']} x {width}x{height}"
    rows = sorted((row for row in scene["rows"] if row["flip"] is not None), key=lambda row: row["ms"])
    table = []
    for row in rows:
        interval = f"{row['low']:.1f} to {row['high']:.1f}"
        lpips = "" if row["lpips"] is None else row["lpips"]
        errors = [row["psnr"], row["maximum"], row["flip"], lpips]
        table.append([row["words"], row["ms"], interval, row["cpu_ms"], *errors, ", ".join(row["marks"])])
    names = ["setting", "ms, median", "95 %", "ms of CPU", "PSNR (dB)", "maximum error", "FLIP", "LPIPS", "default of"]
    return [
        f"<h3>{escaped(heading)}</h3>",
        *([f"<p>{_DENSE}</p>"] if scene["dense_truth"] else []),
        image_of(pictures, scene["plot"]),
        f"<p>{len(scene['searched'])} combinations searched, {len(scene['rows'])} measured over {scene['frames']} "
        f"frames; {escaped(Quiet(**scene['quiet']).words)}. The table has the fronts and the defaults.</p>",
        table_of(names, table, ["front" if row["front"] else "" for row in rows]),
    ]


def _advice(scenes: Sequence[Mapping[str, Any]], driver: str) -> list[str]:
    out = [
        f"<h2>4. What to use on {escaped(driver)}</h2><p>The cheapest measured settings whose error is not visible: "
    ]
    out.append(f"LPIPS up to {VISIBLE_LPIPS:g}, or without its weights PSNR from {VISIBLE_PSNR:g} dB.</p>")
    for scene in scenes:
        for name, (words, row) in advice(scene).items():
            pasted = f"glsplat render {' '.join(words)}" if name == "render" else "\n".join(words)
            where = "" if name == "render" else " (server.toml of glsplat serve --config)"
            error = f"{row['psnr']:.1f} dB" + ("" if row["lpips"] is None else f", LPIPS {row['lpips']:.4f}")
            seen = "; all errors are visible, this is the smallest" if row["visible"] else ""
            text = f"For {scene['scene']} use{where}: {row['ms']:.1f} ms, {error}{seen}"
            out.append(f"<p>{escaped(text)}</p><pre>{escaped(pasted)}</pre>")
    return out


def _left_out(result: Mapping[str, Any], pictures: Mapping[str, bytes]) -> list[str]:
    rows = []
    for row in result["left_out"]:
        lean, full = row["lean"], row["full"]
        cpu = f"{number_of(lean['ms']['cpu'])} / {number_of(full['ms']['cpu'])}"
        times = [lean["ms"]["median"], full["ms"]["median"], cpu, row["cost"]]
        counts = [f"{lean[key]} / {full[key]}" for key in ("programs", "buffers")]
        more = " ".join(stage for stage in full["passes"] if stage not in lean["passes"]) or "-"
        sizes = [_bytes(side["bytes"], result["left_out_splats"]) for side in (lean, full)]
        apart = f"{row['apart']:.1e}" + ("" if row["same_picture"] else " (NOT one picture)")
        rows.append([row["feature"], row["how"], *times, *counts, more, *sizes, apart])
    names = ["feature", "present but unused", "without (ms)", "with (ms)", "ms of CPU", "cost"]
    names += ["programs", "buffers", "more passes"]
    names += ["bytes per splat without", "with", "difference of pictures"]
    still = result["unmoved"]
    rest = [
        [name, still[f"{name}_ms"]["median"], still[f"{name}_ms"]["cpu"], " ".join(still[f"{name}_passes"])]
        for name in ("moved", "unmoved")
    ]
    return [
        "<h2>2. What is left out</h2>",
        image_of(pictures, "left_out.png"),
        table_of(names, rows),
        f"<p>Passes of a frame of {escaped(still['scene'])}:</p>",
        table_of(["frame", "ms, median", "ms of CPU", "passes"], rest),
    ]


def _stability(cases: Sequence[Mapping[str, Any]]) -> list[str]:
    rows = []
    for case in cases:
        compared = case["error"] is not None or case["unit"]
        error = f"{number_of(case['error'])} {case['unit']}" if compared else ""
        rows.append(
            [case["group"], case["case"], case["input"], case["behaviour"], case["seen"], error, case["verdict"]]
        )
    names = ["of", "case", "input", "stated behaviour", "seen", "largest error, or what was measured", "verdict"]
    classes = ["" if case["verdict"] == "holds" else "failed" for case in cases]
    return ["<h2>3. Stability</h2><p>All rows were run for this report.</p>", table_of(names, rows, classes)]


def _bytes(sizes: Mapping[str, int], splats: int) -> str:
    return f"{(sizes['splats'] + sizes['sh'] + sizes['work']) / max(splats, 1):.0f}"
