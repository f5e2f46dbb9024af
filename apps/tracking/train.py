"""``glsplat tracking train``: train the network of the learned solver on motion files."""

from __future__ import annotations

import argparse
import json
import re
import sys
from pathlib import Path

import numpy as np

from glsplat.errors import FormatError
from glsplat.extras.learned.network import load_network, save_network
from glsplat.extras.training.clips import TrainingClip, clips_of, looks_away, unit_of_skeleton
from glsplat.extras.training.fit import TrainingConfig, evaluate, fit, lessons_of
from glsplat.extras.training.standing import Stance, stances_of, stood
from glsplat.formats.motion_files import load_motion
from glsplat.motion.motion import Motion

from ..progress import Progress, each
from ..usage import UsageError
from .options import add_skeleton, pattern_of, skeleton_of

DEFAULT = TrainingConfig()
KINDS = (".bvh", ".amc", ".json", ".npz", ".glb", ".gltf", ".vrma")


def add_arguments(command: argparse.ArgumentParser) -> None:
    """Add the options of the subcommand."""
    command.add_argument("motions", nargs="+", metavar="MOTION", help="motion files, or folders of them")
    command.add_argument("-o", "--output", required=True, metavar="MODEL.npz", help="the network")
    command.add_argument("--steps", type=int, default=DEFAULT.steps, help=f"of the fit (default {DEFAULT.steps})")
    command.add_argument("--units", type=int, default=DEFAULT.units, help=f"of its memory (default {DEFAULT.units})")
    command.add_argument(
        "--from", dest="start", metavar="MODEL.npz", help="a network that goes on learning, as large as it is"
    )
    command.add_argument("--seed", type=int, default=0, help="of everything random")
    command.add_argument(
        "--groups",
        default=r"(.+)_[^_]+",
        metavar="REGEX",
        help="whose a file is, by its name: what the first bracket holds (default: all before the last _)",
    )
    command.add_argument("--hold-out", metavar="K/N", help="leave part K of N of the groups out, and say their errors")
    command.add_argument("--note", default="", help="what it learned from, kept in the file")
    command.add_argument("--json", action="store_true", help="print the errors as JSON")
    add_skeleton(command)
    command.set_defaults(work=train)


def train(args: argparse.Namespace) -> int:
    """Read the motions, train, write the network, print a summary."""
    if not (1 <= args.steps <= 10**6 and 1 <= args.units <= 1024):
        raise UsageError("--steps needs 1 to 1,000,000, --units 1 to 1024")
    groups = pattern_of(args.groups, "--groups")
    held = _part(args.hold_out)
    start = load_network(args.start) if args.start else None
    skeleton = skeleton_of(args.avatar)
    unit = unit_of_skeleton(skeleton)
    clips: list[TrainingClip] = []
    dropped: list[str] = []
    kept: list[tuple[str, Motion]] = []
    stances: dict[str, list[Stance]] = {}
    for path in each(_files(args.motions), "motions"):
        match = groups.match(path.stem)
        group = match[1] if match and match.groups() else path.stem
        motion = load_motion(str(path), skeleton)
        some = clips_of(group, motion, skeleton)
        if some and looks_away(some[0]):
            dropped.append(path.name)
            continue
        clips += some
        kept.append((group, motion))
        stances.setdefault(group, []).extend(stances_of(motion, skeleton))
    rng = np.random.default_rng(args.seed)
    for group, motion in kept:
        standing = stood(motion, stances[group], skeleton, rng)
        if standing is not None:
            clips += clips_of(group, standing, skeleton, made=True)
    if dropped:
        print(f"left out, as the head looks away from the body throughout: {', '.join(dropped)}", file=sys.stderr)
    names = sorted({clip.group for clip in clips})
    order = np.random.default_rng(5).permutation(len(names))  # a fixed random order, of which every N-th is left out
    out = set() if held is None else {names[i] for i in order[held[0] :: held[1]]}
    seen = [clip for clip in clips if clip.group not in out]
    if not seen:
        raise FormatError("no motion of a second or more is left to learn from")
    heard = lessons_of(each(seen, "clips"), unit, rng)
    with Progress(args.steps) as bar:

        def show(_: int, loss: float) -> None:
            bar.show(bar.done + 1, f"loss {loss:.3f}")

        config = TrainingConfig(steps=args.steps, units=args.units, seed=args.seed)
        network = fit(heard, config, start, show, args.note)
    save_network(args.output, network)
    seconds = sum(len(clip.points) for clip in seen) / 30
    result = {"motions": len(seen), "seconds": round(seconds), "left_out": sorted(out)}
    if out:  # the motions as they are, not their mirror images or other speeds
        left = [clip for clip in clips if clip.group in out and clip.plain and not clip.made]
        result |= evaluate(network, [lesson for lesson in lessons_of(left, unit, rng) if lesson.clean], unit)
    print(json.dumps(result) if args.json else "\n".join(f"{key:10} {value}" for key, value in result.items()))
    return 0


def _files(names: list[str]) -> list[Path]:
    files: list[Path] = []
    for name in names:
        path = Path(name)
        inside = sorted(p for p in path.iterdir() if p.suffix.lower() in KINDS) if path.is_dir() else [path]
        if not inside:
            raise FormatError(f"{name}: a folder without motions ({', '.join(KINDS)})")
        files += inside
    return files


def _part(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    match = re.fullmatch(r"(\d{1,3})/(\d{1,3})", text)
    if match is None or not 1 <= int(match[1]) <= int(match[2]) or int(match[2]) < 2:
        raise UsageError(f"--hold-out needs K/N, such as 1/5, not {text!r:.40}")
    return int(match[1]) - 1, int(match[2])
