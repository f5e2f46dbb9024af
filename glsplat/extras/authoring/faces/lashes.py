"""Add details finer than a mesh's texture as splats: lashes, the upper lid's shadow, a catch light."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F64
from glsplat.avatar import Avatar
from glsplat.extras.authoring.faces.eyes import Eyeball, LidEdges, Opening, directions
from glsplat.extras.authoring.geometry.mesh_shapes import with_shapes
from glsplat.extras.authoring.sample.merge import merge_avatars
from glsplat.meshes import RiggedMesh
from glsplat.rotations import matrix_quaternions, unit_vectors
from glsplat.skinning.shapes import BEND, Shapes
from glsplat.skinning.skin import Skin
from glsplat.splats import Splats

Indices = NDArray[np.intp]

_UPPER_LASHES, _LOWER_LASHES = 34, 18
LASH_SPLATS = 2 * (_UPPER_LASHES + _LOWER_LASHES)
"""Of one eye; ``with_lashes`` adds them first."""
_UPPER_LENGTH_M, _LOWER_LENGTH_M, _LASH_SIGMA_M = 0.0085, 0.0045, 0.00011
LASH_RGB, LID_SHADOW_RGB = np.array([22, 15, 12]) / 255, np.array([46, 28, 22]) / 255
# degrees below the upper lid's edge, and opacities, of the rows of its shadow
_SHADOW_ROWS = ((-1.0, 0.55), (3.0, 0.34), (7.0, 0.18))
_SHADOW_SIGMAS_M, _GLINT_SIGMAS_M = (0.0011, 0.0007, 0.00008), (0.00055, 0.00055, 0.00008)
_SHADOW_GAP_M, _GLINT_GAP_M = 0.0002, 0.0004  # from the eyeball
_GLINT_ANGLES_RAD = np.radians((10.0, 13.0))  # left and up: where an eye mirrors a window
_GLINT_LID_GAP_RAD = np.radians(5)  # below the lid's edge, at least
_GLINT_RETREAT_M = 0.008  # into the eye, in a blink


class ExtraSplats(NamedTuple):
    """Splats bound to triangles of a mesh."""

    means: F64
    axes: F64  # [N, 3, 3] columns, the longest first
    scales: F64
    opacities: F64
    rgb: F64
    faces: Indices


def with_lashes(
    avatar: Avatar,
    mesh: RiggedMesh,
    eyes: Sequence[Opening],
    seed: int = 0,
    *,
    strength: float = 1.0,  # of lashes and shadows
    length: float = 1.0,  # of lashes
    light: bool = True,  # in the eyes; photographs have their own
) -> Avatar:
    """Return the avatar, made from ``mesh``, with lashes, shadows under the upper lids and a light in its eyes.

    They follow the lids' expressions. The light keeps its place when the eye turns, as mirrors do, and disappears in a
    blink. Levels are dropped.
    """
    rng = np.random.default_rng((seed, 7))
    parts, shadows, glints, lit_joints = [], [], [], []
    for ball, edges in eyes:
        parts += [_lashes(ball, edges, up, rng, length) for up in (True, False)]
        shadows.append(_shadow(ball, edges))
        if light:
            glints.append(_glint(ball, edges))
            lit_joints.append(ball.joint)
    if not parts:
        return avatar
    pieces = [*parts, *shadows, *glints]
    splats = ExtraSplats(*(np.concatenate([getattr(one, key) for one in pieces]) for key in ExtraSplats._fields))
    splats = splats._replace(opacities=splats.opacities * strength)
    made = add_splats(avatar, mesh, splats)
    if made.shapes is None:
        return made
    first = len(made.splats) - len(glints)
    first_shadow = first - sum(len(one.means) for one in shadows)
    bends = np.where((made.shapes.rows >= first_shadow)[:, None, None], 0, made.shapes.bends)  # lids stretch sixfold
    shapes = replace(made.shapes, bends=bends)
    return replace(made, shapes=_hide_in_blinks(shapes, first, lit_joints) if glints else shapes)


def _lashes(ball: Eyeball, edges: LidEdges, upper: bool, rng: np.random.Generator, length_factor: float) -> ExtraSplats:
    """Return two splats for each lash: the first half stands off, the second curls up (or down)."""
    count = _UPPER_LASHES if upper else _LOWER_LASHES
    at, face = (edges.upper_at, edges.upper_face) if upper else (edges.lower_at, edges.lower_face)
    inner, outer = 2, len(edges.side) - 3
    where = np.sort(rng.uniform(inner, outer, count))
    row = where.astype(np.intp)
    part = (where - row)[:, None]
    root = at[row] * (1 - part) + at[row + 1] * part
    spread = (row - (inner + outer) / 2) / (outer - inner)
    up = 1.0 if upper else -1.0
    fan = np.stack([0.7 * spread + rng.normal(0, 0.08, count), np.full(count, 0.15 * up), np.zeros(count)], axis=1)
    first = unit_vectors(unit_vectors(root - ball.centre) + fan)
    second = unit_vectors(first + np.array([0, 0.75 * up, 0]))
    longest = length_factor * (_UPPER_LENGTH_M if upper else _LOWER_LENGTH_M)
    length = longest * rng.uniform(0.75, 1.1, count)[:, None] * (1 - 0.7 * spread[:, None] ** 2)
    joint = root + 0.5 * length * first
    along = np.concatenate([first, second])
    means = np.concatenate([root + 0.25 * length * first, joint + 0.25 * length * second])
    across = np.cross(along, np.array([1.0, 0, 0]))
    scales = np.concatenate([np.tile(length, (2, 1)) * 0.17, np.full((2 * count, 2), _LASH_SIGMA_M)], axis=1)
    scales[count:, 1:] *= 0.7
    opacity = np.repeat([0.95, 0.8] if upper else [0.6, 0.4], count)
    rgb, faces = np.tile(LASH_RGB, (2 * count, 1)), np.tile(face[row], 2)
    return ExtraSplats(means, axes_along(along, across), scales, opacity, rgb, faces)


def _shadow(ball: Eyeball, edges: LidEdges) -> ExtraSplats:
    """Return shadows on the eyeball below the upper lid's edge, densest at the edge."""
    rows = np.arange(1, len(edges.side) - 1, 2)
    means, opacity, face, along = [], [], [], []
    for below, strength in _SHADOW_ROWS:
        way = directions(edges.side[rows], np.maximum(edges.upper[rows] - np.radians(below), edges.lower[rows]))
        along.append(way)
        means.append(ball.centre + (ball.radius + _SHADOW_GAP_M) * way)
        opacity.append(np.full(len(rows), strength))
        face.append(edges.upper_face[rows])
    outward = np.concatenate(along)
    axes = axes_along(np.cross(np.array([0.0, 1, 0]), outward), outward)
    scales = np.tile(_SHADOW_SIGMAS_M, (len(outward), 1))
    rgb = np.tile(LID_SHADOW_RGB, (len(outward), 1))
    return ExtraSplats(np.concatenate(means), axes, scales, np.concatenate(opacity), rgb, np.concatenate(face))


def _glint(ball: Eyeball, edges: LidEdges) -> ExtraSplats:
    """Return one bright spot before the iris, below the lid's edge."""
    left, up = _GLINT_ANGLES_RAD
    up = min(float(up), float(edges.upper[len(edges.side) // 2]) - _GLINT_LID_GAP_RAD)
    way = directions(np.array([left]), np.array([up]))
    axes = axes_along(np.cross(np.array([[0.0, 1, 0]]), way), way)
    face = edges.upper_face[len(edges.side) // 2][None]
    scales = np.array([_GLINT_SIGMAS_M])
    mean = ball.centre + (ball.radius + _GLINT_GAP_M) * way
    return ExtraSplats(mean, axes, scales, np.array([0.85]), np.ones((1, 3)), face)


def _hide_in_blinks(shapes: Shapes, first: int, joints: Sequence[str]) -> Shapes:
    """Return the shapes without entries for the lights, except that blinks draw them into the eye."""
    kept = shapes.rows < first
    rows, targets, moves = [shapes.rows[kept]], [shapes.targets[kept].astype(np.int64)], [shapes.metres[kept]]
    bends = [shapes.bends[kept] * BEND]
    for number, joint in enumerate(joints[: shapes.splats - first]):
        name = "eyeBlinkLeft" if joint.startswith("left") else "eyeBlinkRight"
        if name in shapes.names:
            rows.append(np.array([first + number]))
            targets.append(np.array([shapes.names.index(name)]))
            moves.append(np.array([[0, 0, -_GLINT_RETREAT_M]], np.float32))
            bends.append(np.zeros((1, 2, 3)))
    return Shapes.create(
        shapes.names,
        shapes.splats,
        splats=np.concatenate(rows),
        targets=np.concatenate(targets),
        moves=np.concatenate(moves),
        bends=np.concatenate(bends),
        limits=shapes.limits,
    )


def add_splats(avatar: Avatar, mesh: RiggedMesh, splats: ExtraSplats) -> Avatar:
    """Return the avatar with splats bound to the middles of triangles of ``mesh``."""
    own = avatar.splats
    quats = matrix_quaternions(splats.axes)
    more = Splats.create(splats.means, quats, splats.scales, splats.opacities, rgb=splats.rgb, antialias=own.antialias)
    corners = mesh.faces[splats.faces]
    count, wide = len(splats.faces), len(mesh.skeleton)
    dense = np.zeros((count, wide))
    for corner in range(3):
        for one in range(mesh.joints.shape[1]):
            np.add.at(
                dense, (np.arange(count), mesh.joints[corners[:, corner], one]), mesh.weights[corners[:, corner], one]
            )
    skin = Skin.create(np.broadcast_to(np.arange(wide), dense.shape), dense, wide, avatar.skin.joints.shape[1])
    extra_avatar = Avatar(more, avatar.skeleton, skin)
    if mesh.morphs is not None:
        extra_avatar = with_shapes(extra_avatar, mesh, splats.faces)
    return merge_avatars(avatar, extra_avatar)


def axes_along(first: F64, third: F64) -> F64:
    """Return [N, 3, 3] right-handed axes: the first along ``first``, the last nearest to ``third``."""
    one = unit_vectors(first, 1e-30)
    two = unit_vectors(np.cross(third, one), 1e-30)
    return np.stack([one, two, np.cross(one, two)], axis=2)
