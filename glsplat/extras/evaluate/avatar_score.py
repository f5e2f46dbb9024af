"""Score an avatar against the textured mesh it was made from, in named, fixed poses outside the fit's random poses.

Poses are axis-angle in radians on the SMPL-X joints; left joints are mirrored to the right unless a pose has the right
one.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F64
from glsplat.avatar import Avatar
from glsplat.camera import Camera, look_at, pinhole
from glsplat.errors import FormatError
from glsplat.extras.authoring.mesh_truth import MeshTruth
from glsplat.extras.evaluate.metrics import Box, decibel, psnr, ssim
from glsplat.meshes import RiggedMesh
from glsplat.renderer import Renderer
from glsplat.skinning.pose import Pose
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.skin import strongest_joint

Rotations = dict[str, tuple[float, float, float]]  # Axis-angle by joint, radians

_FINGERS = ("index", "middle", "ring", "pinky")

DISTANCE = 3.0  # metres from the middle of the figure
FILL = 0.94  # share of the picture that the figure takes, in its longer direction
FIRST, LIFT = 15.0, 8.0  # degrees: azimuth of the first view, elevation of all
FACE = ("head", "jaw", "left_eye", "right_eye")
HAND = ("wrist", "index", "middle", "pinky", "ring", "thumb")


def poses_of(table: str) -> dict[str, Rotations]:
    """Parse a table of poses: ``name: joint x y z, ...``; ``fists A`` bends each finger's joints by A radians."""
    poses: dict[str, Rotations] = {}
    for line in table.replace("\n  ", " ").strip().splitlines():
        name, _, joints = line.partition(":")
        poses[name] = {}
        for joint, *numbers in map(str.split, filter(None, joints.split(","))):
            values = [float(number) for number in numbers]
            poses[name] |= _fists(*values) if joint == "fists" else {joint: (values[0], values[1], values[2])}
    return poses


def _fists(amount: float) -> Rotations:
    out: Rotations = {}
    for side, sign in (("left", 1.0), ("right", -1.0)):
        out |= {f"{side}_{finger}{i}": (0.0, 0.0, -sign * amount) for finger in _FINGERS for i in (1, 2, 3)}
        out |= {f"{side}_thumb{i}": (0.0, -sign * 0.4 * amount, 0.0) for i in (2, 3)}
    return out


SCORE_POSES = poses_of("""
T-pose:
arms overhead: left_collar 0 0 0.25, left_shoulder 0 0 1.1, left_elbow 0 -0.3 0, left_hip 0 0 0.25,
  spine2 -0.15 0 0
hands on hips: left_shoulder 0 0.55 -0.85, left_elbow 0 -1.9 0, left_wrist 0 0 -0.5,
  left_hip 0 0 0.15
seated: left_hip -1.5 0 0.12, left_knee 1.5 0 0, left_shoulder 0 -0.5 -1, left_elbow 0 -0.8 0,
  neck 0.2 0 0
stride: left_hip -0.9 0 0, left_knee 0.5 0 0, right_hip 0.55 0 0, right_knee 0.9 0 0,
  left_shoulder 0 0.7 -1.15, right_shoulder 0 0.9 1.15, left_elbow 0 -1.5 0, right_elbow 0 1.5 0,
  spine1 0.1 0.15 0
reaching out: left_shoulder 0 -1.45 0.1, right_shoulder 0 0.5 0.9, left_elbow 0 -0.1 0,
  right_elbow 0 0.2 0, left_index1 0 0.12 0.1, left_pinky1 0 -0.2 0.1, left_hip -0.3 0 0.1,
  left_knee 0.5 0 0, right_hip 0.2 0 -0.1, head 0 0.4 0, jaw 0.25 0 0
twist with fists: pelvis 0 0.3 0, spine1 0 0.25 0, spine2 0 0.25 0, spine3 0 0.2 0, head 0 0.6 0,
  left_shoulder 0 -0.9 -0.6, left_elbow 0 -1.8 0, left_hip 0 0 0.3, fists 1.3
squat: left_hip -1.9 0 0.35, left_knee 2.1 0 0, left_ankle -0.3 0 0, spine1 0.3 0 0,
  spine2 0.2 0 0, left_shoulder 0 -1.3 -0.2, left_elbow 0 -0.5 0, left_eye_smplhf 0 0.3 0
""")
"""Joint rotations by pose; a left joint without its right twin stands for both."""


def score_pose(name: str, skeleton: Skeleton) -> Pose:
    """Return a pose of SCORE_POSES on any rig, without the joints that the rig lacks."""
    return pose_of(SCORE_POSES[name], skeleton)


def pose_of(given: Rotations, skeleton: Skeleton) -> Pose:
    """Return named rotations as a pose of any rig; a left joint without its right twin stands for both."""
    rotations = np.zeros((len(skeleton), 3))
    index = {joint: i for i, joint in enumerate(skeleton.names)}
    for joint, (x, y, z) in given.items():
        twin = joint.replace("left", "right", 1)
        if joint in index:
            rotations[index[joint]] = x, y, z
        if twin not in given and twin in index:
            rotations[index[twin]] = np.array([x, -y, -z])  # reflected in the plane x = 0
    return Pose(rotations)


@dataclass(frozen=True, slots=True, eq=False)
class AvatarScore:
    """Scores of one pose in one view, with both pictures."""

    pose: str
    azimuth: float  # degrees, 0 is the front, growing towards the left hand
    body: float  # dB over the box around the figure
    hands: float | None  # dB over the boxes around both hands; None for a rig without them
    ssim: float  # over the box around the figure
    milliseconds: float  # to render the avatar's picture and read it back
    avatar: NDArray[np.float32]  # [H, W, 3] in [0, 1]
    mesh: NDArray[np.float32]
    face: float | None = None  # dB over the box around the head; None for a rig without one
    finest: float | None = None  # dB over the whole picture against ``finest`` of ``score``; None without it


def score(
    renderer: Renderer,
    truth: MeshTruth,
    avatar: Avatar,
    mesh: RiggedMesh,
    names: list[str],
    views: int,
    grey: float = 0.0,
    finest: Renderer | None = None,
) -> Iterator[AvatarScore]:
    """Yield a score for every pose and view; all renderers have one square size and float32 output.

    ``finest`` draws the avatar exactly, if ``renderer`` draws less of it. Raises FormatError if the joints differ.
    """
    if avatar.skeleton.names != mesh.skeleton.names:
        raise FormatError(
            f"the avatar has {len(avatar.skeleton)} joints from {avatar.skeleton.names[0]}, the mesh "
            f"{len(mesh.skeleton)} from {mesh.skeleton.names[0]}; score against the mesh it was made from"
        )
    used = np.unique(mesh.faces)
    strongest = strongest_joint(mesh.joints, mesh.weights)
    looks = np.array([joint.startswith(FACE) for joint in mesh.skeleton.names])
    face = used[looks[strongest[used]]]
    hands = []
    for side in ("left", "right"):
        owns = np.array([joint.startswith(tuple(f"{side}_{part}" for part in HAND)) for joint in mesh.skeleton.names])
        hands.append(used[owns[strongest[used]]])
    for name in names:
        pose = score_pose(name, mesh.skeleton)
        vertices = mesh.posed(pose)
        for view in range(views):
            azimuth = FIRST + 360 * view / views
            camera = camera_around(vertices[used], azimuth, renderer.size[0], grey)
            image: NDArray[np.float32] = renderer.render([camera], pose)
            picture = np.clip(image[0, ..., :3], 0, 1)
            milliseconds = renderer.timings["total"]
            wanted = np.clip(truth.render([camera], pose)[0, ..., :3], 0, 1)
            boxes = [_box(vertices[hand], camera) for hand in hands if len(hand)]
            body, fingers, alike = compare(picture, wanted, _box(vertices[used], camera), boxes)
            head = psnr(picture, wanted, _box(vertices[face], camera)) if len(face) else None
            most = None
            if finest is not None:
                most = psnr(picture, np.clip(finest.render([camera], pose)[0, ..., :3], 0, 1))
            yield AvatarScore(name, azimuth % 360, body, fingers, alike, milliseconds, picture, wanted, head, most)


def camera_around(points: F64, azimuth: float, size: int, grey: float = 0.0) -> Camera:
    """Return a camera DISTANCE away that the figure ``points`` [N, 3] just fills; ``azimuth`` in degrees."""
    centre = (points.max(axis=0) + points.min(axis=0)) / 2
    turn, lift = np.radians((azimuth, LIFT))
    direction = np.array([np.cos(lift) * np.sin(turn), np.sin(lift), np.cos(lift) * np.cos(turn)])
    viewmat = look_at(centre + DISTANCE * direction, centre)
    seen = points @ viewmat[:3, :3].T + viewmat[:3, 3]
    half = np.abs(seen[:, :2] / np.maximum(seen[:, 2:], 0.1)).max()
    fov = 2 * np.degrees(np.arctan(min(float(half) / FILL, 2.0)))
    return Camera(viewmat, pinhole(size, size, float(fov)), size, size, background=(grey,) * 3)


def _box(points: F64, camera: Camera) -> Box:
    """Return the rows and columns that hold ``points`` [N, 3], with two pixels around them for blur."""
    seen = points @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
    pixel = (seen @ camera.K.T)[:, :2] / np.maximum(seen[:, 2:], 1e-6)
    low = np.clip(np.floor(pixel.min(axis=0)) - 2, 0, camera.width - 8).astype(int)
    high = np.clip(np.ceil(pixel.max(axis=0)) + 2, low + 8, camera.width).astype(int)
    return slice(low[1], high[1]), slice(low[0], high[0])


def compare(
    picture: NDArray[np.float32], wanted: NDArray[np.float32], body: Box, hands: list[Box]
) -> tuple[float, float | None, float]:
    """Return PSNR over ``body``, PSNR over all ``hands``, and SSIM over ``body`` of pictures [H, W, 3] in [0, 1].

    SSIM leaves out the pixels along the picture's border (``metrics.structure``).
    """
    square = (picture.astype(np.float64) - wanted) ** 2
    inside = [square[box].reshape(-1) for box in hands]
    fingers = decibel(float(np.concatenate(inside).mean())) if inside else None
    return psnr(picture, wanted, body), fingers, ssim(picture, wanted, body)
