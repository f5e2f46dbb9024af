"""Motion: a pose for every moment, from a file of many makers' formats (kinds.py), or one that comes with glsplat."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError, PoseError
from glsplat.io.npz import read_arrays
from glsplat.motion.bvh import parse_acclaim, parse_bvh, skeleton_file
from glsplat.motion.corrections import HELP, Corrections, split_corrections
from glsplat.motion.fitted import body_of, fitted
from glsplat.motion.gltf import read_animation
from glsplat.motion.kinds import KINDS, is_bvh, is_gltf, split_choice
from glsplat.motion.retarget import retarget, stretched
from glsplat.rotations import (
    quaternion_of,
    quaternion_product,
    quaternion_vectors,
    rotation_matrices,
    slerp,
    vector_quaternions,
)
from glsplat.skinning.expression import mixed
from glsplat.skinning.pose import Pose
from glsplat.skinning.rigs.driven import why_not_driven
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES, POSE_KEYS

__all__ = ["Motion", "embedded_motions", "load_embedded_motion", "load_motion"]

F64 = NDArray[np.float64]

DEFAULT_FPS = 30.0
_DEGREES = 4 * np.pi  # an angle beyond two turns was not meant in radians
_MAX_BYTES = 512 << 20
_HEAD = 4096  # bytes that tell the format
_STANDING = 20  # percent of the frames in which the lower foot may be below the floor
_FEET = ("left_ankle", "right_ankle", "left_foot", "right_foot")


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """T poses at a constant rate for a rig of J joints."""

    fps: float
    rotations: F64  # [T, J, 3] axis-angle, radians
    trans: F64  # [T, 3] metres
    names: tuple[str, ...] = JOINT_NAMES
    label: str = field(default="", compare=False)
    note: str = field(default="", compare=False)
    """What a user should know: of several in a file, which one this is; what was left out of it."""
    known_up: bool = field(default=False, compare=False)
    """The format says what is up, as glTF does, or the user."""
    expressions: tuple[Mapping[str, float], ...] = ()
    """T weights of an avatar's shapes by name; empty: none in any frame."""

    def __post_init__(self) -> None:
        frames, joints = len(self.rotations), len(self.names)
        if self.rotations.shape != (frames, joints, 3) or self.trans.shape != (frames, 3):
            raise PoseError(
                f"a motion of {joints} joints needs rotations (T, {joints}, 3) and trans (T, 3), "
                f"not {self.rotations.shape} and {self.trans.shape}"
            )
        if len(self.expressions) not in (0, frames):
            raise PoseError(
                f"a motion of {frames} frames needs as many expressions, or none, not {len(self.expressions)}"
            )
        if not frames:
            raise PoseError("a motion needs at least one frame, found none")
        if not (np.isfinite(self.fps) and 1e-3 <= self.fps <= 1e5):
            raise PoseError(f"a motion needs a frame rate above zero, not {self.fps:g}")
        for value in (self.rotations, self.trans):
            bad = ~np.isfinite(value).reshape(frames, -1).all(axis=1)
            if bad.any():
                raise PoseError(f"frame {int(bad.argmax())} holds NaN or infinity; a motion needs finite numbers")
        angle = np.linalg.norm(self.rotations, axis=2).max(axis=1)
        if angle.max() > _DEGREES:
            worst = int(angle.argmax())
            raise PoseError(f"frame {worst} turns a joint by {angle[worst]:.0f} rad; angles are radians, not degrees")

    def __len__(self) -> int:
        return len(self.rotations)

    @property
    def duration(self) -> float:
        """Seconds of one round: frames / fps."""
        return len(self) / self.fps

    def pose(self, frame: int) -> Pose:
        """The pose of a frame; negative indices count from the end."""
        if not -len(self) <= frame < len(self):
            raise PoseError(f"frame {frame} does not exist; this motion has {len(self)}")
        return Pose(self.rotations[frame], self.trans[frame], expression=self._face(frame % len(self)))

    def _face(self, first: int, second: int = 0, part: float = 0.0) -> Mapping[str, float]:
        """The expression of a frame, or of ``part`` of the way to the ``second``."""
        if not self.expressions:
            return {}
        return mixed(self.expressions[first], self.expressions[second], part) if part else self.expressions[first]

    def at(self, seconds: float, loop: bool = True) -> Pose:
        """The pose at a time: rotations by slerp, translation linearly.

        ``loop`` repeats with the period ``duration`` (the last frame leads back to the first); else time is clamped.
        """
        if not np.isfinite(seconds):
            raise PoseError(f"a time needs to be finite, not {seconds}")
        count = len(self)
        at = seconds * self.fps
        at = at % count if loop else min(max(at, 0.0), count - 1.0)
        first = min(int(at), count - 1)
        second = (first + 1) % count if loop else min(first + 1, count - 1)
        part = min(max(at - first, 0.0), 1.0)
        if part == 0 or first == second:
            return self.pose(first)
        rotations = slerp(self.rotations[first], self.rotations[second], part)
        trans = self.trans[first] * (1 - part) + self.trans[second] * part
        return Pose(rotations, trans, expression=self._face(first, second, part))

    def resampled(self, fps: float) -> Motion:
        """The same motion at another rate (slerp)."""
        count = max(1, round((len(self) - 1) * fps / self.fps) + 1)
        times = np.minimum(np.arange(count) / fps * self.fps, len(self) - 1)
        if len(self) == 1:
            return Motion(fps, self.rotations, self.trans, self.names, self.label, expressions=self.expressions)
        frames = np.arange(len(self))
        first = np.minimum(times.astype(np.intp), len(self) - 2)
        rotations = slerp(self.rotations[first], self.rotations[first + 1], (times - first)[:, None])
        trans = np.stack([np.interp(times, frames, column) for column in self.trans.T], axis=1)
        parts = zip(first.tolist(), (times - first).tolist(), strict=True) if self.expressions else ()
        faces = tuple(self._face(i, i + 1, part) for i, part in parts)
        return Motion(fps, rotations, trans, self.names, self.label, expressions=faces)


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
        motion = _of_frames([_json(file) for file in files], DEFAULT_FPS, skeleton, [str(f) for f in files])
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
        return _corrected(_amass(path, skeleton, forward), skeleton, corrected, ground=True)
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
        rotations, trans = _turned(rotations, trans, said.world, skeleton)
    if said.turn:
        rotations, _ = _turned(rotations, trans, said.about, skeleton)
    trans = trans * said.scale
    if ground or said.floor or said.up != "y":  # where the floor was along another axis is not known
        trans = _grounded(rotations, trans, skeleton)
    return replace(motion, rotations=rotations, trans=trans)


def _json(path: Path) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise PoseError(f"{path}: a motion is JSON here, but {error}") from None


def _of_json(data: Any, skeleton: Skeleton) -> Motion:
    fps = DEFAULT_FPS
    frames, made_for = data, None
    if isinstance(data, Mapping):
        if "joints" in data:
            made_for = body_of(data["joints"])
        if "frames" in data:
            frames = data["frames"]
            try:
                fps = float(data.get("fps", DEFAULT_FPS))
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
        rotations, trans = _turned(rotations, trans, np.diag([1.0, -1.0, -1.0]), skeleton)
        trans = trans - trans[0] * (1, 0, 1)
        Motion(fps, rotations, trans, skeleton.names)
        trans = _grounded(rotations, trans, skeleton)
    faces = tuple(p.expression for p in poses) if any(p.expression for p in poses) else ()
    return Motion(fps, rotations, trans, skeleton.names, expressions=faces)


def _turned(rotations: F64, trans: F64, turn: F64, skeleton: Skeleton) -> tuple[F64, F64]:
    """A motion in a turned world: x' = Q x for x = R (v - J0) + J0 + t."""
    root = skeleton.joints[0]
    out = np.array(rotations)
    turned = quaternion_product(quaternion_of(turn), vector_quaternions(rotations[:, 0]))
    out[:, 0] = quaternion_vectors(turned)
    return out, (trans + root) @ turn.T - root


def _grounded(rotations: F64, trans: F64, skeleton: Skeleton) -> F64:
    """``trans`` shifted so that the lower foot stands as high as in the zero pose most of the time it stands.

    The height is a low percentile over the frames, not the minimum: a toe that bends down would lift the rest.
    """
    feet = [i for i, name in enumerate(skeleton.names) if name in _FEET]
    if not feet:
        return trans
    step = max(1, len(trans) // 300)
    rest = skeleton.joints[feet, 1]
    lowest = [
        float((skeleton.forward(turn, shift)[feet, 1, 3] - rest).min())
        for turn, shift in zip(rotations[::step], trans[::step], strict=True)
    ]
    return trans - np.array([0, np.percentile(lowest, _STANDING), 0])


_AMASS_KEYS = (
    *("root_orient", "pose_body", "pose_jaw", "pose_eye", "pose_hand"),  # SMPL-X
    *("poses", "trans", "mocap_framerate", "mocap_frame_rate"),
)


def _amass(path: Path, skeleton: Skeleton, forward: bool) -> Motion:
    if why := why_not_driven(skeleton):
        raise PoseError(f"AMASS cannot drive this avatar: {why}")
    try:
        with open(path, "rb") as file:
            found = read_arrays(file, "an AMASS motion", (), optional=_AMASS_KEYS, error=PoseError)
        data = {key: np.asarray(array, np.float64) for key, array in found.items()}
    except (TypeError, ValueError) as error:
        raise PoseError(f"an AMASS motion is an .npz of numbers, but {error}") from None
    if "pose_body" not in data and "poses" not in data:
        raise PoseError("an AMASS motion needs poses, or root_orient and pose_body; found neither")
    frames = len(data.get("pose_body", data.get("poses", ())))
    rotations = np.zeros((frames, len(JOINT_NAMES), 3))
    if "pose_body" in data:
        if "root_orient" not in data:
            raise PoseError("an AMASS motion with pose_body needs root_orient")
        rotations[:, POSE_KEYS["root_pose"]] = _shaped(data, "root_orient", frames, 1)
        rotations[:, POSE_KEYS["body_pose"]] = _shaped(data, "pose_body", frames, 21)
        if "pose_jaw" in data:
            rotations[:, POSE_KEYS["jaw_pose"]] = _shaped(data, "pose_jaw", frames, 1)
        if "pose_eye" in data:
            rotations[:, 23:25] = _shaped(data, "pose_eye", frames, 2)
        if "pose_hand" in data:
            rotations[:, 25:55] = _shaped(data, "pose_hand", frames, 30)
    else:
        width = data["poses"].shape[1] if data["poses"].ndim == 2 else 0
        if width not in (72, 156, 165):
            raise PoseError(f"poses need 156 numbers a frame (SMPL-H; 72 or 165 work too), found {data['poses'].shape}")
        count = width // 3
        poses = _shaped(data, "poses", frames, count)
        if count == 52:  # SMPL-H: body, then both hands
            rotations[:, :22], rotations[:, 25:] = poses[:, :22], poses[:, 22:]
        elif count == 55:
            rotations[:] = poses
        else:  # SMPL: the last two are palms
            rotations[:, :22] = poses[:, :22]
    trans = _shaped(data, "trans", frames, 1)[:, 0] if "trans" in data else np.zeros((frames, 3))
    rates = [data[k] for k in ("mocap_framerate", "mocap_frame_rate") if k in data]
    fps = float(rates[0].reshape(-1)[0]) if rates and rates[0].size else 120.0
    Motion(fps, rotations, trans)  # refuse nonsense before it is turned
    z_to_y = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # -90 degrees about x
    rotations, trans = _turned(rotations, trans, z_to_y, skeleton)
    if forward:
        ahead = rotation_matrices(rotations[0, 0])[:, 2]
        turn = rotation_matrices([0, -np.arctan2(ahead[0], ahead[2]), 0])
        rotations, trans = _turned(rotations, trans, turn, skeleton)
    return Motion(fps, rotations, _grounded(rotations, trans - trans[0] * (1, 0, 1), skeleton))


def _shaped(data: Mapping[str, F64], key: str, frames: int, joints: int) -> F64:
    if data[key].size != frames * joints * 3 or len(data[key]) != frames:
        raise PoseError(f"{key} needs {frames} x {joints * 3} numbers, found shape {data[key].shape}")
    return data[key].reshape(frames, joints, 3)
