"""``glsplat tracking bench``: score solvers on whole motions against baselines; the table of docs/tracking.md."""

from __future__ import annotations

import argparse
import json
import platform
import re
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from glsplat.extras.evaluate.tracking_score import SOLVERS, WINDOW, Row, mean_score, rows_of
from glsplat.extras.learned.network import load_network
from glsplat.formats.motion_files import embedded_motions
from glsplat.tracking.config import TrackerConfig

from ..args import motion_of
from ..progress import each
from ..usage import UsageError
from .options import add_skeleton, pattern_of, skeleton_of

FAULT = 2.0  # cm by which ten seconds are worse than the naive baseline has them, to be looked at


def add_bench(commands: Any) -> None:
    """Add the options of the subcommand."""
    command = commands.add_parser("bench", help="score motions against baselines")
    command.add_argument("motions", nargs="*", metavar="MOTION", help="motion files or names (default: the embedded)")
    command.add_argument("--rates", default="30,72,90", help="samples a second, separated by commas")
    command.add_argument("--no-filter", action="store_true", help="switch the One Euro filters off")
    command.add_argument("--model", metavar="MODEL.npz", help="network of the learned solver, as made by train")
    command.add_argument(
        "--groups",
        metavar="REGEX",
        help="means of groups of clips too: by what the first bracket finds in their names (subjects, kinds)",
    )
    command.add_argument("--brief", action="store_true", help="print the means only")
    command.add_argument("--json", action="store_true", help="print the numbers as JSON")
    add_skeleton(command)
    command.set_defaults(work=bench)


def bench(args: argparse.Namespace) -> int:
    """Score all solvers and print the table."""
    try:
        rates = [float(rate) for rate in args.rates.split(",")]
    except ValueError:
        raise UsageError(f"--rates needs numbers separated by commas, not {args.rates!r}") from None
    groups = pattern_of(args.groups, "--groups") if args.groups else None
    skeleton = skeleton_of(args.avatar)
    network = load_network(args.model) if args.model else None
    config = TrackerConfig.raw() if args.no_filter else TrackerConfig()
    motions = [(Path(name).stem, motion_of(name, skeleton, "MOTION")) for name in args.motions or embedded_motions()]
    rows: list[Row] = []
    jobs = [(name, motion, rate) for rate in rates for name, motion in motions]
    for name, motion, rate in each(jobs, "clips"):
        rows += rows_of(name, motion, rate, skeleton, config, network)
    text = table(rows, args.brief, groups, {Path(name).stem: name for name in args.motions})
    if args.json:
        rows_json = [
            {
                **{"clip": r.clip, "rate": r.rate, "solver": r.solver, "ms": _known(r.milliseconds)},
                **r.score.to_json(),
                "windows": r.windows,
                "said": _known(r.said),
            }
            for r in rows
        ]
        print(json.dumps(rows_json))
    else:
        print(text)
    return 0


def table(
    rows: list[Row],
    brief: bool = False,
    groups: re.Pattern[str] | None = None,
    files: Mapping[str, str] | None = None,
) -> str:
    """Return Markdown: clips at each rate (unless brief), means of groups and of all, weighted by frames.

    Below are the clips with the learned solver much worse than the naive baseline, and commands that draw them
    (``files`` of clips).
    """
    head = (
        "| clip | Hz | solver | MPJPE cm | said | 95 % | upper | lower | root | hands | fingers | MPJRE deg "
        "| MPJVE cm/s | jitter / truth | skate / truth cm/s | under floor cm | ms |"
    )
    lines = [head, "|" + " --- |" * 17]
    lines += [] if brief else [_line(row) for row in rows]
    group = {
        row.clip: found[1 if found.re.groups else 0] for row in rows if groups and (found := groups.search(row.clip))
    }
    for rate in dict.fromkeys(row.rate for row in rows):
        for name in (*sorted(set(group.values())), None):
            for solver in SOLVERS:
                same = [row for row in rows if row.rate == rate and row.solver == solver]
                lines.append(_line(_mean([row for row in same if name in (None, group.get(row.clip))], name or "all")))
    where = f"Python {platform.python_version()}, numpy {np.__version__}, {platform.machine()}"
    lines += [
        "",
        "Said: the error that the solver itself expects. 95 %: of means over ten seconds. "
        f"Times: median a sample, one core, fingers included ({where}).",
    ]
    return "\n".join([*lines, "", *_faults(rows, files or {})])


def _mean(rows: list[Row], name: str) -> Row:
    """Return the mean of rows of one rate and solver, weighted by frames."""
    windows = tuple([part for row in rows for part in row.windows])
    said = float(np.average([row.said for row in rows], weights=[row.score.frames for row in rows]))
    spent = float(np.median([row.milliseconds for row in rows]))
    return Row(
        f"**{name}**", rows[0].rate, rows[0].solver, mean_score([row.score for row in rows]), spent, windows, said
    )


def _faults(rows: list[Row], files: Mapping[str, str]) -> list[str]:
    """Return a line for each ten seconds with the learned solver worse than the naive one by FAULT."""
    naive = {(row.clip, row.rate): row.windows for row in rows if row.solver == "naive"}
    out = []
    for row in rows:
        seconds = row.score.frames / row.rate / len(row.windows)
        for i, (ours, theirs) in enumerate(zip(row.windows, naive[row.clip, row.rate], strict=True)):
            if row.solver == "learned" and ours > theirs + FAULT:
                which = f"--motion {shlex.quote(files.get(row.clip, row.clip))} --rate {row.rate:g}"
                out.append(
                    f"- {row.clip}, {row.rate:g} Hz, from {i * seconds:.1f} s: {ours:.1f} cm, naive {theirs:.1f}: "
                    f"`glsplat tracking show {which} --from {i * seconds:.1f} --seconds {seconds:.1f} -o window.png`"
                )
    head = f"{WINDOW:g} seconds that the learned solver has more than {FAULT:g} cm worse than the naive one:"
    return [head, "", *out] if out else [f"{head} none."]


def _line(row: Row) -> str:
    s = row.score
    cells = (
        *(row.clip, f"{row.rate:g}", row.solver, f"{s.mpjpe:.2f}", "-" if row.said != row.said else f"{row.said:.2f}"),
        *(f"{np.percentile(row.windows, 95):.2f}", f"{s.upper:.2f}", f"{s.lower:.2f}", f"{s.root:.2f}"),
        *(f"{s.hands:.2f}", f"{s.fingers:.2f}", "-" if s.mpjre != s.mpjre else f"{s.mpjre:.1f}", f"{s.mpjve:.1f}"),
        *(f"{s.jitter:.1f} / {s.jitter_truth:.1f}", f"{s.skate:.1f} / {s.skate_truth:.1f}", f"{s.penetration:.2f}"),
        "-" if row.milliseconds != row.milliseconds else f"{row.milliseconds:.2f}",
    )
    return "| " + " | ".join(cells) + " |"


def _known(value: float) -> float | None:
    return None if value != value else value
