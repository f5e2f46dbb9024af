"""Make eyeballs: spheres with a white, an iris with fibres and a dark rim, and a pupil."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError
from glsplat.extras.authoring.geometry.visibility import EYES
from glsplat.extras.authoring.paint.ramps import smoothstep
from glsplat.meshes import MeshPart, RiggedMesh
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.skin import strongest_joint

F64 = NDArray[np.float64]

IRIS_COLOURS = {  # sRGB, of 255
    "brown": ((112, 68, 38), (66, 38, 22)),
    "dark brown": ((70, 42, 26), (40, 24, 16)),
    "blue": ((128, 152, 166), (70, 106, 142)),
    "grey": ((146, 150, 148), (96, 106, 112)),
    "green": ((140, 124, 72), (84, 104, 70)),
}
"""Inner and outer colour of each iris."""

_IRIS_RADIUS_M = 0.0059
_PUPIL_FRACTION = 0.36  # of the iris's radius
_INSET_M = 0.0004  # of the eyeball, so that lids lie before it
_MAX_POLAR_RAD = np.radians(115)  # from the gaze; the back is never visible
_RINGS, _SECTORS = 24, 36
# sRGB at the iris's rim and far from it, where lids and lashes shade the white
_WHITE_RGB, _SHADED_WHITE_RGB = np.array([180, 171, 164]), np.array([122, 101, 94])
_TEXTURE_PX = 192
_MIN_VERTICES = 16  # of an eye


@dataclass(frozen=True, slots=True)
class Eyeball:
    """The sphere of an eyeball."""

    joint: str
    centre: F64  # [3] metres
    radius: float  # metres


def fit_eyeballs(mesh: RiggedMesh, *parts: str) -> list[Eyeball]:
    """Return spheres fitted to the vertices of each eye's joint in the ``parts``. Raises FormatError without both."""
    names, out = mesh.skeleton.names, []
    every = [one.faces.reshape(-1) for one in mesh.parts if one.name in parts]
    used = np.unique(np.concatenate([np.empty(0, np.int32), *every]))
    strongest = strongest_joint(mesh.joints, mesh.weights)
    for joint in EYES:
        mine = used[strongest[used] == names.index(joint)] if joint in names else used[:0]
        if len(mine) < _MIN_VERTICES:
            raise FormatError(f"{' and '.join(parts)} need vertices bound to {joint}")
        points = mesh.vertices[mine]
        system = np.concatenate([2 * points, np.ones((len(points), 1))], axis=1)
        solution = np.linalg.lstsq(system, (points**2).sum(axis=1), rcond=None)[0]
        out.append(Eyeball(joint, solution[:3], float(np.sqrt(solution[3] + solution[:3] @ solution[:3]))))
    return out


def with_eyeballs(mesh: RiggedMesh, part: str, iris: str, seed: int = 0, *, white: float = 1.0) -> RiggedMesh:
    """Return the mesh with spherical eyeballs for ``part``, the eyes' joints in their centres.

    ``iris`` names the colour; ``white`` is the brightness of the whites over those of a fair face.
    """
    if iris not in IRIS_COLOURS:
        raise FormatError(f"an iris is one of {', '.join(IRIS_COLOURS)}, not {iris!r}")
    balls = fit_eyeballs(mesh, part)
    names, influences = mesh.skeleton.names, mesh.joints.shape[1]
    joints = np.array(mesh.skeleton.joints, np.float64)
    rings, around = np.linspace(0, 1, _RINGS + 1), np.linspace(0, 1, _SECTORS + 1)
    polar, turn = np.meshgrid(rings * _MAX_POLAR_RAD, around * 2 * np.pi, indexing="ij")
    out = np.stack([np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)], axis=2)
    cell = np.arange(_RINGS)[:, None] * (_SECTORS + 1) + np.arange(_SECTORS)
    corner = np.stack([cell, cell + _SECTORS + 1, cell + _SECTORS + 2, cell + 1], axis=2).reshape(-1, 4)
    faces = np.concatenate([corner[:, [0, 1, 2]], corner[:, [0, 2, 3]]])
    uv = np.stack([turn / (2 * np.pi), 1 - polar / _MAX_POLAR_RAD], axis=2).reshape(-1, 2)
    uv = uv * (1 - 1 / _TEXTURE_PX) + 0.5 / _TEXTURE_PX
    vertices, bound, weights, parts = [mesh.vertices], [mesh.joints], [mesh.weights], []
    first = len(mesh.vertices)
    for number, ball in enumerate(balls):
        radius, index = ball.radius - _INSET_M, names.index(ball.joint)
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
    """Return [S, S, 4] the texture of an eyeball of ``radius`` metres: u turns about the gaze, v is 1 ahead."""
    rng = np.random.default_rng((seed, 52))
    polar = np.linspace(0, _MAX_POLAR_RAD, _TEXTURE_PX)[:, None]
    rim = np.arcsin(min(_IRIS_RADIUS_M / radius, 0.9))
    at = polar / rim * np.ones((1, _TEXTURE_PX))  # 1 at the iris's edge
    inner, outer = (np.array(colour, np.float64) for colour in IRIS_COLOURS[iris])
    fibres = _ripples(rng, _TEXTURE_PX) * np.clip((at - _PUPIL_FRACTION) * 4, 0, 1)
    mix = smoothstep(at, 0.42 + 0.10 * _ripples(rng, _TEXTURE_PX), 0.72)
    colour = inner * (1 - mix[..., None]) + outer * mix[..., None]
    colour = colour * (1 + 0.22 * fibres[..., None])
    colour = colour * (1 - 0.72 * smoothstep(at, 0.80, 0.97))[..., None]  # the limbal ring
    shaded = smoothstep(polar * np.ones_like(at), np.radians(38), np.radians(75))[..., None]
    white = _WHITE_RGB + (_SHADED_WHITE_RGB - _WHITE_RGB) * shaded
    white = bright * white * (1 - 0.30 * (1 - smoothstep(at, 1.0, 1.14)))[..., None]
    edge = smoothstep(at, 0.97, 1.06)[..., None]
    colour = colour * (1 - edge) + white * edge
    colour = colour * smoothstep(at, _PUPIL_FRACTION * 0.92, _PUPIL_FRACTION * 1.08)[..., None] + 6
    texture = np.full((_TEXTURE_PX, _TEXTURE_PX, 4), 255, np.uint8)
    texture[..., :3] = np.clip(np.rint(colour), 0, 255)
    return texture


def _ripples(rng: np.random.Generator, count: int) -> F64:
    """Return [count] smooth noise about a circle, of standard deviation one half."""
    turn = np.arange(count) / count * 2 * np.pi
    waves = rng.integers(9, 70, 24)
    return np.asarray(np.cos(waves[:, None] * turn + rng.uniform(0, 7, (24, 1))).sum(axis=0) / np.sqrt(48))
