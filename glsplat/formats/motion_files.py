"""Motions: from files by the registry of formats, those of glsplat, and JSON poses (docs/conventions.md).

JSON poses are a pose object a frame, in one file or in a folder of files.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from glsplat.errors import FormatError, PoseError
from glsplat.formats.format import Format, Opened, opened
from glsplat.formats.registry import sniffed
from glsplat.motion.fitted import body_of, fitted, grounded, turned
from glsplat.motion.motion import Motion
from glsplat.optional import missing, plugin
from glsplat.skinning.driven import why_not_driven
from glsplat.skinning.pose import Pose
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES

KINDS = "JSON poses, BVH, .amc with its .asf, AMASS .npz, a glTF or VRM animation (.glb, .gltf, .vrm, .vrma)"
"""What ``load_motion`` reads, for texts. All but JSON poses are read by glsplat.extras.motions."""

_MAX_BYTES = 512 << 20
_DEFAULT_FPS = 30.0
_SNIFFED = 1 << 16  # bytes


def embedded_motions() -> tuple[str, ...]:
    """Return the names of the motions that come with glsplat, for ``load_motion``."""
    files = resources.files("glsplat.data").iterdir()
    return tuple(sorted(f.name.removesuffix(".json") for f in files if f.name.endswith(".json")))


def load_motion(
    path: str | Path,
    skeleton: Skeleton,
    *,
    forward: bool = False,
    fps: float | None = None,
    animation: str | None = None,
) -> Motion:
    """Read a motion; the format is recognised by content.

    ``path`` is one of:

    - an embedded name ("idle", "walk", ...);
    - a folder of one JSON pose a frame (LHM's layout), one JSON pose, a JSON list of poses, or {"fps", "frames"}. With
      the "joints" [55, 3] of its own body the motion is fitted to other bodies (motion/fitted.py);
    - with glsplat.extras.motions: AMASS .npz (SMPL-H ``poses`` or SMPL-X keys; z up is turned to y up), BVH, .amc with
      its .asf beside it, an animation of a humanoid rig in glTF, or a VRM animation.

    The first of several animations is read. ``animation``, or the end of the path ("all.glb#Run"), is the name or the
    number (from 0) of another; ``Motion.note`` names it. The path may end in corrections of a badly exported file
    ("walk.bvh#up=z#turn=180", extras/motions/corrections.py); extras/motions/doubts.py finds such files. The motion of
    another body is retargeted: it begins above the origin, with its lowest foot on the floor; ``forward`` also turns it
    to face +z. ``fps`` overrides the file's rate.

    Raises PoseError, one line that names the file.
    """
    name = str(path)
    source, choice = (Path(path), animation) if animation is not None else split_choice(name)
    if not source.exists() and re.fullmatch(r"[\w-]+", name):
        return load_embedded_motion(name, skeleton, forward=forward, fps=fps)
    try:
        motion = _read_path(source, skeleton, forward, choice)
        return replace(motion, fps=fps or motion.fps, label=source.stem + motion.label)
    except OSError as error:
        raise PoseError(f"{path}: cannot read the motion ({error.strerror or error})") from None
    except (FormatError, PoseError) as error:
        text = str(error)
        raise PoseError(text if text.startswith(f"{source}") else f"{source}: {text}") from None


def load_embedded_motion(name: str, skeleton: Skeleton, *, forward: bool = False, fps: float | None = None) -> Motion:
    """Read a motion that comes with glsplat, whatever files there are. Raises PoseError for another name."""
    if name not in embedded_motions():
        raise PoseError(f"{name}: no such file and no such motion; embedded are {', '.join(embedded_motions())}")
    if why := why_not_driven(skeleton):
        raise PoseError(f"{name} cannot drive this avatar: {why}")
    with resources.as_file(resources.files("glsplat.data").joinpath(f"{name}.json")) as file:
        return load_motion(file, skeleton, forward=forward, fps=fps)


def split_choice(name: str) -> tuple[Path, str | None]:
    """Return a motion's file, and what stands behind a "#": the name or number of an animation in it."""
    at = name.find("#")
    while at > 0 and not Path(name).exists():
        if Path(name[:at]).is_file():
            return Path(name[:at]), name[at + 1 :]
        at = name.find("#", at + 1)
    return Path(name), None


def _read_path(path: Path, skeleton: Skeleton, forward: bool, choice: str | None) -> Motion:
    module, corrections, more = plugin("motions.corrections"), None, ""
    if module is not None:
        choice, corrections = module.split_corrections(choice)
        more = f" (corrections are {module.HELP})"
    if path.is_dir():
        motion = _read_folder(path, skeleton)
        return motion if corrections is None else corrections.applied(motion, skeleton)
    with opened(path) as start:
        if start.size > _MAX_BYTES:
            raise PoseError(f"a motion file has at most {_MAX_BYTES >> 20} MiB, not {start.size >> 20}")
        known = POSES if are_poses(start) else sniffed(start)
        if known is None or known.read_motion is None:
            if plugin("motions.rows") is None:
                raise PoseError(missing("motions", "a motion that is not JSON poses"))
            raise PoseError(f"expected {KINDS}, but this is {known.title if known else 'none of them'}")
        if choice is not None and known.load is None:  # a file of motions alone holds one
            raise PoseError(f"only glTF has several motions in a file; leave out #{choice[:40]}{more}")
        return known.read_motion(start, skeleton, forward, choice, corrections)


def are_poses(start: Opened) -> bool:
    """Return whether a file is JSON, but no glTF: what ``load_motion`` reads as poses, so that errors name its keys."""
    text = _json_text(start)
    return text[:1] in (b"[", b"{") and b'"asset"' not in text


def _read_folder(folder: Path, skeleton: Skeleton) -> Motion:
    """Read a folder of one JSON pose a frame, in the order of the numbers in their names. Raises PoseError."""
    files = sorted(folder.glob("*.json"), key=lambda p: [int(n) for n in re.findall(r"\d+", p.stem)] or [0])
    if not files:
        raise PoseError("a motion folder holds one .json a frame, found none")
    frames = [_parsed(file.read_bytes(), str(file)) for file in files]
    return _of_frames(frames, _DEFAULT_FPS, skeleton, list(map(str, files)))


def _read_poses(start: Opened, skeleton: Skeleton, _forward: bool, _choice: str | None, corrections: Any) -> Motion:
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


POSES = Format(name="poses", title="JSON poses", suffixes=(), sniff=_sniff, read_motion=_read_poses)


def add_formats(formats: dict[str, Format]) -> None:
    """Add JSON poses to the registry."""
    formats[POSES.name] = POSES
