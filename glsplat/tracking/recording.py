"""Recordings: tracking samples and solved poses as JSON Lines, one object a line."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError, PoseError
from glsplat.io.files import open_regular, replace_file
from glsplat.skinning.pose import Pose
from glsplat.skinning.smplx import JOINT_NAMES
from glsplat.tracking.sample import Sample

__all__ = ["PoseTrack", "embedded_recording", "read_poses", "record", "replay", "write_lines"]

MAX_LINE_BYTES = 1 << 20


def record(path: str | Path, samples: Iterable[Sample], digits: int = 6) -> int:
    """Write samples and return their number; the file appears when it is complete."""
    return write_lines(path, (sample.to_json() for sample in samples), digits)


def replay(path: str | Path) -> Iterator[Sample]:
    """Yield the samples of a recording in the file's order; the tracker judges their time stamps.

    Raises FormatError naming file and line for what is not a sample.
    """
    for number, data in _objects(path):
        if isinstance(data, dict) and data.get("t") is None:
            raise FormatError(f"{path}, line {number}: a recorded sample needs its time, t in seconds")
        try:
            yield Sample.from_json(data)
        except PoseError as error:
            raise FormatError(f"{path}, line {number}: {error}") from None


def embedded_recording() -> list[Sample]:
    """Return the recording that comes with glsplat: 72 Hz, derived from its own motions."""
    with resources.as_file(resources.files("glsplat.data").joinpath("recording.jsonl")) as path:
        return list(replay(path))


def write_lines(path: str | Path, objects: Iterable[dict[str, Any]], digits: int = 6) -> int:
    """Write JSON Lines with numbers rounded to ``digits`` decimals, NaN as null; return the number of lines."""
    count = 0

    def lines() -> Iterator[bytes]:
        nonlocal count
        for item in objects:
            count += 1
            yield json.dumps(_rounded(item, digits), separators=(",", ":")).encode() + b"\n"

    replace_file(path, lines())
    return count


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
        """Samples a second (median)."""
        return float(1 / np.median(np.diff(self.times))) if len(self.times) > 1 else 0.0


def read_poses(path: str | Path) -> PoseTrack:
    """Read poses of ``tracking solve`` or ``from-motion --truth``. Raises FormatError naming file and line."""
    times, rotations, trans, joints, reach, flags = [], [], [], [], [], []
    for number, data in _objects(path):
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


def _objects(path: str | Path) -> Iterator[tuple[int, Any]]:
    with open_regular(path) as (file, _):
        for number, line in enumerate(iter(lambda: file.readline(MAX_LINE_BYTES + 1), b""), 1):
            if len(line) > MAX_LINE_BYTES:
                raise FormatError(f"{path}, line {number}: a line has at most {MAX_LINE_BYTES >> 10} KiB")
            if not line.strip():
                continue
            try:
                yield number, json.loads(line)
            except (ValueError, RecursionError) as error:
                raise FormatError(
                    f"{path}, line {number}: a recording holds one JSON object a line, but {error}"
                ) from None


def _rounded(value: Any, digits: int) -> Any:
    if isinstance(value, float):
        return round(value, digits) if value == value and abs(value) != float("inf") else None
    if isinstance(value, dict):
        return {key: _rounded(item, digits) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_rounded(item, digits) for item in value]
    return value
