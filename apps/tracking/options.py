"""Options and inputs that the tasks of ``glsplat tracking`` share: skeleton, recording, solver, and files of poses."""

from __future__ import annotations

import argparse
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from glsplat.data import default_avatar
from glsplat.errors import FormatError, PoseError
from glsplat.skinning.pose import Pose
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES
from glsplat.tracking.calibration import Calibration
from glsplat.tracking.config import TrackerConfig
from glsplat.tracking.recording import embedded_recording, json_lines, replay
from glsplat.tracking.sample import Sample
from glsplat.tracking.tracker import Tracker

from ..args import add_solver, load_avatar, tracked
from ..usage import UsageError


def add_skeleton(parser: argparse.ArgumentParser) -> None:
    """Add --avatar, which selects the skeleton."""
    parser.add_argument(
        "--avatar", metavar="FILE", help="avatar (.glb), rigged mesh, or body (.npz with joints); default: embedded"
    )


def add_recording(parser: argparse.ArgumentParser) -> None:
    """Add the recording and the options of solving it."""
    parser.add_argument("recording", nargs="?", metavar="RECORDING", help="samples (.jsonl); default: the embedded one")
    parser.add_argument("--calibration", metavar="JSON", help="from `glsplat tracking calibrate`")
    parser.add_argument("--height", type=float, help="the user's stature in metres, instead of a calibration")
    parser.add_argument(
        "--find-size", action="store_true", help="find the user's size from the recording as it goes on"
    )
    parser.add_argument("--head-only", action="store_true", help="ignore the hands")
    add_solver(parser)
    parser.add_argument("--no-filter", action="store_true", help="switch the One Euro filters off")
    parser.add_argument("--predict-ms", type=float, default=0.0, help="extrapolate to the time of display (0 to 100)")
    add_skeleton(parser)


def skeleton_of(name: str | None) -> Skeleton:
    """Return the skeleton of an avatar, a body's .npz, or the embedded avatar. Raises PoseError."""
    if name is None:
        return default_avatar().skeleton
    if name.endswith(".npz"):
        from glsplat.extras.formats.person import read_skeleton  # here: other files are read without it

        skeleton = read_skeleton(name)
    else:
        skeleton = load_avatar(name, "--avatar").skeleton
    return tracked(skeleton, name)


def pattern_of(text: str, option: str) -> re.Pattern[str]:
    """Return the compiled regular expression. Raises UsageError if it is invalid."""
    try:
        return re.compile(text)
    except re.error as error:
        raise UsageError(f"{option} is not a regular expression ({error})") from None


def samples_of(name: str | None) -> list[Sample]:
    """Return the samples of a recording, by default the embedded one."""
    samples = embedded_recording() if name is None else list(replay(name))
    if not samples:
        raise FormatError(f"{name}: expected tracking samples, one JSON object a line, found none")
    return samples


def tracker_of(args: argparse.Namespace, skeleton: Skeleton) -> Tracker:
    """Return the tracker of the options of ``add_recording``."""
    calibration = Calibration()
    if args.calibration and args.height is not None:
        raise UsageError("--calibration and --height both tell the user's size; give one of them")
    if args.calibration:
        calibration = Calibration.load(args.calibration)
    elif args.height is not None:
        calibration = Calibration.of_height(skeleton, args.height)
    if args.find_size:
        if args.calibration or args.height is not None:
            raise UsageError("--find-size measures what --calibration or --height gives; use one of them")
        calibration = Calibration(automatic=True)
    settings = {"prediction": args.predict_ms / 1000}
    config = TrackerConfig.raw(**settings) if args.no_filter else TrackerConfig(**settings)
    return Tracker(skeleton, calibration, config, solver=args.solver, head_only=args.head_only)


@dataclass(frozen=True, eq=False)
class PoseTrack:
    """Solved (or true) poses of a recording."""

    times: NDArray[np.float64]  # [T] seconds
    rotations: NDArray[np.float64]  # [T, 55, 3] axis-angle
    trans: NDArray[np.float64]  # [T, 3]
    joints: NDArray[np.float64]  # [T, 55, 3] in the world
    reach_error: NDArray[np.float64]  # [T, 2] metres, left and right
    flags: list[list[str]]

    @property
    def rate(self) -> float:
        """Samples per second (median)."""
        return float(1 / np.median(np.diff(self.times))) if len(self.times) > 1 else 0.0


def read_poses(path: str | Path) -> PoseTrack:
    """Read poses of ``tracking solve`` or ``from-motion --truth``. Raises FormatError naming file and line."""
    times, rotations, trans, joints, reach, flags = [], [], [], [], [], []
    for number, data in json_lines(path):
        try:
            if not isinstance(data, dict) or "joints" not in data or "t" not in data:
                raise PoseError('a line of poses needs "t", "joints" and the pose keys')
            pose = Pose.from_smplx({key: value for key, value in data.items() if key != "joints"})
            points = np.asarray(data["joints"], np.float64)
            if points.shape != (len(JOINT_NAMES), 3) or not np.isfinite(points).all():
                raise PoseError(f'"joints" needs {len(JOINT_NAMES)} x 3 finite numbers, found shape {points.shape}')
            times.append(float(data["t"]))
            error = data.get("reach_error") or (0.0, 0.0)
            reach.append((float(error[0] or 0.0), float(error[1] or 0.0)))
        except PoseError as error:
            raise FormatError(f"{path}, line {number}: {error}") from None
        except (TypeError, ValueError, IndexError, KeyError) as error:
            raise FormatError(f"{path}, line {number}: not a line of poses ({error})") from None
        rotations.append(pose.rotations)
        trans.append(pose.trans)
        joints.append(points)
        flags.append([str(flag) for flag in data.get("flags", [])])
    if not times:
        raise FormatError(f"{path}: expected poses, one JSON object a line, found none")
    return PoseTrack(np.array(times), np.array(rotations), np.array(trans), np.array(joints), np.array(reach), flags)
