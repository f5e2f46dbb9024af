"""Files for the preview: read a dropped file or folder by its content, and list the motions that fit a scene."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from itertools import pairwise
from math import isfinite
from pathlib import Path
from statistics import median

import numpy as np

from glsplat.data import embedded_file
from glsplat.errors import FormatError, GlsplatError
from glsplat.formats.format import opened
from glsplat.formats.gltf.container import read_container
from glsplat.formats.gltf.nodes import only_moves
from glsplat.formats.motion_files import are_poses, embedded_motions
from glsplat.formats.registry import sniffed
from glsplat.formats.scene_file import SceneFile, load_scene
from glsplat.motion.motion import Motion
from glsplat.scene import Content, SceneLike
from glsplat.skinning.driven import why_not_driven
from glsplat.skinning.pose import Pose, load_pose
from glsplat.skinning.skeleton import Skeleton
from glsplat.tracking.recording import replay
from glsplat.tracking.tracker import Tracker

from ..args import motion_of

_FIRST_MOTION = "wave-and-turn"
_MAX_JSON_BYTES = 512 << 20


@dataclass(frozen=True, eq=False)
class Dropped:
    """Content of a dropped file, and its label."""

    content: Content | SceneFile | Motion | Pose
    label: str


def shown(scene: SceneLike | SceneFile) -> SceneLike:
    """Return the scene that a renderer draws."""
    return scene.scene if isinstance(scene, SceneFile) else scene


def motion_names(skeleton: Skeleton | None) -> list[str]:
    """Return the names of the embedded motions that fit a skeleton (SMPL-X only)."""
    if why_not_driven(skeleton):
        return []
    return sorted(embedded_motions(), key=lambda name: (name != _FIRST_MOTION, name))


def read_motion(name: str, skeleton: Skeleton) -> Motion:
    """Return a motion: a file, an embedded one by name, or a recording (.jsonl) solved for the skeleton."""
    return _solved(name, skeleton) if name.lower().endswith(".jsonl") else motion_of(name, skeleton)


def _solved(name: str, skeleton: Skeleton) -> Motion:
    """Return the solved poses of a recording, resampled to its median rate by the newest pose."""
    tracker = Tracker(skeleton)
    times, poses = [], []
    for sample in replay(name):
        if isfinite(sample.t):
            times.append(sample.t)
            poses.append(tracker.update(sample))
    if not poses:
        raise FormatError(f"{name}: expected tracking samples with a time, one JSON object a line, found none")
    steps = [later - earlier for earlier, later in pairwise(times) if later > earlier]
    step = max(median(steps), 1e-3) if steps else 1 / 72
    moments = np.maximum.accumulate(times)  # clocks of headsets may run backwards
    count = min(len(poses) * 4, round((moments[-1] - moments[0]) / step) + 1)  # limits the memory for a long gap
    chosen = np.searchsorted(moments, moments[0] + (np.arange(count) + 0.5) * step) - 1
    rotations = np.stack([poses[i].rotations for i in chosen])
    trans = np.stack([poses[i].trans for i in chosen])
    motion = Motion(1 / step, rotations, trans, skeleton.names, Path(name).stem)
    return replace(motion, expressions=tuple(poses[i].expression for i in chosen))


def read_dropped(name: str, skeleton: Skeleton | None) -> Dropped:
    """Return the scene, motion or pose of a file or folder. Raises GlsplatError, which names it."""
    path = embedded_file(name)
    if not path.exists():
        raise FormatError(f"{path}: no such file")
    kind = _kind(path)
    if kind == "scene":
        file = load_scene(path)
        return Dropped(file if file.composed else file.scene.items[0].content, path.name)
    if skeleton is None:
        raise GlsplatError(f"{path.name}: this scene has no skeleton to move; open an avatar (.glb with a skin) first")
    if kind == "pose":
        return Dropped(load_pose(path, skeleton), path.name)
    return Dropped(read_motion(str(path), skeleton), path.name)


def _kind(path: Path) -> str:
    """Return "scene", "motion" or "pose"."""
    if path.is_dir() or path.suffix.lower() == ".jsonl":
        return "motion"
    with opened(path) as start:
        known = sniffed(start)
        if known is not None and known.name == "scene":
            return "scene"
        if are_poses(start) and start.size <= _MAX_JSON_BYTES:
            start.file.seek(0)
            try:
                data = json.loads(start.file.read())
            except (ValueError, RecursionError) as error:
                raise FormatError(f"expected JSON, but {error}") from None
            return "pose" if isinstance(data, dict) and "frames" not in data else "motion"
        if known is None:
            return "scene"  # its reader raises the error
        if known.name in ("glb", "gltf"):
            return "motion" if only_moves(read_container(start.file, start.size, start.folder).gltf) else "scene"
        return "motion" if known.load is None else "scene"
