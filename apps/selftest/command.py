"""``glsplat selftest``: hold every path of a driver against float64, measure it, and write a self-contained page."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from glsplat.gl.context import create_context
from glsplat.io.files import replace_file

from ..page import document, escaped, table_of
from ..progress import Progress
from ..replay import latency
from ..report.command import finite
from ..usage import make_folder
from .parts import PARTS, run_part

HELP = (
    "Hold this driver against the promises: contract scenes on every path against a float64 reference, hard inputs, "
    "skinning, goldens (in a checkout), contexts, memory. Then measure batching, stages, a stream and the largest "
    "scene at 72 Hz. Writes selftest.html and selftest.json, to attach to a report of a bug; exits with 1 if a promise "
    "is broken."
)
EXAMPLE = "glsplat selftest --quick -o out/selftest"

Rows = Sequence[Mapping[str, Any]]


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


def page(result: Mapping[str, Any]) -> str:
    """Return the document."""
    parts = [f"<h1>glsplat selftest: {'all promises hold' if result['holds'] else 'a promise is broken'}</h1>"]
    if result["smallest"]:
        parts.append(f"<p>Smallest failing case: {escaped(result['smallest'])}</p>")
    for name, part in result["parts"].items():
        parts.append(f"<h2>{escaped(name)} ({part['seconds']:g} s)</h2>")
        judged = [row for row in part["rows"] if "verdict" in row]
        measured = [row for row in part["rows"] if "verdict" not in row]
        if not part["rows"]:
            parts.append("<p>Not possible in this installation.</p>")
        parts += [_judged(judged)] if judged else []
        parts += [_TABLES[name](measured)] if measured else []
    return document("glsplat selftest", "".join(parts))


def _judged(rows: Rows) -> str:
    names = ("case", "behaviour", "input", "seen", "error", "unit", "verdict")
    table = [["" if row[name] is None else row[name] for name in names] for row in rows]
    classes = ["" if row["verdict"] == "holds" else "failed" for row in rows]
    return table_of(("case", "promise", "input", "seen", "largest error", "", "verdict"), table, classes)


def _facts(rows: Rows) -> str:
    return table_of(("fact", "value"), [[name, str(value)] for name, value in rows[0].items()])


def _speed(rows: Rows) -> str:
    names = ["pixels an eye", "batched (ms)", "not batched (ms)", "eye by eye (ms)", "gain"]
    paper = ["paper, batched (ms)", "paper, not batched (ms)", "paper, gain"]
    keys = ("pair_ms", "two_ms", "in_turn_ms", "gain")
    done = [row for row in rows if "left_out" not in row]
    times = [[f"{row['size']}²", *(row[key] for key in keys), *row["paper"].values()] for row in done]
    left = [f"<p>{row['size']}²: left out, {escaped(row['left_out'])}</p>" for row in rows if "left_out" in row]
    return "".join([table_of(names + paper, times), *left])


def _stream(rows: Rows) -> str:
    head, *table = latency.rows(dict(rows[0]))
    rates = [f"2 x {run['size'][0]}²: {run['pictures_a_second']:.1f} pictures a second" for run in rows[0]["runs"]]
    return table_of(head, table) + f"<p>{'; '.join(rates)}</p>"


def _largest(rows: Rows) -> str:
    (found,) = rows
    words = f"{found['splats']:,} splats keep {found['hertz']:g} Hz at 2 x {found['size']}² (0: not even the fewest)"
    return f"<p>{words}</p>" + table_of(("splats", "ms, median"), found["tried"])


_TABLES = {"driver": _facts, "speed": _speed, "stream": _stream, "largest": _largest}
