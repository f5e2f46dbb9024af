"""Motions as JSON: a pose object a frame (docs/conventions.md), in one file or in a folder of files."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from glsplat.errors import PoseError
from glsplat.formats.format import Format, Opened
from glsplat.motion.fitted import body_of, fitted, grounded, turned
from glsplat.motion.motion import Motion
from glsplat.skinning.pose import Pose
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES

_DEFAULT_FPS = 30.0
_SNIFFED = 1 << 16  # bytes


def are_poses(start: Opened) -> bool:
    """Return whether a file is JSON, but no glTF: what ``load_motion`` reads as poses, so that errors name its keys."""
    text = _json_text(start)
    return text[:1] in (b"[", b"{") and b'"asset"' not in text


def read_folder(folder: Path, skeleton: Skeleton) -> Motion:
    """Read a folder of one JSON pose a frame, in the order of the numbers in their names. Raises PoseError."""
    files = sorted(folder.glob("*.json"), key=lambda p: [int(n) for n in re.findall(r"\d+", p.stem)] or [0])
    if not files:
        raise PoseError("a motion folder holds one .json a frame, found none")
    frames = [_parsed(file.read_bytes(), str(file)) for file in files]
    return _of_frames(frames, _DEFAULT_FPS, skeleton, list(map(str, files)))


def _read(start: Opened, skeleton: Skeleton, _forward: bool, _choice: str | None, corrections: Any) -> Motion:
    start.file.seek(0)
    motion = _of_json(_parsed(start.file.read(), start.name), skeleton)
    return motion if corrections is None else corrections.applied(motion, skeleton)


def _sniff(start: Opened) -> bool:
    text = _json_text(start)
    return text[:1] in (b"[", b"{") and (b'"frames"' in text or b'"body_pose"' in text) and b'"asset"' not in text


def _json_text(start: Opened) -> bytes:
    return start.begin(_SNIFFED).removeprefix(b"\xef\xbb\xbf").lstrip()


def _parsed(data: bytes, name: str) -> Any:
    try:
        return json.loads(data)
    except (ValueError, RecursionError) as error:
        raise PoseError(f"{name}: a motion is JSON here, but {error}") from None


def _of_json(data: Any, skeleton: Skeleton) -> Motion:
    fps, frames, made_for = _DEFAULT_FPS, data, None
    if isinstance(data, Mapping):
        if "joints" in data:
            made_for = body_of(data["joints"])
        frames = data.get("frames", [data])
        if "frames" in data:
            try:
                fps = float(data.get("fps", _DEFAULT_FPS))
            except (TypeError, ValueError):
                raise PoseError(f'"fps" is a number, not {data["fps"]!r}') from None
    if not isinstance(frames, list):
        raise PoseError(f'"frames" is a list of poses, not {type(frames).__name__}')
    motion = _of_frames(frames, fps, skeleton, [f"frame {i}" for i in range(len(frames))])
    if made_for is None or skeleton.names != JOINT_NAMES:
        return motion
    return replace(motion, trans=fitted(motion.rotations, motion.trans, made_for, skeleton))


def _of_frames(frames: Sequence[Any], fps: float, skeleton: Skeleton, where: Sequence[str]) -> Motion:
    if not frames:
        raise PoseError("a motion needs at least one frame, found none")
    poses = []
    for frame, place in zip(frames, where, strict=True):
        try:
            poses.append(Pose.from_json(frame, skeleton))
        except PoseError as error:
            raise PoseError(f"{place}: {error}") from None
    if any(p.translations is not None for p in poses):
        raise PoseError('"translations" belong to single poses; a motion holds rotations and trans')
    rotations, trans = np.stack([p.rotations for p in poses]), np.stack([p.trans for p in poses])
    if isinstance(frames[0], Mapping) and "focal" in frames[0]:
        # LHM's files come from video: the person in the camera's frame (y down, z away)
        rotations, trans = turned(rotations, trans, np.diag([1.0, -1.0, -1.0]), skeleton)
        trans = trans - trans[0] * (1, 0, 1)
        Motion(fps, rotations, trans, skeleton.names)  # refuse bad numbers before the feet are measured
        trans = grounded(rotations, trans, skeleton)
    faces = tuple(p.expression for p in poses) if any(p.expression for p in poses) else ()
    return Motion(fps, rotations, trans, skeleton.names, expressions=faces)


POSES = Format(name="poses", title="JSON poses", suffixes=(), sniff=_sniff, read_motion=_read)


def add_formats(formats: dict[str, Format]) -> None:
    """Add JSON poses to the registry."""
    formats[POSES.name] = POSES
