"""Motions from files of many makers' formats (kinds.py), and those that come with glsplat."""

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
from glsplat.extras.motions.amass import read_amass
from glsplat.extras.motions.bvh import parse_acclaim, parse_bvh, skeleton_file
from glsplat.extras.motions.corrections import HELP, Corrections, split_corrections
from glsplat.extras.motions.fitted import body_of, fitted
from glsplat.extras.motions.gltf import read_animation
from glsplat.extras.motions.placed import grounded, turned
from glsplat.extras.motions.retarget import retarget, stretched
from glsplat.motion.kinds import KINDS, is_bvh, is_gltf, split_choice
from glsplat.motion.motion import Motion
from glsplat.skinning.driven import why_not_driven
from glsplat.skinning.pose import Pose
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES

__all__ = ["embedded_motions", "load_embedded_motion", "load_motion"]

_DEFAULT_FPS = 30.0
_MAX_BYTES = 512 << 20
_HEAD = 4096  # bytes that tell the format


def embedded_motions() -> tuple[str, ...]:
    """Names of the motions that come with glsplat, for ``load_motion``."""
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

    Embedded names ("idle", "walk", ...); a folder of one JSON pose a frame (LHM's layout), one JSON pose, a JSON list
    of poses or {"fps", "frames"}, which is fitted to other bodies (fitted.py) where it also has the "joints" [55, 3] of
    the one it was made for; AMASS .npz (SMPL-H ``poses`` or SMPL-X keys; z up is turned to y up); BVH; .amc with its
    .asf beside it; an animation of a humanoid rig in glTF, or a VRM animation. Of several in a file the first;
    ``animation``, or what stands behind the path ("all.glb#Run"), is the name or the number (from 0) of another, and
    ``note`` says which it is. So do corrections ("walk.bvh#up=z#turn=180", corrections.py) of files that are not read
    as they were meant, which doubts.py tells. The motion of another body is retargeted (retarget.py), begins above the
    origin and has its lowest foot on the floor; ``forward`` also turns it to face +z. ``fps`` overrides what the file
    says.

    Raises PoseError, one line that names the file.
    """
    name = str(path)
    source, chosen = (Path(path), animation) if animation is not None else split_choice(name)
    if not source.exists() and re.fullmatch(r"[\w-]+", name):
        return load_embedded_motion(name, skeleton, forward=forward, fps=fps)
    try:
        chosen, corrected = split_corrections(chosen)
        motion = _read(source, skeleton, forward, chosen, corrected)
        rate, label = fps or corrected.fps or motion.fps, source.stem + motion.label
        return replace(motion, fps=rate, label=label, known_up=motion.known_up or corrected.up != "y")
    except OSError as error:
        raise PoseError(f"{path}: cannot read the motion ({error.strerror or error})") from None
    except (FormatError, PoseError) as error:
        text = str(error)
        raise PoseError(text if text.startswith(f"{source}") else f"{source}: {text}") from None


def load_embedded_motion(name: str, skeleton: Skeleton, *, forward: bool = False, fps: float | None = None) -> Motion:
    """A motion that comes with glsplat, whatever files there are. Raises PoseError for another name."""
    if name not in embedded_motions():
        raise PoseError(f"{name}: no such file and no such motion; embedded are {', '.join(embedded_motions())}")
    if why := why_not_driven(skeleton):
        raise PoseError(f"{name} cannot drive this avatar: {why}")
    with resources.as_file(resources.files("glsplat.data").joinpath(f"{name}.json")) as file:
        return load_motion(file, skeleton, forward=forward, fps=fps)


def _read(path: Path, skeleton: Skeleton, forward: bool, chosen: str | None, corrected: Corrections) -> Motion:
    if path.is_dir():
        files = sorted(path.glob("*.json"), key=lambda p: [int(n) for n in re.findall(r"\d+", p.stem)] or [0])
        if not files:
            raise PoseError("a motion folder holds one .json a frame, found none")
        motion = _of_frames([_json(file) for file in files], _DEFAULT_FPS, skeleton, [str(f) for f in files])
        return _corrected(motion, skeleton, corrected)
    if path.stat().st_size > _MAX_BYTES:
        raise PoseError(f"a motion file has at most {_MAX_BYTES >> 20} MiB, not {path.stat().st_size >> 20}")
    with open(path, "rb") as file:
        head = file.read(_HEAD)
    text = head.lstrip(b"\xef\xbb\xbf \t\r\n")
    if is_gltf(head):
        clip = read_animation(path, chosen)
    elif chosen is not None:
        raise PoseError(f"only glTF has several motions in a file; leave out #{chosen[:40]} (corrections are {HELP})")
    elif head.startswith(b"PK"):
        return _corrected(read_amass(path, skeleton, forward), skeleton, corrected, ground=True)
    elif is_bvh(head):
        clip = parse_bvh(path.read_text(encoding="latin-1"))
    elif text.startswith((b"#!OML", b":FULLY", b":DEGREES")) or path.suffix.lower() == ".amc":
        bones = skeleton_file(path)
        clip = parse_acclaim(bones.read_text(encoding="latin-1"), path.read_text(encoding="latin-1"))
    elif text.startswith((b"{", b"[")):
        return _corrected(_of_json(_json(path), skeleton), skeleton, corrected)
    else:
        raise PoseError(f"expected {KINDS}, but this is none of them")
    rotations, trans = retarget(clip, skeleton, forward=forward, world=corrected.world, swapped=corrected.swapped)
    note = "; ".join(line for line in (clip.note, stretched(clip)) if line)
    motion = Motion(clip.fps, rotations, trans, label=clip.label, note=note, known_up=clip.y_up)
    return _corrected(motion, skeleton, replace(corrected, up="y", swapped=False), ground=True)


def _corrected(motion: Motion, skeleton: Skeleton, said: Corrections, *, ground: bool = False) -> Motion:
    """The motion as the user says that it is meant; ``ground``: with its feet on the floor, said or not."""
    if said.swapped:
        raise PoseError("sides=swapped is for skeletons of other makers, not for poses by SMPL-X's joints")
    rotations, trans = motion.rotations, motion.trans
    if said.up != "y":
        rotations, trans = turned(rotations, trans, said.world, skeleton)
    if said.turn:
        rotations, _ = turned(rotations, trans, said.about, skeleton)
    trans = trans * said.scale
    if ground or said.floor or said.up != "y":  # where the floor was along another axis is not known
        trans = grounded(rotations, trans, skeleton)
    return replace(motion, rotations=rotations, trans=trans)


def _json(path: Path) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise PoseError(f"{path}: a motion is JSON here, but {error}") from None


def _of_json(data: Any, skeleton: Skeleton) -> Motion:
    fps = _DEFAULT_FPS
    frames, made_for = data, None
    if isinstance(data, Mapping):
        if "joints" in data:
            made_for = body_of(data["joints"])
        if "frames" in data:
            frames = data["frames"]
            try:
                fps = float(data.get("fps", _DEFAULT_FPS))
            except (TypeError, ValueError):
                raise PoseError(f'"fps" is a number, not {data["fps"]!r}') from None
        else:
            frames = [data]
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
        Motion(fps, rotations, trans, skeleton.names)
        trans = grounded(rotations, trans, skeleton)
    faces = tuple(p.expression for p in poses) if any(p.expression for p in poses) else ()
    return Motion(fps, rotations, trans, skeleton.names, expressions=faces)
