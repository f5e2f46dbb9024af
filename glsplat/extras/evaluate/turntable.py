"""Render a participant who turns before a fixed camera: frames for making an avatar from a video."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F64
from glsplat.camera import Camera
from glsplat.extras.authoring.mesh_truth import MeshTruth
from glsplat.extras.evaluate.light import CaptureLight, shade_of
from glsplat.meshes import RiggedMesh
from glsplat.skinning.pose import Pose

_UNEVEN = 0.2  # largest deviation of a step of the turn, as a share of it
_SWAY = 0.02, 0.008  # standard deviation of a standing person's drift: radians per joint, metres
_SLOW = 4  # frames between independent drifts
_STILL = ("pelvis", "jaw", "eye", "index", "middle", "pinky", "ring", "thumb", "foot")
_NOISE = 1.5  # levels of 255
_QUALITY = 92  # of the frames' JPEG


@dataclass(frozen=True, slots=True, eq=False)
class Turntable:
    """One frame with its true mask, pose and turn."""

    rgb: NDArray[np.uint8]  # [H, W, 3] sRGB
    mask: NDArray[np.bool_]  # [H, W] the person
    pose: Pose
    turn: float  # degrees that the person has turned to their own left


def turntable(
    mesh: RiggedMesh,
    camera: Camera,
    pose: Pose,
    towards: Sequence[float],
    colour: Sequence[float],
    *,
    frames: int = 30,
    turns: float = 1.0,
    seed: int = 0,
) -> Iterator[Turntable]:
    """Yield ``frames`` of ``turns`` whole turns (negative: to the person's right) in ``pose``, with a little sway.

    The ``camera`` and the lamp stand still; the lamp is ``towards`` a direction and has a ``colour`` in linear light,
    as in a capture's note. The room is random. The same seed gives the same frames.
    """
    rng = np.random.default_rng(seed)
    room = _room(camera.height, camera.width, rng)
    steps = np.sign(turns) * (1 + _UNEVEN * rng.uniform(-1, 1, frames))
    degrees = 360 * abs(turns) / frames * np.concatenate([[0.0], np.cumsum(steps)[:-1]])
    sway = _drift(rng, frames, (len(mesh.skeleton), 3)) * _SWAY[0]
    sway[:, [any(word in name for word in _STILL) for name in mesh.skeleton.names]] = 0.0
    shift = _drift(rng, frames, (3,)) * (_SWAY[1], 0.0, _SWAY[1])
    names = mesh.skeleton.names
    pelvis = names.index("pelvis")
    light = CaptureLight.of_note({"direction_to": towards, "colour": colour})
    with MeshTruth(mesh, size=(camera.width, camera.height), supersample=1, output="float32") as renderer:
        for index, turn in enumerate(degrees):
            now = pose.rotations + sway[index]
            about = cv2.Rodrigues(np.array([0.0, np.radians(turn), 0.0]))[0]
            now[pelvis] = cv2.Rodrigues(about @ cv2.Rodrigues(pose.rotations[pelvis].copy())[0])[0].ravel()
            posed = Pose(now, pose.trans + shift[index])
            drawn = renderer.render([camera], posed, shade=shade_of(mesh, mesh.posed(posed), light))[0]
            alpha = drawn[..., 3:]
            before = 255 * drawn[..., :3] + room * (1 - alpha) + rng.normal(0, _NOISE, room.shape)
            packed = cv2.imencode(
                ".jpg", before.clip(0, 255).astype(np.uint8)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _QUALITY]
            )[1]
            rgb = np.ascontiguousarray(np.asarray(cv2.imdecode(packed, cv2.IMREAD_COLOR), np.uint8)[..., ::-1])
            yield Turntable(rgb, alpha[..., 0] >= 0.5, posed, float(turn))


def _drift(rng: np.random.Generator, frames: int, shape: tuple[int, ...]) -> F64:
    """Return slow random drifts [frames, *shape] of unit deviation."""
    knots = rng.normal(0, 1, (frames // _SLOW + 2, *shape))
    at = np.arange(frames) / _SLOW
    first, share = at.astype(int), (at % 1).reshape(-1, *(1,) * len(shape))
    smooth = share * share * (3 - 2 * share)
    return np.asarray(knots[first] * (1 - smooth) + knots[first + 1] * smooth)


def _room(height: int, width: int, rng: np.random.Generator) -> F64:
    """Return a room [H, W, 3] in levels of 255: wall, floor, skirting board, and two frames on the wall."""
    down, across = np.mgrid[0:height, 0:width] / [[[height]], [[width]]]
    wall = rng.uniform(150, 190, 3) + rng.uniform(-25, 25) * (across - 0.5)[..., None] + 10 * (0.5 - down)[..., None]
    floor = rng.uniform(90, 130, 3) + 30 * (down - 0.85)[..., None] * 4
    room = np.where((down > 0.8)[..., None], floor, wall)
    room[(down > 0.79) & (down < 0.8)] = rng.uniform(200, 225, 3)
    for left in (0.03, 0.82):
        hung = (across > left) & (across < left + 0.15) & (down > 0.08) & (down < 0.25)
        room[hung] = rng.uniform(60, 200, 3)
    return np.asarray(cv2.GaussianBlur(room, (0, 0), 2.0))
