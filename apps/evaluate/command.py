"""``glsplat evaluate``: compare methods of making avatars over participants; write the paper's tables."""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from glsplat.data import default_avatar, participants_folder
from glsplat.errors import GlsplatError
from glsplat.extras.evaluate.comparison.method import OWN, method_of
from glsplat.extras.evaluate.comparison.participant import Participant, participants_in
from glsplat.extras.evaluate.comparison.protocol import EXTRA_MEASURES, LIGHTS, TASKS, VIEWS, Protocol
from glsplat.extras.evaluate.comparison.work import Result, Task, alone, finished, run_tasks
from glsplat.extras.evaluate.lpips import Lpips
from glsplat.formats.motion_files import embedded_motions, split_choice
from glsplat.io.cores import cores
from glsplat.io.files import locked, replace_file
from glsplat.optional import require_package

from ..args import motion_of, whole
from ..progress import Progress
from ..ray_tasks import add_ray, on_ray
from ..usage import UsageError, make_folder
from .outcome import outcome, page, plots, table_lines
from .timing import timed

HELP = (
    "Make every method's avatar of every participant, drive all by the same head and hands and by the true pose, "
    "compare with the participants' own meshes, and write evaluation.html (opens offline) and evaluation.json. "
    "Results that are in the folder are reused."
)
EXAMPLE = "glsplat evaluate --quick -o out/evaluation"

_QUICK_TASKS = ("waving", "turning")
_QUICK_VIEWS = ("front", "back")
_QUICK_PEOPLE = 4
_QUICK_SIZE = 256
_WORKER = 1.6e9  # bytes of memory of one process, at most
# a container's memory limit: cgroups v2, v1
_LIMITS = "/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes"

_SEEING = ("photo", "mesh-image", "mesh-video")  # methods that detect a person in pictures


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument(
        "--participants",
        type=Path,
        metavar="DIR",
        help="NAME.npz or .glb (the truth) and capture/NAME.jpg (docs/evaluation.md); default: four included people",
    )
    parser.add_argument(
        "--methods",
        default=",".join(OWN),
        help="names, separated by commas: %(default)s (the default), other packages', or NAME=FOLDER with a "
        "file (.glb, .ply, ...) per participant",
    )
    parser.add_argument("--only", help="participants, separated by commas (default: all)")
    parser.add_argument(
        "--poses", help=f"some of: {', '.join(TASKS)}; or a motion, compared at 8 moments (default: all tasks)"
    )
    parser.add_argument("--views", help=f"sides to compare, some of {', '.join(VIEWS)} (default: all)")
    parser.add_argument("--size", type=int, help="side of an eye's picture in pixels (default 512; 256 with --quick)")
    parser.add_argument(
        "--light",
        choices=LIGHTS,
        default=LIGHTS[0],
        help="draw the truth in its own colours (default), or lit as in the photograph",
    )
    parser.add_argument("--measure", help=f"further measures: {', '.join(EXTRA_MEASURES)}")
    parser.add_argument("--quick", action="store_true", help="four participants, two poses, two sides, small pictures")
    parser.add_argument("--seed", type=int, default=0, help="same seed, same table (default 0)")
    parser.add_argument("--jobs", type=whole(1, 256), help="processes (default: one per core, as memory allows)")
    add_ray(parser, "participants")
    parser.add_argument("--no-timing", action="store_true", help="leave out table 2 and the latency table")
    parser.add_argument(
        "-o", "--output", type=Path, default=Path("out/evaluation"), help="folder (default %(default)s)"
    )


def run(args: argparse.Namespace) -> int:
    """Compare, write the results and print table 1; return 1 if something failed."""
    named = [method_of(word) for word in _words(args.methods, "--methods")]
    methods = dict(named)
    if len(methods) < len(named):
        raise UsageError("--methods needs different names")
    protocol = _protocol(args)
    people = _people(args)
    check_ready(tuple(methods), protocol)
    make_folder(args.output)
    with locked(args.output / "lock"):  # a second run would read half-written files
        options = {"seed": args.seed, "quick": args.quick}
        began = time.perf_counter()
        out = args.output if args.ray is None else args.output.resolve()  # workers have other working folders
        results = _results([Task(one, methods, protocol, out, options) for one in people], _jobs(args), args.ray)
        drawn = plots(results, tuple(methods), args.seed)
        found = outcome(results, tuple(methods), people, protocol, options, {})
        found["seconds"] = round(time.perf_counter() - began, 1)
        _write(found, drawn, args.output)  # the timing may fail
        print(*table_lines(found), sep="\n", flush=True)
        if not args.no_timing:
            try:
                found["timing"] = timed(results, people, protocol, args.output, args.quick)
                _write(found, drawn, args.output)
            except GlsplatError as error:
                print(f"no timing: {error}", file=sys.stderr)
        print(args.output / "evaluation.html")
        return 1 if found["failures"] else 0


def _results(tasks: Sequence[Task], jobs: int, ray: str | None) -> list[Result]:
    """Return the results of all tasks: those in the folder, and the rest computed in processes or on a Ray cluster."""
    kept = [result for task in tasks for result in finished(task)]
    done = {(result.participant, result.method) for result in kept}
    left = []
    for task in tasks:
        methods = {name: how for name, how in task.methods.items() if (task.participant.name, name) not in done}
        if methods:
            left.append(Task(task.participant, methods, task.protocol, task.out, task.options))
    if kept:
        print(f"{len(kept)} of {sum(len(task.methods) for task in tasks)} results lie in the folder already")
    shares = [0.0] * len(left)
    began, ended = time.monotonic(), 0
    with Progress(max(len(left), 1)) as bar:

        def show(index: int, step: str, done: float) -> None:
            shares[index] = max(shares[index], done)
            bar.show(sum(shares), step)

        for results in run_tasks(left, jobs, show) if ray is None else _on_ray(left, ray):
            kept += results
            for result in results:
                if result.failed:
                    bar.write(f"{result.participant}, {result.method}: {result.failed}")
            if results:
                place = [task.participant.name for task in left].index(results[0].participant)
                show(place, results[0].participant, 1.0)
            ended += 1
            if not bar.shown:  # no terminal: one line per participant
                passed = time.monotonic() - began
                left_over = passed / ended * (len(left) - ended)
                times = f"{passed / 60:.0f} min passed, about {left_over / 60:.0f} to go"
                print(f"{ended} of {len(left)} participants: {times}", file=sys.stderr, flush=True)
    order = {task.participant.name: place for place, task in enumerate(tasks)}
    columns = list(tasks[0].methods) if tasks else []
    return sorted(kept, key=lambda result: (order[result.participant], columns.index(result.method)))


def _on_ray(tasks: Sequence[Task], address: str) -> Iterator[list[Result]]:
    for place, found in on_ray(alone, tasks, address):
        task = tasks[place]
        if isinstance(found, Exception):
            yield [Result(task.participant.name, method, str(found)) for method in task.methods]
        else:
            yield found


def _protocol(args: argparse.Namespace) -> Protocol:
    tasks, motion = tuple(TASKS), None
    views = tuple(_words(args.views, "--views")) if args.views else tuple(VIEWS)
    if args.quick:
        tasks, views = _QUICK_TASKS, views if args.views else _QUICK_VIEWS
    if args.poses:
        words = tuple(_words(args.poses, "--poses"))
        if all(word in TASKS for word in words):
            tasks = words
        elif len(words) == 1 and (words[0] in embedded_motions() or split_choice(words[0])[0].exists()):
            motion = words[0]
        else:
            wrong = next(word for word in words if word not in TASKS)
            raise UsageError(f"--poses: {wrong!r:.40} is neither a motion nor one of {', '.join(TASKS)}")
    extra = tuple(_words(args.measure, "--measure")) if args.measure else ()
    size = (_QUICK_SIZE if args.quick else Protocol().size) if args.size is None else args.size
    digest = ""
    if motion is not None:
        motion_of(motion, default_avatar().skeleton, "--poses")  # fail before all avatars are made
        file = split_choice(motion)[0]
        digest = hashlib.sha256(file.read_bytes()).hexdigest() if file.is_file() else ""
    return Protocol(
        tasks=tasks, motion=motion, motion_digest=digest, views=views, size=size, light=args.light, extra_measures=extra
    )


def _people(args: argparse.Namespace) -> list[Participant]:
    people = participants_in(participants_folder() if args.participants is None else args.participants)
    if args.only:
        wanted = _words(args.only, "--only")
        known = {one.name: one for one in people}
        missing = [name for name in wanted if name not in known]
        if missing:
            raise UsageError(f"--only: no participant {missing[0]!r:.40}; there are {', '.join(known)}")
        people = [known[name] for name in wanted]
    return people[:_QUICK_PEOPLE] if args.quick else people


def _jobs(args: argparse.Namespace) -> int:
    """Return the number of processes: one per core, as free memory and a container's limit allow."""
    if args.jobs is not None:
        return int(args.jobs)
    free = min(_said("/proc/meminfo", "MemAvailable:") * 1024, *(_said(limit) for limit in _LIMITS))
    return max(1, min(cores(), math.floor(free / _WORKER) if free < math.inf else cores()))


def _said(file: str, name: str = "") -> float:
    """Return the number after ``name`` in a system file; infinity if there is none."""
    try:
        lines = Path(file).read_text(encoding="ascii").splitlines()
        return next(float(line.removeprefix(name).split()[0]) for line in lines if line.startswith(name))
    except (OSError, StopIteration, ValueError, IndexError):
        return math.inf


def _words(text: str, option: str) -> list[str]:
    words = [word.strip() for word in text.split(",") if word.strip()]
    if not words or len(set(words)) != len(words):
        raise UsageError(f"{option} needs different names with commas between, not {text!r:.60}")
    return words


def _write(found: Mapping[str, Any], plots: Mapping[str, bytes], folder: Path) -> None:
    pictures = dict(plots)
    for row in found["participants"]:
        name = f"sheets/{row['method']}/{row['participant']}.jpg"
        if "failed" not in row and (folder / name).is_file():
            pictures[name] = (folder / name).read_bytes()
    for name, data in plots.items():
        replace_file(folder / name, [data])
    replace_file(folder / "evaluation.json", [json.dumps(found, indent=1, allow_nan=False).encode()])
    replace_file(folder / "evaluation.html", [page(found, pictures).encode()])


def check_ready(methods: Sequence[str], protocol: Protocol) -> None:
    """Raise GlsplatError with the command that installs a missing network or package, before the first avatar."""
    # here, as the command names the first extra that it lacks: evaluate's own
    from glsplat.extras.authoring.models.catalogue import PHOTO
    from glsplat.extras.authoring.models.store import state_of

    if any(method in _SEEING for method in methods) and any(state_of(model) != "here" for model in PHOTO.models):
        raise GlsplatError(f"the networks that read photographs are not on this machine; run: {PHOTO.command}")
    Lpips("alex")
    if "lpips-vgg" in protocol.extra_measures:
        Lpips("vgg")
    require_package("the plots", "matplotlib", "evaluate")
    if "flip" in protocol.extra_measures:
        require_package("FLIP", "flip_evaluator", "evaluate")
