"""``glsplat selftest``: hold every path of a driver against float64, and measure it."""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import Any

from glsplat.gl.context import create_context
from glsplat.io.files import replace_file

from ..progress import Progress
from ..report.command import finite
from ..usage import make_folder
from .html import page
from .parts import PARTS, run_part

HELP = (
    "Hold this driver against the promises: contract scenes on every path against a float64 reference, hard inputs, "
    "skinning, goldens (in a checkout), contexts, memory. Then measure batching, stages, a stream and the largest "
    "scene at 72 Hz. Writes selftest.html and selftest.json, to attach to a report of a bug; exits with 1 if a promise "
    "is broken."
)
EXAMPLE = "glsplat selftest --quick -o out/selftest"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument("--quick", action="store_true", help="a fifth of the paths for each scene, fewer frames")
    parser.add_argument("--parts", nargs="+", choices=list(PARTS), metavar="PART", help=f"of {', '.join(PARTS)}")
    parser.add_argument("--device", help="EGL device: index or part of its name (also GLSPLAT_DEVICE)")
    parser.add_argument("-o", "--output", type=Path, default=Path("out/selftest"), help="folder (default out/selftest)")


def run(args: argparse.Namespace) -> int:
    """Run the parts; after each write the files, so that they are there if the machine hangs in the next."""
    if args.device is not None:
        create_context(args.device).release()  # one line for a device that is not there
    make_folder(args.output)
    result: dict[str, Any] = {"quick": args.quick, "parts": {}}
    names = [name for name in PARTS if name in (args.parts or PARTS)]
    _write(result, args.output)
    with Progress(len(names)) as progress:
        for index, name in enumerate(names):
            progress.show(index, name)
            tell = lambda text, index=index, name=name: progress.show(index, f"{name}, {text}")  # noqa: E731
            result["parts"][name] = part = run_part(name, args.quick, args.device, tell)
            progress.write(f"{name}: {_words(part)}, {part['seconds']:g} s")
            _write(result, args.output)
    if result["smallest"]:
        print(f"smallest failing case: {result['smallest']}")
    print(args.output / "selftest.json", args.output / "selftest.html", sep="\n")
    return 0 if result["holds"] else 1


def _words(part: dict[str, Any]) -> str:
    if not part["rows"]:
        return "not possible in this installation"
    judged = [row["verdict"] for row in part["rows"] if "verdict" in row]
    return f"{judged.count('holds')} of {len(judged)} hold" if judged else "measured"


def _write(result: dict[str, Any], folder: Path) -> None:
    """Add the verdict and write both files."""
    failed = [row for part in result["parts"].values() for row in part["rows"] if row.get("verdict") == "failed"]
    smallest = min(failed, key=lambda row: row["splats"] or math.inf, default=None)
    result["holds"] = not failed
    result["smallest"] = smallest and "{group}, {case}; {input}: {seen}".format(**smallest)
    text = json.dumps(finite(result), indent=1, allow_nan=False)
    replace_file(folder / "selftest.json", [text.encode()])
    replace_file(folder / "selftest.html", [page(result).encode()])
