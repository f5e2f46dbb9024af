"""``glsplat study power``: simulate the power of a planned study for effects of a given size."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from glsplat.extras.study.analysis.codebook import read_codebook
from glsplat.extras.study.analysis.power import Planned, Power, from_pilot, power
from glsplat.extras.study.analysis.table import read_table
from glsplat.extras.study.design import read_study

from ..args import natural
from ..progress import Progress
from ..usage import UsageError
from .files import factors_of

EXAMPLE = (
    "glsplat study power --within type=self,other --within method=ours,video,image --participants 24 --effect type=0.4"
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument("--study", metavar="STUDY.toml", help="take factors and participants from a study's file")
    parser.add_argument(
        "--within",
        action="append",
        default=[],
        metavar="F=A,B",
        help="a factor and its levels; each participant has all levels",
    )
    parser.add_argument(
        "--between", action="append", default=[], metavar="F=A,B", help="a factor; each participant has one level"
    )
    parser.add_argument(
        "--participants", type=natural, metavar="N", help="total; several numbers are simulated in turn", nargs="+"
    )
    parser.add_argument(
        "--effect",
        action="append",
        default=[],
        metavar="F=D",
        help="largest difference in standard deviations (type=0.4; an interaction: type:method=0.5), or one number "
        "per condition (method=0.3,0,-0.3)",
    )
    parser.add_argument("--correlation", type=float, default=0.5, help="of two answers of a participant (default 0.5)")
    parser.add_argument("--points", type=natural, help="points of the rating scale (default: continuous)")
    parser.add_argument("--pilot", metavar="TABLE.csv", help="draw participants from a pilot's table instead")
    parser.add_argument("--factors", metavar="A,B", help="factors of the pilot (default: those of its sidecar)")
    parser.add_argument("--response", default="value", metavar="COLUMN", help="answers of the pilot (default: value)")
    parser.add_argument("--measure", metavar="NAME", help="measure of the pilot")
    parser.add_argument("--runs", type=natural, default=1000, help="simulated studies (default 1000)")
    parser.add_argument("--alpha", type=float, default=0.05, help="default 0.05")
    parser.add_argument("--seed", type=natural, default=0)
    parser.add_argument("--json", action="store_true", help="print the numbers as JSON")


def run(args: argparse.Namespace) -> int:
    """Simulate and print a table."""
    factors, between, participants = _design(args)
    counts = args.participants or ([participants] if participants else [])
    if not counts:
        raise UsageError("--participants is needed: how many take part")
    if args.pilot and (args.effect or factors):
        raise UsageError("--pilot defines factors and effects; leave out --study, --within, --between and --effect")
    if not args.pilot and not factors:
        raise UsageError("name the factors by --within and --between, or give --study or --pilot")
    effects = dict(_effect(text) for text in args.effect)
    if args.pilot:
        path = Path(args.pilot)
        columns = factors_of(args.factors, read_codebook(path.with_suffix(".json")), path)
        pilot = read_table(path, columns, response=args.response, measure=args.measure)
    results: list[tuple[int, list[Power]]] = []
    with Progress(args.runs * len(counts), "studies") as bar:
        for count in counts:
            if args.pilot:
                draws, table = from_pilot(pilot, count)
            else:
                plan = Planned(factors, count, frozenset(between), args.correlation, args.points)
                draws, table = plan.draws(effects), plan.table
            rows = power(draws, table, runs=args.runs, alpha=args.alpha, seed=args.seed, progress=bar.update)
            results.append((count, rows))
    if args.json:
        numbers = [
            {"participants": count, **asdict(row), "power": row.power} for count, rows in results for row in rows
        ]
        print(json.dumps(numbers))
        return 0
    width = max(len(row.effect) for row in results[0][1])
    for count, rows in results:
        print(f"{count} participants, {args.runs} simulated studies, alpha {args.alpha:g}:")
        for row in rows:
            print(f"  {row.effect:{width}}  power {row.power:.3f}   95 % [{row.low:.3f}, {row.high:.3f}]")
    return 0


def _design(args: argparse.Namespace) -> tuple[dict[str, Sequence[str]], set[str], int]:
    """Return the factors, the between-subject ones, and the participants if a file has them."""
    factors: dict[str, Sequence[str]] = {}
    between: set[str] = set()
    participants = 0
    if args.study:
        study = read_study(args.study)
        factors = {factor.name: factor.levels for factor in study.factors if len(factor.levels) > 1}
        between = {factor.name for factor in study.factors if factor.between and len(factor.levels) > 1}
        participants = study.participants
    for option, texts in (("--within", args.within), ("--between", args.between)):
        for text in texts:
            name, _, levels = text.partition("=")
            found = [level.strip() for level in levels.split(",") if level.strip()]
            if not name.strip() or len(found) < 2 or len(set(found)) < len(found) or name.strip() in factors:
                raise UsageError(f"{option} needs NAME=LEVEL,LEVEL,..., each once, not {text!r}")
            factors[name.strip()] = found
            if option == "--between":
                between.add(name.strip())
    return factors, between, participants


def _effect(text: str) -> tuple[str, list[float]]:
    name, _, numbers = text.partition("=")
    try:
        return name.strip(), [float(number) for number in numbers.split(",")]
    except ValueError:
        raise UsageError(f"--effect needs NAME=NUMBER or NAME=NUMBER,NUMBER,..., not {text!r}") from None
