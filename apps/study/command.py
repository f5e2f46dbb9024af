"""``glsplat study``: run a user study from its design to tidy tables; new, check, plan, run, export, delete."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from importlib import import_module, resources
from pathlib import Path

from glsplat.extras.study.design import Study, read_study
from glsplat.extras.study.export import export
from glsplat.extras.study.plan import PLAN, checked_plan, cycle, label, make_plan, read_plan, write_plan
from glsplat.extras.study.questionnaires import embedded
from glsplat.extras.study.store import remove
from glsplat.io.files import replace_file

from ..progress import Progress
from ..usage import CommandParser, UsageError, make_folder
from .files import avatar_files, data_of

HELP = "A user study: check its design, write the plan, run its sessions, export tidy tables."
EXAMPLE = "glsplat study plan study.toml"

_SUBCOMMANDS = {
    "analyse": "Analyse a study's table: aligned rank transform, contrasts, effect sizes, reliability.",
    "power": "Power of a planned study by simulation: how often it would find effects of a size.",
}
"""Subcommands in modules of the same name, with their help; each has EXAMPLE, add_arguments and run."""

MAX_LINES = 20  # of one kind


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the subcommands."""
    commands = parser.add_subparsers(dest="task", required=True, metavar="TASK", parser_class=CommandParser)

    command = commands.add_parser("new", help="make a folder with an example study and the instruments")
    command.add_argument("folder", type=Path, metavar="FOLDER", help="folder to make; existing files stay")
    command.add_argument("--paper", action="store_true", help="the paper's study, which lacks texts and avatars")
    command.set_defaults(work=new)

    command = commands.add_parser("check", help="check a design: texts, avatars, balance")
    _add_study(command)
    command.add_argument("--participant", type=int, metavar="N", help="check this participant's avatars only")
    command.set_defaults(work=check)

    command = commands.add_parser("plan", help="write each participant's order, once, before the first session")
    _add_study(command)
    command.set_defaults(work=plan)

    command = commands.add_parser(
        "run",
        help="serve the study to one participant: glsplat serve with its options",
    )
    _add_study(command)
    command.add_argument("participant", type=int, metavar="N", help="the participant's number, from 1")
    command.add_argument("options", nargs=argparse.REMAINDER, metavar="OPTIONS", help="options of glsplat serve")
    command.set_defaults(work=run_study)

    command = commands.add_parser("export", help="write CSV tables with codebooks")
    _add_study(command)
    command.add_argument("-o", "--output", type=Path, required=True, metavar="FOLDER", help="folder for the tables")
    command.set_defaults(work=run_export)

    command = commands.add_parser("delete", help="delete all data of one participant")
    _add_study(command)
    command.add_argument("participant", type=int, metavar="N", help="the participant's number, from 1")
    command.add_argument("--yes", action="store_true", help="confirm; the data cannot be restored")
    command.set_defaults(work=delete)

    for name, text in _SUBCOMMANDS.items():
        commands.add_parser(name, help=text).later = partial(_fill, name)


def _fill(name: str, command: argparse.ArgumentParser) -> None:
    """Import a subcommand, which may need further packages, and add its arguments."""
    module = import_module(f".{name}", __package__)
    command.epilog = f"example: {module.EXAMPLE}"
    module.add_arguments(command)
    command.set_defaults(work=module.run)


def run(args: argparse.Namespace) -> int:
    """Run the chosen subcommand; 0 on success. Raises GlsplatError, UsageError."""
    return int(args.work(args) or 0)


def new(args: argparse.Namespace) -> int:
    """Copy the example and the instruments into a folder."""
    folder: Path = args.folder
    home = resources.files("glsplat.extras.study")
    copies = {"study.toml": home / "examples" / ("paper.toml" if args.paper else "first.toml")}
    copies |= {f"instruments/{name}.toml": home / "instruments" / f"{name}.toml" for name in embedded()}
    make_folder(folder / "instruments")
    for name, source in copies.items():
        if (folder / name).exists():
            print(f"{folder / name}: stays as it is")
            continue
        replace_file(folder / name, [source.read_bytes()])
    print(f"{folder / 'study.toml'}: change it, then: glsplat study check {folder / 'study.toml'}")
    return 0


def check(args: argparse.Namespace) -> int:
    """Print the design and its faults; return 1 if it cannot be run."""
    study = read_study(args.study)
    asked = sum(len(study.questionnaires[name].items) for name in study.each)
    minutes = len(study.conditions) * sum(t.seconds + t.countdown + t.reading * (not t.ready) for t in study.tasks) / 60
    print(f"{study.title}: {study.participants} participants, {len(study.conditions)} conditions")
    for factor in study.factors:
        print(f"  {factor.name} ({'between' if factor.between else 'within'}): {', '.join(factor.levels)}")
    print(f"  {len(study.tasks)} tasks and {asked} items per condition; {minutes:.0f} min of tasks in all")
    rows = cycle(study)
    if study.participants % rows:
        print(f"  not balanced: {study.participants} participants are no multiple of {rows} (Latin square)")
    groups = math.prod(len(factor.levels) for factor in study.factors if factor.between)
    if study.participants % groups:
        print(f"  not balanced: {study.participants} participants are no multiple of {groups}, the groups")
    elif groups > 1 and rows > 1 and study.participants % (rows * groups):
        print(f"  balanced over all participants, not within each group: that takes a multiple of {rows * groups}")
    cells = [
        ", ".join(f"{factor.name} = {level}" for factor, level in zip(study.within, cell, strict=True))
        for cell in study.missing_cells
    ]
    _print_some(
        [f"no condition has {cell}: glsplat study analyse needs every combination" for cell in cells],
        "combinations without a condition",
    )
    sources = {name: one.source for name, one in study.questionnaires.items()}
    _print_some(
        [f"no text yet: {item} ({sources[item.partition('.')[0]]})" for item in study.items_without_text],
        "items without a text",
    )
    numbers = [_number(study, args.participant)] if args.participant else range(1, study.participants + 1)
    files = dict.fromkeys(path for number in numbers for path in avatar_files(study, label(number)).values() if path)
    _print_some([f"no such avatar: {path}" for path in files if not path.is_file()], "avatars that are missing")
    if (data_of(args.study, args.data) / PLAN).exists():
        checked_plan(data_of(args.study, args.data), study)
        print(f"  planned: {data_of(args.study, args.data) / PLAN}")
    return 1 if study.items_without_text else 0


def plan(args: argparse.Namespace) -> int:
    """Write the plan and print it."""
    study = read_study(args.study)
    made = make_plan(study)
    path = write_plan(data_of(args.study, args.data), made)
    for number, (order, group) in enumerate(zip(made.orders, made.groups, strict=True), 1):
        levels = "".join(f" {name}={level}" for name, level in group.items())
        print(f"{label(number)}{levels}: {', '.join(order)}")
    print(f"{path}: stays as it is from now on", file=sys.stderr)
    return 0


def run_study(args: argparse.Namespace) -> int:
    """Run ``glsplat serve`` for one participant; its options follow the number."""
    from ..serve import command as serve
    from ..serve.options import parsed

    parser = CommandParser(prog="glsplat serve", description=serve.HELP)
    serve.add_arguments(parser)
    options = parsed(parser, args.options)
    study = {"study": args.study, "participant": args.participant, "study_data": data_of(args.study, args.data)}
    return serve.run(replace(options, **study))


def run_export(args: argparse.Namespace) -> int:
    """Write the tables and print remarks about the data."""
    study = read_study(args.study)
    made = checked_plan(data_of(args.study, args.data), study)
    with Progress(0, "participants") as bar:

        def progress(done: int, of: int) -> None:
            bar.total = of
            bar.show(done)

        done = export(study, made, data_of(args.study, args.data), args.output, progress)
    for name, count in done.rows.items():
        print(f"{args.output / name}.csv: {count} rows")
    for remark in done.remarks:
        print(f"  {remark}")
    return 0


def delete(args: argparse.Namespace) -> int:
    """Delete a participant's folder."""
    study, _ = read_study(args.study), read_plan(data_of(args.study, args.data))
    number = _number(study, args.participant)
    if not args.yes:
        raise UsageError(f"give --yes to delete all data of {label(number)} for good")
    count = remove(data_of(args.study, args.data), number)
    where = data_of(args.study, args.data) / label(number)
    print(f"{where}: deleted ({count} files); tables that were exported before still have them")
    return 0


def _print_some(lines: Sequence[str], kind: str) -> None:
    for line in lines[:MAX_LINES]:
        print(f"  {line}")
    if len(lines) > MAX_LINES:
        print(f"  ... and {len(lines) - MAX_LINES} more {kind}")


def _number(study: Study, number: int) -> int:
    if not 1 <= number <= study.participants:
        raise UsageError(f"participants have the numbers 1 to {study.participants}, not {number}")
    return number


def _add_study(command: argparse.ArgumentParser) -> None:
    command.add_argument("study", type=Path, metavar="STUDY.toml", help="the design (docs/study.md)")
    command.add_argument(
        "--data", type=Path, metavar="FOLDER", help="folder of plan and participants (default: data beside the design)"
    )
