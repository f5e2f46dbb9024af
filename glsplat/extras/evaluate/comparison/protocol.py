"""The protocol of a comparison (docs/evaluation.md): tasks, views, sizes and measures; performances of the tasks.

A performance is a participant's motion with the moments at which avatars are compared. An avatar's poses there come
from the true pose, or from head and hands alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from glsplat.arrays import F64
from glsplat.camera import PAPER_IPD, Camera, look_at, pinhole, stereo_cameras
from glsplat.errors import GlsplatError, PoseError
from glsplat.extras.evaluate.avatar_score import pose_of, poses_of
from glsplat.extras.motions.derive import derive, truth_from_motion
from glsplat.formats.motion_files import load_motion
from glsplat.meshes import RiggedMesh
from glsplat.motion.motion import Motion
from glsplat.rotations import slerp
from glsplat.skinning.pose import Pose
from glsplat.skinning.skeleton import Skeleton
from glsplat.tracking.config import TrackerConfig
from glsplat.tracking.sample import Sample
from glsplat.tracking.solve.body import Body
from glsplat.tracking.tracker import Tracker

RATE = 72.0  # samples of head and hands per second, a headset's display rate

_STAND, _MOVE, _HOLD = 1.0, 0.8, 0.7  # seconds: standing first, moving to a pose, holding it
TASKS = poses_of("""
standing: left_shoulder 0 0.1 -1.15, left_elbow 0 -0.25 0, fists 0.25
arms sideways: left_shoulder 0 0 -0.05, head 0 -0.35 0
waving: left_shoulder 0 0.1 -1.15, left_elbow 0 -0.25 0, right_shoulder 0 0.35 -0.15,
  right_elbow 0 0.5 -1.55, right_wrist 0 0 0.2, head 0 -0.25 0.08, spine2 0 0 0.05, fists 0.25
hands on hips: left_shoulder 1 0.1 -0.85, left_elbow 0 -1.5 0, left_wrist 0 0 -0.3, fists 0.25
reaching forward: left_shoulder 0 -1.25 -0.15, left_elbow 0 -0.25 0, spine1 0.15 0 0, head -0.1 0 0
arms overhead: left_collar 0 0 0.2, left_shoulder 0 -0.1 1, left_elbow 0 -0.2 0
turning: spine1 0 0.2 0, spine2 0 0.2 0, spine3 0 0.15 0, head 0 0.4 0, left_shoulder 0 0.2 -0.8,
  left_elbow 0 -1.2 0, right_shoulder 0 0.6 0.8, right_elbow 0 1.4 0, fists 0.25
bending the knees: left_hip -0.75 0 0.12, left_knee 1.2 0 0, left_ankle -0.45 0 -0.1,
  spine1 0.2 0 0, left_shoulder 0 -0.6 -0.7, left_elbow 0 -0.7 0, head -0.15 0 0, fists 0.25
""")
"""Joint rotations by task: tasks before a mirror without stepping (paper, section 4.2)."""

CONTROLS = ("tracking", "pose")
"""From head and hands through the solver, as for users; from the true pose, which no headset knows."""

VIEWS: Mapping[str, float] = {"front": 0.0, "left": 90.0, "back": 180.0, "right": 270.0}
"""Azimuth of the camera in degrees by the visible side of the person, growing towards the left hand."""

_DISTANCE = 3.0  # metres from the middle of the figure
LIGHTS = ("none", "capture")
EXTRA_MEASURES = ("flip", "lpips-vgg")  # optional measures; they cost more than all others together


@dataclass(frozen=True, eq=False)
class Performance:
    """A motion at RATE of one person's skeleton, soles on y = 0, with the moments of comparison."""

    rotations: F64  # [T, J, 3] axis-angle
    trans: F64  # [T, 3] metres
    moments: tuple[int, ...]  # frames
    names: tuple[str, ...]  # of the moments

    def pose(self, moment: int) -> Pose:
        """Return the true pose at a moment, by its index into ``moments``."""
        frame = self.moments[moment]
        return Pose(self.rotations[frame], self.trans[frame])


def perform(mesh: RiggedMesh, names: tuple[str, ...] = tuple(TASKS)) -> Performance:
    """Return a performance of tasks by a person who begins standing, moves smoothly to each pose, and holds it."""
    skeleton = mesh.skeleton
    keys = [pose_of(TASKS[name], skeleton).rotations for name in ("standing", *names)]
    used = np.unique(mesh.faces)
    heights = [-float(mesh.posed(Pose(turned))[used, 1].min()) for turned in keys]  # the lowest vertex is on y = 0
    rotations, heads, moments = [np.repeat(keys[0][None], _frames(_STAND), axis=0)], [], []
    heads.append(np.full(_frames(_STAND), heights[0]))
    for index in range(len(names)):
        part = np.arange(1, _frames(_MOVE) + 1) / _frames(_MOVE)
        part = part * part * (3 - 2 * part)
        part = np.concatenate([part, np.ones(_frames(_HOLD))])
        rotations.append(slerp(keys[index][None], keys[index + 1][None], part[:, None]))
        heads.append(heights[index] + part * (heights[index + 1] - heights[index]))
        moments.append(sum(map(len, rotations)) - 1)
    up = np.concatenate(heads)
    trans = np.stack([np.zeros_like(up), up, np.zeros_like(up)], axis=1)
    return Performance(np.concatenate(rotations), trans, tuple(moments), names)


def perform_motion(source: str | Path, skeleton: Skeleton, count: int) -> Performance:
    """Return a motion file or an embedded motion with ``count`` evenly spaced moments. Raises PoseError."""
    motion: Motion = load_motion(source, skeleton, forward=True).resampled(RATE)
    frames = len(motion)
    moments = tuple(int((index + 0.5) / count * frames) for index in range(count))
    names = tuple(f"{frame / RATE:.1f} s" for frame in moments)
    return Performance(motion.rotations, motion.trans, moments, names)


def _frames(seconds: float) -> int:
    return round(seconds * RATE)


def recorded(performance: Performance, skeleton: Skeleton) -> list[Sample]:
    """Return an ideal headset's samples of the performer at RATE. Raises PoseError unless the rig is SMPL-X's."""
    ground = np.array([0.0, Body.of(skeleton).ground, 0.0])
    truth = truth_from_motion(skeleton, performance.rotations, performance.trans + ground, RATE, RATE)
    return derive(skeleton, truth)


def tracked(samples: list[Sample], moments: tuple[int, ...], skeleton: Skeleton) -> list[Pose]:
    """Return poses of an avatar's ``skeleton`` at ``moments`` (indices), tracked through all samples before them."""
    tracker = Tracker(skeleton, config=TrackerConfig(arm_scaling=0))  # compare avatars with their own limbs
    poses = []
    for index, sample in enumerate(samples[: max(moments) + 1]):
        pose = tracker.update(sample)
        if index in moments:
            poses.append(pose)
    return poses


def true_poses(performance: Performance, performer: Skeleton, skeleton: Skeleton) -> list[Pose]:
    """Return the performer's rotations, by joint name, and translations. Raises PoseError without a common joint."""
    index = {name: i for i, name in enumerate(performer.names)}
    known = [(i, index[name]) for i, name in enumerate(skeleton.names) if name in index]
    if not known:
        raise PoseError(
            f"no joint of the avatar ({', '.join(skeleton.names[:4])}, ...) has a name of the participant's"
        )
    own, theirs = np.array(known).T
    poses = []
    for moment in range(len(performance.moments)):
        pose = performance.pose(moment)
        rotations = np.zeros((len(skeleton), 3))
        rotations[own] = pose.rotations[theirs]
        poses.append(Pose(rotations, pose.trans))
    return poses


@dataclass(frozen=True, slots=True, kw_only=True)
class Protocol:
    """Settings that are the same for all methods. Raises GlsplatError for invalid ones."""

    tasks: tuple[str, ...] = tuple(TASKS)
    motion: str | None = None  # a motion file or name instead of the tasks; ``moments`` of it are drawn
    motion_digest: str = ""  # of the motion file
    moments: int = 8
    views: tuple[str, ...] = tuple(VIEWS)
    size: int = 512  # side of an eye's picture in pixels
    fill: float = 0.88  # share of the picture that the figure takes, in its longer direction
    ipd: float = PAPER_IPD  # metres between the eyes
    light: str = "none"  # of the truth: "none", its textures' own colours; "capture", as in the photograph
    extra_measures: tuple[str, ...] = ()  # measures beyond those of the paper

    def __post_init__(self) -> None:
        if not 64 <= self.size <= 2048:
            raise GlsplatError(f"pictures need 64 to 2048 pixels a side, not {self.size}")
        if self.light not in LIGHTS:
            raise GlsplatError(f"the light is one of {', '.join(LIGHTS)}, not {self.light!r:.30}")
        for name, known in (("tasks", TASKS), ("views", VIEWS)):
            wrong = [word for word in getattr(self, name) if word not in known]
            if wrong or not getattr(self, name):
                raise GlsplatError(f"{name} are some of {', '.join(known)}, not {wrong[0] if wrong else 'none'!r:.40}")
        if strange := set(self.extra_measures) - set(EXTRA_MEASURES):
            raise GlsplatError(f"further measures are {', '.join(EXTRA_MEASURES)}, not {min(strange)!r:.30}")
        if not 1 <= self.moments <= 100:
            raise GlsplatError(f"a motion needs 1 to 100 moments, not {self.moments}")

    def to_json(self) -> dict[str, Any]:
        """Return a JSON object, which is equal for equal protocols."""
        return {key: list(value) if isinstance(value, tuple) else value for key, value in asdict(self).items()}


def eyes(points: F64, view: str, protocol: Protocol) -> tuple[Camera, Camera]:
    """Return both eyes' cameras before the figure ``points`` [N, 3] (metres), level with its middle, on black."""
    centre = (points.max(axis=0) + points.min(axis=0)) / 2
    turn = np.radians(VIEWS[view])
    viewmat = look_at(centre + _DISTANCE * np.array([np.sin(turn), 0, np.cos(turn)]), centre)
    seen = points @ viewmat[:3, :3].T + viewmat[:3, 3]
    half = np.abs(seen[:, :2] / np.maximum(seen[:, 2:], 0.1)).max() / protocol.fill
    fov = float(2 * np.degrees(np.arctan(min(half, 3.0))))
    head = np.linalg.inv(viewmat) @ np.diag([1.0, -1.0, -1.0, 1.0])  # OpenXR axes: y up, looking along -z
    size = protocol.size
    return stereo_cameras(head, protocol.ipd, K=pinhole(size, size, fov), size=(size, size))
