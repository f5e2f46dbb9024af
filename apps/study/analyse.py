"""``glsplat study analyse``: analyse a tidy table by F tests and contrasts; write a text, boxplots and an R script."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from glsplat.errors import FormatError
from glsplat.extras.study.analysis.analysis import Analysis, analyse
from glsplat.extras.study.analysis.codebook import (
    Codebook,
    Measure,
    Reliability,
    item_answers,
    read_codebook,
    reliability,
    wide_items,
)
from glsplat.extras.study.analysis.table import Table, read_rows, read_table
from glsplat.io.files import replace_file
from glsplat.optional import has_package, missing_package

from ..args import natural
from ..progress import each
from ..usage import UsageError
from .files import column_names, factors_of
from .r_script import r_script
from .results_text import results_text

EXAMPLE = "glsplat study analyse export/scores.csv -o results/"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument("table", metavar="TABLE.csv", help="one row per participant and condition, as export writes it")
    parser.add_argument(
        "-o",
        "--output",
        metavar="FOLDER",
        help="results.md, results.json, boxplots.png and analysis.R go there; without it the text is printed",
    )
    parser.add_argument("--factors", metavar="A,B", help="columns of the factors (default: those of the sidecar)")
    parser.add_argument("--participant", default="participant", metavar="COLUMN", help="default: participant")
    parser.add_argument("--response", default="value", metavar="COLUMN", help="the answers (default: value)")
    parser.add_argument(
        "--measure",
        action="append",
        metavar="NAME",
        help="value of the column measure; may be given several times (default: all)",
    )
    parser.add_argument("--items", metavar="A,B,C", help="columns of a scale's items, for Cronbach's alpha and omega")
    parser.add_argument(
        "--model",
        choices=("auto", "rm", "mixed"),
        default="auto",
        help="rm: repeated-measures ANOVA of complete participants; mixed: a mixed model of all answers; "
        "auto: rm where the design is balanced (default)",
    )
    parser.add_argument("--seed", type=natural, default=0, help="seed of the bootstrap intervals")


def run(args: argparse.Namespace) -> int:
    """Analyse, and write or print the results."""
    path = Path(args.table)
    folder = _folder(args.output) if args.output else None
    book = read_codebook(path.with_suffix(".json"))
    factors = factors_of(args.factors, book, path)
    wanted, long = _measures(path, args.measure, list(factors))
    tables: list[Table] = [
        read_table(path, factors, participant=args.participant, response=args.response, measure=measure)
        for measure in wanted
    ]
    bar = each(tables, "responses")
    analyses = [analyse(table, args.model, args.seed) for table in bar]
    scales = dict(_scales(path, args.items, book, analyses))
    text = results_text(analyses, scales)
    if folder is None:
        print(text, end="")
        return 0
    items = column_names(args.items) if args.items else []
    script = r_script(path.name, analyses, participant=args.participant, response=args.response, long=long, items=items)
    numbers: dict[str, Any] = {
        "table": path.name,
        "responses": [analysis.to_json() for analysis in analyses],
        "reliability": {name: asdict(scale) for name, scale in scales.items()},
    }
    written = {"results.md": text.encode(), "analysis.R": script.encode()}
    written["results.json"] = json.dumps(numbers, indent=1, ensure_ascii=False).encode() + b"\n"
    if not has_package("matplotlib"):
        print(f"no plots: {missing_package('a boxplot', 'matplotlib', 'study')}", file=sys.stderr)
    else:
        from .boxplots import boxplots  # here: matplotlib takes a second

        written["boxplots.png"] = boxplots(analyses)
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise FormatError(f"{folder}: cannot be made ({error.strerror or error})") from None
    for name, data in written.items():
        replace_file(folder / name, [data])
    for analysis in analyses:
        clear = ", ".join(row.effect for row in analysis.effects if row.clear) or "no effect"
        print(f"{analysis.table.response}: {clear} at p < .05, {len(analysis.table.names)} participants")
    print(f"{folder}: {', '.join(sorted(written))}")
    return 0


def _folder(name: str) -> Path:
    folder = Path(name)
    if folder.exists() and not folder.is_dir():
        raise UsageError(f"--output {name}: expected a folder, this is a file")
    if not folder.resolve().parent.is_dir():
        raise FormatError(f"{name}: there is no folder {folder.parent}; create it first")
    return folder


def _measures(path: Path, given: list[str] | None, factors: list[str]) -> tuple[list[str | None], bool]:
    """Return the requested measures, else all asked in conditions, and whether there is a column "measure"."""
    found: dict[str, None] = {}
    outside: set[str] = set()
    for _, row in read_rows(path):
        if "measure" in row:
            found[row["measure"]] = None
            if not all(row.get(name, "?") for name in factors):
                outside.add(row["measure"])
    if given and not found:
        raise UsageError(f"--measure is for tables with a column measure; {path} has none")
    if given:
        return list(dict.fromkeys(given)), True
    if not found:
        return [None], False
    for name in sorted(outside):
        print(f"{name}: not asked in conditions, left out", file=sys.stderr)
    kept: list[str | None] = [name for name in found if name not in outside]
    if not kept:
        raise FormatError(f"{path}: no measure was asked in conditions of {', '.join(factors)}")
    return kept, True


def _scales(
    path: Path, items: str | None, book: Codebook | None, analyses: Sequence[Analysis]
) -> Iterator[tuple[str, Reliability]]:
    """Yield the reliability of each response with known items."""
    if items:
        yield analyses[0].table.response, reliability(wide_items(path, column_names(items)))
        return
    answers = path.with_name("answers.csv")
    if book is None or not answers.is_file():
        return
    known: dict[str, Measure] = {measure.name: measure for measure in book.measures}
    for analysis in analyses:
        measure = known.get(analysis.table.response)
        if measure is not None and len(measure.items) > 1:
            try:
                yield measure.name, reliability(item_answers(answers, measure))
            except FormatError as error:
                print(f"{measure.name}: {error}", file=sys.stderr)
