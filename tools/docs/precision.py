"""Write docs/measured/work-precision.md: time against error of the settings that a user can choose.

    glsplat avatar photo PICTURE --steps 0 -o out/person.glb
    python -m tools.docs.measured precision --person out/person.glb --minutes 20

Results of a quiet machine are kept in out/measured/precision; another run of the same commit resumes there.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from textwrap import fill
from typing import Any

from apps.report.plots import precision_plot
from glsplat.errors import GlsplatError
from glsplat.extras.evaluate.frames import MAX_SHARE, Quiet
from glsplat.extras.evaluate.precision import VISIBLE_LPIPS, VISIBLE_PSNR, Way, advice, lpips_if_there, measure
from glsplat.extras.evaluate.subjects import Subject, subjects_of
from glsplat.gl.context import create_context
from glsplat.io.files import replace_file
from glsplat.io.provenance import commit
from tests.conftest import SHARED_DATA

SIZES = {512: 16, 1024: 8}
"""Measured frames by picture side in pixels; the larger size measures the candidates of the smaller one."""

MOST_ROWS = 12  # of a table


def scenes(person: Path) -> dict[str, tuple[str | None, int]]:
    """Return (file, index of its subject) by name."""
    splats = SHARED_DATA / "splats"
    return {
        "avatar": (None, 0),
        "moving": (None, 1),
        "person": (str(person), 1),
        "plant": (str(splats / "plant.ply"), 0),
        "playbot": (str(splats / "playbot_lod3.ply"), 0),
    }


def measured(folder: Path, person: Path, minutes: float) -> dict[str, list[dict[str, Any]]]:
    """Return results for each size by name, of the scenes that were measured within ``minutes``.

    Raises GlsplatError if the machine is not quiet, or if no scene was measured in time.
    """
    if not person.exists():
        raise GlsplatError(
            f"{person}: no such avatar; make it by glsplat avatar photo PICTURE --steps 0, or --person FILE"
        )
    end, context = time.monotonic() + 60 * minutes, create_context()
    out: dict[str, list[dict[str, Any]]] = {}
    lpips = lpips_if_there()
    folder.mkdir(parents=True, exist_ok=True)
    for name, (file, index) in scenes(person).items():
        out[name] = []
        for size, frames in SIZES.items():
            kept = folder / f"{name}-{size}-{commit()}.json"
            if not kept.exists():
                if time.monotonic() > end:
                    print(f"{minutes:g} minutes are over before {kept.stem}; run the command again", file=sys.stderr)
                    context.release()
                    found = {name: sizes for name, sizes in out.items() if sizes}
                    if not found:
                        raise GlsplatError(f"{minutes:g} minutes are over before a scene was measured")
                    return found
                seeds = [_way(way) for way in out[name][0]["candidates"]] if out[name] else []
                subject: Subject = subjects_of(file, size)[index]
                start = time.perf_counter(), time.process_time()
                result = measure(
                    context, subject, frames, lpips, seeds, lambda text: print(f"  {text}", file=sys.stderr)
                )
                spent = time.perf_counter() - start[0], time.process_time() - start[1]
                quiet = Quiet(**result["quiet"])
                print(f"{kept.stem}: {spent[0]:.0f} s, {spent[1]:.0f} s of CPU; {quiet.words}", file=sys.stderr)
                check_quiet(kept.stem, quiet)
                replace_file(kept, [json.dumps(result).encode()])
            out[name].append(json.loads(kept.read_text(encoding="utf-8")))
    context.release()
    return out


def check_quiet(name: str, quiet: Quiet) -> None:
    """Raise GlsplatError unless the machine was quiet."""
    if not quiet.ok:
        raise GlsplatError(
            f"{name}: not written: expected a quiet machine (at most {MAX_SHARE:.0%}), got: {quiet.words}; "
            "end other programs and run the command again"
        )


def page(results: dict[str, list[dict[str, Any]]], images: Path) -> Iterator[tuple[str, str, str]]:
    """Write the pictures and yield name, description and Markdown of each table."""
    for name, sizes in results.items():
        picture = f"precision-{name}.png"
        replace_file(images / picture, [precision_plot(sizes)])
        for index, result in enumerate(sizes):
            width, height = result["size"]
            about = (
                f"{result['scene']}, {result['splats']:,} splats, {result['views']} x {width} x {height} pixels, "
                f"{result['frames']} frames; {Quiet(**result['quiet']).words}."
            )
            image = f"\n\n![{result['scene']}](../images/{picture})" if index == len(sizes) - 1 else ""
            text = fill(use(result) + off_front(result["rows"]), 99, break_on_hyphens=False)
            yield f"{name}-{width}", about, f"{table(result['rows'])}\n\n{text}{image}"


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Return Markdown of the defaults of ``render`` and ``serve`` and of the fronts, at most MOST_ROWS."""
    marked = [row for row in rows if row["flip"] is not None and {"render", "serve"} & set(row["marks"])]
    front = [row for row in rows if row["front"] and row["flip"] is not None and row not in marked]
    front.sort(key=lambda row: row["ms"])
    space = max(1, MOST_ROWS - len(marked))
    step = max(1.0, (len(front) - 1) / max(1, space - 1))
    chosen = [front[round(i * step)] for i in range(min(space, len(front)))]
    lines = ["| setting | ms | 95 % | ms of CPU | PSNR, dB | FLIP | LPIPS | |", "|---|--:|--:|--:|--:|--:|--:|---|"]
    for row in sorted([*marked, *chosen], key=lambda row: row["ms"]):
        lpips = "" if row["lpips"] is None else f"{row['lpips']:.4f}"
        notes = [f"default of `{mark}`" for mark in row["marks"]] + (["front"] if row["front"] else [])
        times = (f"{row['ms']:.1f}", f"{row['low']:.1f} - {row['high']:.1f}", f"{row['cpu_ms']:.1f}")
        cells = (row["words"], *times, f"{row['psnr']:.1f}", f"{row['flip']:.4f}", lpips, ", ".join(notes))
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def use(result: dict[str, Any]) -> str:
    """Return the options to paste as a paragraph."""
    parts = []
    for name, (words, row) in advice(result).items():
        pasted = (
            f"`glsplat render{''.join(f' {word}' for word in words)}`"
            if name == "render"
            else ("`glsplat serve` with " + ", ".join(f"`{line}`" for line in words))
        )
        parts.append(f"{pasted} ({row['ms']:.1f} ms{', visible' if row['visible'] else ''})")
    return "Use " + ", ".join(parts) + "." if parts else ""


def off_front(rows: Sequence[dict[str, Any]]) -> str:
    """Return a sentence for each drawn default that is slower, by more than noise, than a setting of no less PSNR."""
    drawn, found = [row for row in rows if row["way"]["jpeg"] is None], ""
    for row in drawn:
        if row["marks"] and not row["front"]:
            better = min((r for r in drawn if r["front"] and r["psnr"] >= row["psnr"]), key=lambda r: r["ms"])
            faster, closer = row["ms"] / better["ms"] - 1, better["psnr"] - row["psnr"]
            if faster > MAX_SHARE:
                found += (
                    f" Off the front: `{row['words']}` of `{row['marks'][0]}`; `{better['words']}` is {faster:.0%} "
                    f"faster and {closer:.1f} dB closer."
                )
    return found


def about_errors() -> str:
    """Return the text that explains the page's errors."""
    return (
        "Settings take turns frame by frame; a time is the median ratio to the default of the same turn. Errors are "
        "against `glsplat/reference.py` in float64, in the box that the scene covers, of frame 31: PSNR of both views' "
        "float picture (a JPEG: decoded), FLIP and LPIPS (AlexNet) of the left one. An error is not visible up to "
        f"LPIPS {VISIBLE_LPIPS:g}, or without weights from {VISIBLE_PSNR:g} dB. Level of detail: `level 1` and "
        "coarser. The settings of `serve` hold for every scene: 2 sigma would cost 7 to 10 dB, and sorting less often "
        "gains less than the intervals. `--fps` changes what can be changed while pictures are sent: the level, then "
        "the size; an avatar without levels, as a fresh one from a photograph, has the size alone."
    )


def _way(values: dict[str, Any]) -> Way:
    return Way(**{**values, "jpeg": values["jpeg"] and tuple(values["jpeg"])})
