"""``glsplat tracking``: full-body poses of head and hands; derive, calibrate, solve, score, show, bench, train."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from glsplat.errors import PoseError
from glsplat.extras.evaluate.tracking_score import TrackingScore, score
from glsplat.extras.motions.derive import (
    EXTRAS,
    Disturbance,
    TrueMotion,
    derive,
    disturb,
    truth_from_motion,
    with_expressions,
)
from glsplat.skinning.pose import Pose
from glsplat.tracking.calibration import Calibration, calibrate, found_size
from glsplat.tracking.recording import record, replay, write_lines
from glsplat.tracking.sample import TRACKERS, Sample
from glsplat.tracking.solve.body import Body
from glsplat.tracking.tracker import Tracker

from ..args import motion_of, natural, not_negative, positive
from ..progress import each
from ..usage import CommandParser, UsageError
from .bench import add_bench
from .options import add_recording, add_skeleton, read_poses, samples_of, skeleton_of, tracker_of
from .show import add_show

HELP = "Head and hand tracking to a full-body pose: derive it from motions, calibrate, solve, score, show, bench."
EXAMPLE = "glsplat tracking from-motion walk -o rec.jsonl --truth truth.jsonl --rate 72"


def _add_train(command: argparse.ArgumentParser) -> None:
    from .train import add_arguments  # here: it needs extras/training

    add_arguments(command)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the subcommands."""
    commands = parser.add_subparsers(dest="task", required=True, metavar="TASK", parser_class=CommandParser)

    command = commands.add_parser("from-motion", help="derive head and hand tracking from a full-body motion")
    command.add_argument("motion", help="BVH, AMC, AMASS .npz, JSON, or the name of an embedded motion")
    command.add_argument("-o", "--output", required=True, metavar="JSONL", help="the recording")
    command.add_argument("--truth", metavar="JSONL", help="also write the full-body poses it came from")
    command.add_argument("--rate", type=float, default=72.0, help="samples a second (default 72)")
    command.add_argument("--seconds", type=positive, help="use at most this much of the motion")
    command.add_argument("--no-fingers", action="store_true", help="leave out the 25 joints a hand")
    command.add_argument(
        "--trackers",
        metavar="LIST",
        default="",
        help="what is tracked besides, separated by commas: waist, feet, body (a device's own joints of the body)",
    )
    command.add_argument("--noise-mm", type=not_negative, default=0.0, help="noise of positions, standard deviation")
    command.add_argument("--noise-deg", type=not_negative, default=0.0, help="noise of orientations")
    command.add_argument("--dropout", type=float, default=0.0, help="share of the time a hand is lost (0 to 0.9)")
    command.add_argument("--latency-ms", type=not_negative, default=0.0, help="samples tell of this long ago")
    command.add_argument("--seed", type=natural, default=0, help="of the noise and the losses")
    add_skeleton(command)
    command.set_defaults(work=from_motion)

    command = commands.add_parser("calibrate", help="scale and floor from a few seconds of standing still")
    command.add_argument("recording", nargs="?", metavar="JSONL", help="samples; needed unless --height is given")
    command.add_argument("-o", "--output", required=True, metavar="JSON", help="the calibration")
    command.add_argument("--height", type=float, help="the user's stature in metres")
    command.add_argument("--floor", type=float, help="y of the floor in the tracking space (default 0)")
    command.add_argument(
        "--find-size", action="store_true", help="measure the size as a session does: nobody has to stand still"
    )
    add_skeleton(command)
    command.set_defaults(work=run_calibrate)

    command = commands.add_parser("solve", help="full-body poses of a recording, one line a sample")
    add_recording(command)
    command.add_argument("-o", "--output", required=True, metavar="JSONL", help="the poses")
    command.set_defaults(work=solve)

    command = commands.add_parser("score", help="errors of solved poses against the truth")
    command.add_argument("poses", metavar="POSES.jsonl")
    command.add_argument("truth", metavar="TRUTH.jsonl")
    command.add_argument("--json", action="store_true", help="print the numbers as JSON")
    add_skeleton(command)
    command.set_defaults(work=run_score)

    add_show(commands)
    add_bench(commands)
    commands.add_parser("train", help="make the learned solver's network from motion files").later = _add_train


def run(args: argparse.Namespace) -> int:
    """Run the chosen task."""
    work: Callable[[argparse.Namespace], int] = args.work
    return work(args)


def from_motion(args: argparse.Namespace) -> int:
    """Derive a recording (and the true poses) from a motion."""
    if not 0 <= args.dropout <= 0.9:
        raise UsageError(f"--dropout needs 0 to 0.9, not {args.dropout:g}")
    _different(args.output, args.truth)
    trackers = [name.strip() for name in args.trackers.split(",") if name.strip()]
    if unknown := set(trackers) - set(EXTRAS):
        raise UsageError(f"--trackers knows {', '.join(EXTRAS)}, not {', '.join(sorted(unknown))}")
    skeleton = skeleton_of(args.avatar)
    motion = motion_of(args.motion, skeleton, "MOTION")
    count = len(motion) if args.seconds is None else min(len(motion), max(2, round(args.seconds * motion.fps)))
    truth = truth_from_motion(skeleton, motion.rotations[:count], motion.trans[:count], motion.fps, args.rate)
    how = Disturbance(
        noise_mm=args.noise_mm,
        noise_deg=args.noise_deg,
        dropout=args.dropout,
        latency_s=args.latency_ms / 1000,
        seed=args.seed,
    )
    samples = with_expressions(derive(skeleton, truth, fingers=not args.no_fingers, trackers=trackers), motion)
    record(args.output, disturb(samples, how) if how != Disturbance(seed=args.seed) else samples)
    if args.truth:
        write_lines(args.truth, truth_lines(truth))
    print(f"{args.output}: {len(samples)} samples at {args.rate:g} Hz, {truth.times[-1]:.2f} s")
    return 0


def truth_lines(truth: TrueMotion) -> Iterator[dict[str, Any]]:
    """Yield the lines of a true motion for ``read_poses``."""
    for i, t in enumerate(truth.times):
        pose = Pose(truth.rotations[i], truth.trans[i])
        yield {
            "t": float(t),
            **pose.to_smplx(),
            "joints": truth.positions[i].tolist(),
            "reach_error": None,
            "flags": [],
        }


def run_calibrate(args: argparse.Namespace) -> int:
    """Write a calibration of a recording, or of a height."""
    if args.find_size and (args.recording is None or args.height is not None):
        raise UsageError("--find-size takes a recording, and no --height")
    skeleton = skeleton_of(args.avatar)
    _different(args.output, args.recording)
    if args.find_size:
        calibration = found_size(list(replay(args.recording)), skeleton, args.floor or 0.0)
        if calibration.eye_height is None:
            raise PoseError(f"{args.recording}: nobody stands still for a second in it; give --height in metres")
    elif args.recording:
        calibration = calibrate(list(replay(args.recording)), skeleton, args.floor, args.height)
    elif args.height is not None:
        calibration = Calibration.of_height(skeleton, args.height, args.floor or 0.0)
    else:
        raise UsageError("give a recording of standing still, or --height in metres")
    calibration.save(args.output)
    worn = [name for name, mount in zip(TRACKERS, calibration.mounts, strict=True) if mount is not None]
    trackers = f", trackers: {', '.join(worn)}" if worn else ""
    found = "" if calibration.found is None else f" (a session finds {calibration.found:.3f})"
    print(f"{args.output}: scale {calibration.scale:.3f}{found}, floor {calibration.floor:.3f} m{trackers}")
    return 0


def solve(args: argparse.Namespace) -> int:
    """Solve the poses of a recording."""
    skeleton = skeleton_of(args.avatar)
    tracker = tracker_of(args, skeleton)
    _different(args.output, args.recording)
    samples = samples_of(args.recording)
    bar = each(samples, "samples")
    count = write_lines(args.output, (solved(tracker, sample) for sample in bar))
    print(f"{args.output}: {count} poses")
    return 0


def solved(tracker: Tracker, sample: Sample) -> dict[str, Any]:
    """Return a line of ``solve``: time, pose keys, joints in the world, reach error (m), flags."""
    pose = tracker.update(sample)
    line = {"t": sample.t, **pose.to_smplx(), "joints": tracker.joints(pose).tolist()}
    line["reach_error"] = None if tracker.reach_error == (None, None) else list(tracker.reach_error)
    line["flags"] = list(tracker.flags)
    if tracker.calibration.scale != 1.0:
        line["scale"] = tracker.calibration.scale  # joints = scale * avatar's joints + floor
    return line


def _different(output: str, other: str | None) -> None:
    """Raise UsageError if an output is the input file, or both outputs are the same file."""
    if other is not None and Path(output).resolve() == Path(other).resolve():
        raise UsageError(f"{output}: the two files need different names")


def run_score(args: argparse.Namespace) -> int:
    """Print the scores of one file against another."""
    sole = Body.of(skeleton_of(args.avatar)).sole
    poses, truth = read_poses(args.poses), read_poses(args.truth)
    if len(poses.times) != len(truth.times):
        raise PoseError(
            f"{args.poses} has {len(poses.times)} poses and {args.truth} {len(truth.times)}; they need the same samples"
        )
    apart = np.abs(np.asarray(poses.times) - np.asarray(truth.times)).max(initial=0.0)
    if not truth.rate > 0 or apart > 0.5 / truth.rate:
        raise PoseError(f"{args.poses} and {args.truth} need the same, rising time stamps; they are {apart:g} s apart")
    result = score(poses.joints, truth.joints, truth.rate, sole, poses.rotations, truth.rotations)
    if args.json:
        print(json.dumps(result.to_json()))
    else:
        print(score_text(result))
    return 0


def score_text(result: TrackingScore) -> str:
    """Return the numbers with their units, one per line."""
    rows = (
        (
            "MPJPE",
            f"{result.mpjpe:.2f} cm   (upper {result.upper:.2f}, lower {result.lower:.2f}, root {result.root:.2f})",
        ),
        ("hands", f"{result.hands:.2f} cm   (fingers {result.fingers:.2f})"),
        ("MPJRE", f"{result.mpjre:.2f} deg"),
        ("MPJVE", f"{result.mpjve:.1f} cm/s"),
        ("jitter", f"{result.jitter:.2f} (truth {result.jitter_truth:.2f}) 100 m/s^3"),
        ("skate", f"{result.skate:.2f} (truth {result.skate_truth:.2f}) cm/s"),
        ("penetration", f"{result.penetration:.2f} cm"),
        ("frames", str(result.frames)),
    )
    return "\n".join(f"{name:12} {text}" for name, text in rows)
