"""Score an avatar against the textured mesh it was made from, in poses outside the fit."""

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
from glsplat.extras.evaluate.avatar_poses import score_pose
from glsplat.extras.evaluate.metrics.pixels import Box, decibel, psnr
from glsplat.extras.evaluate.metrics.structure import ssim
from glsplat.meshes import RiggedMesh
from glsplat.renderer import Renderer
from glsplat.skinning.skin import strongest_joint

DISTANCE = 3.0  # metres from the middle of the figure
FILL = 0.94  # share of the picture that the figure takes, in its longer direction
FIRST, LIFT = 15.0, 8.0  # degrees: azimuth of the first view, elevation of all
FACE = ("head", "jaw", "left_eye", "right_eye")
HAND = ("wrist", "index", "middle", "pinky", "ring", "thumb")


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
    picture: NDArray[np.float32],
    wanted: NDArray[np.float32],
    body: Box,
    hands: list[Box],
) -> tuple[float, float | None, float]:
    """Return PSNR over ``body``, PSNR over all ``hands``, and SSIM over ``body`` of pictures [H, W, 3] in [0, 1].

    SSIM leaves out the pixels along the picture's border (``metrics.structure``).
    """
    square = (picture.astype(np.float64) - wanted) ** 2
    inside = [square[box].reshape(-1) for box in hands]
    fingers = decibel(float(np.concatenate(inside).mean())) if inside else None
    return psnr(picture, wanted, body), fingers, ssim(picture, wanted, body)
