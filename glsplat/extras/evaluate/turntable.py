"""A participant before a camera: lit as in a photograph, and turning, as frames for making an avatar from a video.

The light is an ambient sky and ground, and a far lamp with wrapped Lambert falloff and a soft shadow; there are no
highlights. The factors are for ``MeshTruth.render(..., shade=...)``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F64
from glsplat.camera import Camera, look_at
from glsplat.errors import GlsplatError
from glsplat.extras.authoring.geometry.raster import mesh_picture_and_depth
from glsplat.extras.authoring.mesh_truth import MeshTruth
from glsplat.meshes import RiggedMesh, vertex_normals
from glsplat.skinning.pose import Pose

_WRAP = 0.15  # of Lambert's cosine: (n . l + wrap) / (1 + wrap)
_FAR, _MAP, _BIAS = 60.0, 768, 0.012  # of the lamp: distance in m, side of its depth map in pixels, depth bias in m
_TAPS = (-2, 0, 2)  # pixels in both directions, for a soft shadow

_UNEVEN = 0.2  # largest deviation of a step of the turn, as a share of it
_SWAY = 0.02, 0.008  # standard deviation of a standing person's drift: radians per joint, metres
_SLOW = 4  # frames between independent drifts
_STILL = ("pelvis", "jaw", "eye", "index", "middle", "pinky", "ring", "thumb", "foot")
_NOISE = 1.5  # levels of 255
_QUALITY = 92  # of the frames' JPEG


@dataclass(frozen=True)
class CaptureLight:
    """The light of a capture, linear; 1 makes a white surface look white."""

    towards: tuple[float, float, float]  # to the lamp, of any length, in the world of the posed mesh
    colour: tuple[float, float, float]  # of the lamp
    sky: tuple[float, float, float] = (0.52, 0.53, 0.56)
    ground: tuple[float, float, float] = (0.30, 0.28, 0.26)

    @classmethod
    def of_note(cls, note: Mapping[str, Any]) -> CaptureLight:
        """Return the "light" of a capture's note (direction_to, colour). Raises GlsplatError."""
        try:
            x, y, z = map(float, note["direction_to"])
            red, green, blue = map(float, note["colour"])
        except (KeyError, TypeError, ValueError):
            raise GlsplatError("a capture's light needs direction_to and colour, three numbers each") from None
        if not (np.isfinite([x, y, z, red, green, blue]).all() and any((x, y, z))):
            raise GlsplatError("a capture's light needs a direction that is not zero and finite numbers")
        return cls((x, y, z), (red, green, blue))


def shade_of(mesh: RiggedMesh, vertices: F64, light: CaptureLight) -> F64:
    """Return linear-light factors [V, 3] of a mesh with posed ``vertices`` [V, 3], metres, y up."""
    normals = vertex_normals(vertices, mesh.faces)
    lamp = np.asarray(light.towards, np.float64)
    lamp = lamp / np.linalg.norm(lamp)
    direct = np.maximum((normals @ lamp + _WRAP) / (1 + _WRAP), 0) * _reached(mesh, vertices, lamp)
    sky, ground = np.asarray(light.sky), np.asarray(light.ground)
    return ground + (sky - ground) * (0.5 + 0.5 * normals[:, 1:2]) + direct[:, None] * np.asarray(light.colour)


def _reached(mesh: RiggedMesh, vertices: F64, lamp: F64) -> F64:
    """Return the share of the lamp's light that reaches each vertex [V], by a shadow map."""
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    radius = np.linalg.norm(vertices - middle, axis=1).max() + 0.05
    focal = _MAP / 2 * _FAR / radius
    k = [[focal, 0, _MAP / 2], [0, focal, _MAP / 2], [0, 0, 1]]
    camera = Camera(look_at(middle + _FAR * lamp, middle), k, _MAP, _MAP)
    depth = mesh_picture_and_depth(mesh, vertices, camera, 1)[1]
    seen = vertices @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
    column, row = (focal * seen[:, axis] / seen[:, 2] + _MAP / 2 for axis in range(2))
    lit = np.zeros(len(vertices))
    for right in _TAPS:
        for down in _TAPS:
            x, y = (np.clip(place.astype(int), 0, _MAP - 1) for place in (column + right, row + down))
            lit += depth[y, x] + _BIAS > seen[:, 2]
    return lit / len(_TAPS) ** 2


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
