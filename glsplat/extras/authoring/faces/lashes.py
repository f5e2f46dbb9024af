"""Add details finer than a mesh's texture as splats: lashes, and the shadow of the upper lid."""

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
_SHADOW_SIGMAS_M, _SHADOW_GAP_M = (0.0011, 0.0007, 0.00008), 0.0002  # the gap from the eyeball
_OPACITY_FACTOR, _LENGTH_FACTOR = 0.45, 0.75  # of lashes: photographs show some already


class ExtraSplats(NamedTuple):
    """Splats bound to triangles of a mesh."""

    means: F64
    axes: F64  # [N, 3, 3] columns, the longest first
    scales: F64
    opacities: F64
    rgb: F64
    faces: Indices


def with_lashes(avatar: Avatar, mesh: RiggedMesh, eyes: Sequence[Opening], seed: int = 0) -> Avatar:
    """Return the avatar, made from ``mesh``, with lashes and shadows under the upper lids of ``eyes``.

    They follow the lids' expressions. Levels are dropped.
    """
    if not eyes:
        return avatar
    rng = np.random.default_rng((seed, 7))
    lashes = [_lashes(ball, edges, up, rng) for ball, edges in eyes for up in (True, False)]
    shadows = joined_splats([_shadow(ball, edges) for ball, edges in eyes])
    splats = joined_splats([*lashes, shadows])
    made = add_splats(avatar, mesh, splats._replace(opacities=splats.opacities * _OPACITY_FACTOR))
    return made if made.shapes is None else unbent(made, len(made.splats) - len(shadows.means))


def joined_splats(parts: Sequence[ExtraSplats]) -> ExtraSplats:
    """Return all splats of ``parts``, in their order."""
    return ExtraSplats(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def unbent(avatar: Avatar, first: int) -> Avatar:
    """Return the avatar with expressions that move its splats from ``first`` on without stretching them."""
    assert avatar.shapes is not None
    stiff = (avatar.shapes.rows >= first)[:, None, None]
    return replace(avatar, shapes=replace(avatar.shapes, bends=np.where(stiff, 0, avatar.shapes.bends)))


def _lashes(ball: Eyeball, edges: LidEdges, upper: bool, rng: np.random.Generator) -> ExtraSplats:
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
    longest = _LENGTH_FACTOR * (_UPPER_LENGTH_M if upper else _LOWER_LENGTH_M)
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


def add_splats(avatar: Avatar, mesh: RiggedMesh, splats: ExtraSplats) -> Avatar:
    """Return the avatar with splats bound to the middles of triangles of ``mesh``."""
    own = avatar.splats
    quats = matrix_quaternions(splats.axes)
    more = Splats.create(splats.means, quats, splats.scales, splats.opacities, rgb=splats.rgb, antialias=own.antialias)
    corners = mesh.faces[splats.faces]
    count, wide = len(splats.faces), len(mesh.skeleton)
    dense = np.zeros((count, wide))
    np.add.at(dense, (np.arange(count)[:, None, None], mesh.joints[corners]), mesh.weights[corners])
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
