"""``glsplat tracking bench``: scores on whole motions against two baselines, and the table of docs/tracking.md."""

from __future__ import annotations

import argparse
import json
import platform
import sys
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from glsplat.errors import FormatError
from glsplat.evaluate.tracking_rows import SOLVERS, Row, rows_of
from glsplat.evaluate.tracking_score import mean_score
from glsplat.io.files import replace_file
from glsplat.motion.motion import embedded_motions
from glsplat.tracking.learned.network import load_network
from glsplat.tracking.tracker import TrackerConfig

from ..args import motion_of
from ..usage import UsageError
from .options import add_skeleton, skeleton_of

__all__ = ["add_bench"]

BEGIN, END = "<!-- scores: begin -->", "<!-- scores: end -->"


def add_bench(commands: Any) -> None:
    """The subcommand's options."""
    command = commands.add_parser("bench", help="score motions against two baselines; writes the table")
    command.add_argument("motions", nargs="*", metavar="MOTION", help="motion files or names (default: the embedded)")
    command.add_argument("--rates", default="30,72,90", help="samples a second, separated by commas")
    command.add_argument("--no-filter", action="store_true", help="switch the One Euro filters off")
    command.add_argument("--model", metavar="MODEL.npz", help="network of the learned solver, as made by train")
    command.add_argument("--brief", action="store_true", help="print the means only")
    command.add_argument("--table", metavar="FILE.md", help="put the table between the marks of this file")
    command.add_argument("--json", action="store_true", help="print the numbers as JSON")
    add_skeleton(command)
    command.set_defaults(work=bench)


def bench(args: argparse.Namespace) -> int:
    """Score everything, print the table."""
    try:
        rates = [float(rate) for rate in args.rates.split(",")]
    except ValueError:
        raise UsageError(f"--rates needs numbers separated by commas, not {args.rates!r}") from None
    skeleton = skeleton_of(args.avatar)
    network = load_network(args.model) if args.model else None
    config = TrackerConfig.raw() if args.no_filter else TrackerConfig()
    motions = [(Path(name).stem, motion_of(name, skeleton, "MOTION")) for name in args.motions or embedded_motions()]
    rows: list[Row] = []
    jobs = [(name, motion, rate) for rate in rates for name, motion in motions]
    for name, motion, rate in tqdm(jobs, unit="clip", disable=not sys.stderr.isatty(), leave=False):
        rows += rows_of(name, motion, rate, skeleton, config, network)
    text = table(rows, args.brief)
    if args.table:
        insert(Path(args.table), text)
    if args.json:
        rows_json = [
            {"clip": r.clip, "rate": r.rate, "solver": r.solver, "ms": _known(r.milliseconds), **r.score.to_json()}
            for r in rows
        ]
        print(json.dumps(rows_json))
    else:
        print(text)
    return 0


def table(rows: list[Row], brief: bool = False) -> str:
    """Markdown: the clips at each rate, unless it is to be brief, then the means weighted by frames."""
    head = (
        "| clip | Hz | solver | MPJPE cm | upper | lower | root | hands | fingers | MPJRE deg | MPJVE cm/s "
        "| jitter / truth | skate / truth cm/s | under floor cm | ms |"
    )
    lines = [head, "|" + " --- |" * 15]
    lines += [] if brief else [_line(row) for row in rows]
    for rate in dict.fromkeys(row.rate for row in rows):
        for solver in SOLVERS:
            same = [row for row in rows if row.rate == rate and row.solver == solver]
            spent = float(np.median([row.milliseconds for row in same]))
            lines.append(_line(Row("**all**", rate, solver, mean_score([row.score for row in same]), spent)))
    where = f"Python {platform.python_version()}, numpy {np.__version__}, {platform.machine()}"
    return "\n".join([*lines, "", f"Times: median a sample, one core, fingers included ({where})."])


def _line(row: Row) -> str:
    s = row.score
    cells = (
        *(row.clip, f"{row.rate:g}", row.solver, f"{s.mpjpe:.2f}", f"{s.upper:.2f}", f"{s.lower:.2f}", f"{s.root:.2f}"),
        *(f"{s.hands:.2f}", f"{s.fingers:.2f}", "-" if s.mpjre != s.mpjre else f"{s.mpjre:.1f}", f"{s.mpjve:.1f}"),
        *(f"{s.jitter:.1f} / {s.jitter_truth:.1f}", f"{s.skate:.1f} / {s.skate_truth:.1f}", f"{s.penetration:.2f}"),
        "-" if row.milliseconds != row.milliseconds else f"{row.milliseconds:.2f}",
    )
    return "| " + " | ".join(cells) + " |"


def insert(path: Path, text: str) -> None:
    """Replace what stands between the marks of a document."""
    try:
        document = path.read_text(encoding="utf-8")
    except OSError as error:
        raise FormatError(f"{path}: cannot read the document ({error.strerror})") from None
    before, begin, rest = document.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise FormatError(f"{path}: needs the marks {BEGIN} and {END} around the table")
    replace_file(path, [f"{before}{BEGIN}\n{text}\n{END}{after}".encode()])


def _known(value: float) -> float | None:
    return None if value != value else value
