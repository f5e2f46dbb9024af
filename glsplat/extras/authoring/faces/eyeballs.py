"""Eyeballs: round, turning about their middle, with a white, an iris with fibres and a dark rim, and a black pupil."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError
from glsplat.extras.authoring.geometry.visibility import EYES
from glsplat.meshes import MeshPart, RiggedMesh
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.skin import strongest_joint

__all__ = ["IRISES", "Eyeball", "eye_texture", "eyeballs", "with_eyeballs"]

F64 = NDArray[np.float64]

IRISES = {  # sRGB, of 255: about the pupil, and further out
    "brown": ((112, 68, 38), (66, 38, 22)),
    "dark brown": ((70, 42, 26), (40, 24, 16)),
    "blue": ((128, 152, 166), (70, 106, 142)),
    "grey": ((146, 150, 148), (96, 106, 112)),
    "green": ((140, 124, 72), (84, 104, 70)),
}
"""Colours of irises."""

_IRIS, _PUPIL = 0.0059, 0.36  # metres of radius; of the iris
_INSET = 0.0004  # metres by which a ball is smaller, so that lids lie before it
_WIDE = np.radians(115)  # from the gaze; further back nobody sees it
_RINGS, _AROUND = 24, 36
# sRGB before the iris's rim and far from it: lids and lashes keep a part of the light from what is not white itself
_WHITE, _EDGE = np.array([180, 171, 164]), np.array([122, 101, 94])
_SIDE = 192  # texels


@dataclass(frozen=True, slots=True)
class Eyeball:
    """Where an eyeball is."""

    joint: str
    centre: F64  # [3] metres
    radius: float


def eyeballs(mesh: RiggedMesh, *parts: str) -> list[Eyeball]:
    """The spheres nearest to what each eye's joint moves in the ``parts``. Raises FormatError without both."""
    names, out = mesh.skeleton.names, []
    every = [one.faces.reshape(-1) for one in mesh.parts if one.name in parts]
    used = np.unique(np.concatenate([np.empty(0, np.int32), *every]))
    strongest = strongest_joint(mesh.joints, mesh.weights)
    for joint in EYES:
        mine = used[strongest[used] == names.index(joint)] if joint in names else used[:0]
        if len(mine) < 16:
            raise FormatError(f"{' and '.join(parts)} need vertices bound to {joint}")
        points = mesh.vertices[mine]
        held = np.concatenate([2 * points, np.ones((len(points), 1))], axis=1)
        found = np.linalg.lstsq(held, (points**2).sum(axis=1), rcond=None)[0]
        out.append(Eyeball(joint, found[:3], float(np.sqrt(found[3] + found[:3] @ found[:3]))))
    return out


def with_eyeballs(mesh: RiggedMesh, part: str, iris: str, seed: int = 0, *, white: float = 1.0) -> RiggedMesh:
    """The mesh with round eyeballs of the colour ``iris`` for ``part``, the eyes' joints in their middles.

    ``white`` says how bright their whites are, of those of a fair face.
    """
    if iris not in IRISES:
        raise FormatError(f"an iris is one of {', '.join(IRISES)}, not {iris!r}")
    balls = eyeballs(mesh, part)
    names, influences = mesh.skeleton.names, mesh.joints.shape[1]
    joints = np.array(mesh.skeleton.joints, np.float64)
    rings, around = np.linspace(0, 1, _RINGS + 1), np.linspace(0, 1, _AROUND + 1)
    polar, turn = np.meshgrid(rings * _WIDE, around * 2 * np.pi, indexing="ij")
    out = np.stack([np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)], axis=2)
    cell = np.arange(_RINGS)[:, None] * (_AROUND + 1) + np.arange(_AROUND)
    corner = np.stack([cell, cell + _AROUND + 1, cell + _AROUND + 2, cell + 1], axis=2).reshape(-1, 4)
    faces = np.concatenate([corner[:, [0, 1, 2]], corner[:, [0, 2, 3]]])
    uv = np.stack([turn / (2 * np.pi), 1 - polar / _WIDE], axis=2).reshape(-1, 2) * (1 - 1 / _SIDE) + 0.5 / _SIDE
    vertices, bound, weights, parts = [mesh.vertices], [mesh.joints], [mesh.weights], []
    first = len(mesh.vertices)
    for number, ball in enumerate(balls):
        radius, index = ball.radius - _INSET, names.index(ball.joint)
        joints[index] = ball.centre
        vertices.append(ball.centre + radius * out.reshape(-1, 3))
        bound.append(np.full((len(vertices[-1]), influences), index))
        weights.append(np.eye(1, influences).repeat(len(vertices[-1]), axis=0))
        texture = eye_texture(iris, radius, seed + number, white)
        parts.append(MeshPart(ball.joint, (faces + first).astype(np.int32), uv[faces], texture))
        first += len(vertices[-1])
    kept = tuple(one for one in mesh.parts if one.name != part)
    return replace(
        mesh,
        vertices=np.concatenate(vertices),
        joints=np.concatenate(bound),
        weights=np.concatenate(weights),
        skeleton=Skeleton.from_joints(names, mesh.skeleton.parents, joints),
        parts=(*kept, *parts),
    )


def eye_texture(iris: str, radius: float, seed: int = 0, bright: float = 1.0) -> NDArray[np.uint8]:
    """[S, S, 4] a ball of ``radius`` metres by its angle around the gaze (u) and its angle from it (v, 1 ahead)."""
    rng = np.random.default_rng((seed, 52))
    polar = np.linspace(0, _WIDE, _SIDE)[:, None]
    rim = np.arcsin(min(_IRIS / radius, 0.9))
    at = polar / rim * np.ones((1, _SIDE))  # 1 at the iris's edge
    inner, outer = (np.array(colour, np.float64) for colour in IRISES[iris])
    fibres = _rippled(rng, _SIDE) * np.clip((at - _PUPIL) * 4, 0, 1)
    mix = _smooth(at, 0.42 + 0.10 * _rippled(rng, _SIDE), 0.72)
    colour = inner * (1 - mix[..., None]) + outer * mix[..., None]
    colour = colour * (1 + 0.22 * fibres[..., None])
    colour = colour * (1 - 0.72 * _smooth(at, 0.80, 0.97))[..., None]  # the limbal ring
    white = _WHITE + (_EDGE - _WHITE) * _smooth(polar * np.ones_like(at), np.radians(38), np.radians(75))[..., None]
    white = bright * white * (1 - 0.30 * (1 - _smooth(at, 1.0, 1.14)))[..., None]
    edge = _smooth(at, 0.97, 1.06)[..., None]
    colour = colour * (1 - edge) + white * edge
    colour = colour * _smooth(at, _PUPIL * 0.92, _PUPIL * 1.08)[..., None] + 6
    texture = np.full((_SIDE, _SIDE, 4), 255, np.uint8)
    texture[..., :3] = np.clip(np.rint(colour), 0, 255)
    return texture


def _rippled(rng: np.random.Generator, count: int) -> F64:
    """[count] smooth noise about a circle, of standard deviation one half."""
    turn = np.arange(count) / count * 2 * np.pi
    waves = rng.integers(9, 70, 24)
    return np.asarray(np.cos(waves[:, None] * turn + rng.uniform(0, 7, (24, 1))).sum(axis=0) / np.sqrt(48))


def _smooth(value: F64, low: float | F64, high: float) -> F64:
    part = np.clip((value - low) / (high - low), 0, 1)
    return np.asarray(part * part * (3 - 2 * part))
