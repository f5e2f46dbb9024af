"""What is finer than a mesh's texture, as splats: lashes, the upper lid's shadow, a catch light, strands of hair."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.extras.authoring.faces.eyeballs import Eyeball
from glsplat.extras.authoring.faces.openings import LidEdges, Opening, directions
from glsplat.extras.authoring.geometry.mesh_shapes import with_shapes
from glsplat.meshes import RiggedMesh
from glsplat.rotations import matrix_quaternions, unit_vectors
from glsplat.skinning.shapes import BEND, Shapes
from glsplat.skinning.skin import Skin
from glsplat.splats import Splats

__all__ = [
    "FRINGES",
    "GLINT",
    "LASH",
    "STRAND",
    "VEIL",
    "Extra",
    "added",
    "frames",
    "joined",
    "with_brow_hairs",
    "with_lashes",
    "with_strands",
]

F64 = NDArray[np.float64]
Indices = NDArray[np.intp]

_LASHES, _LOWER = 34, 18  # of an upper and a lower lid
FRINGES = 2 * (_LASHES + _LOWER)
"""Splats of an eye's lashes, which ``with_lashes`` adds first."""
_LONG, _SHORT, _THICK = 0.0085, 0.0045, 0.00011  # metres
LASH, VEIL, GLINT = np.array([22, 15, 12]) / 255, np.array([46, 28, 22]) / 255, np.ones(3)
"""Colours of lashes, of the shadow under an upper lid, and of the light in an eye."""
_MIRRORED = np.radians((10.0, 13.0))  # to the person's left and up: where a window would be mirrored
STRAND = (0.0075, 0.00050, 0.00018)
"""Standard deviations of a strand of hair, metres."""
_BROW_HAIR, _BROWS = (0.0014, 0.00011, 0.00008), 0.35  # metres; alpha from which a texel has hair
_TRIES = 20


class Extra(NamedTuple):
    """Splats that ride triangles of a mesh."""

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
    """The avatar, made of ``mesh``, with lashes on its lids, shadows under the upper ones and a light in its eyes.

    All follow the lids' expressions; the light stays where it is when the eye turns, as mirrors do, and goes out when
    the lids close. Levels are left out.
    """
    rng = np.random.default_rng((seed, 7))
    parts, veils, glints, lit = [], [], [], []
    for ball, edges in eyes:
        parts += [_fringe(ball, edges, up, rng, length) for up in (True, False)]
        veils.append(_shadow(ball, edges))
        if light:
            glints.append(_glint(ball, edges))
            lit.append(ball.joint)
    if not parts:
        return avatar
    many = [*parts, *veils, *glints]
    extra = Extra(*(np.concatenate([getattr(one, key) for one in many]) for key in Extra._fields))
    extra = extra._replace(opacities=extra.opacities * strength)
    made = added(avatar, mesh, extra)
    if made.shapes is None:
        return made
    first = len(made.splats) - len(glints)
    veiled = first - sum(len(one.means) for one in veils)
    bends = np.where((made.shapes.rows >= veiled)[:, None, None], 0, made.shapes.bends)  # lids stretch sixfold
    shapes = replace(made.shapes, bends=bends)
    return replace(made, shapes=_going_out(shapes, first, lit) if glints else shapes)


def with_strands(avatar: Avatar, mesh: RiggedMesh, part: str, count: int, seed: int = 0) -> Avatar:
    """The avatar with ``count`` long, thin splats that lie along the flow of the hair ``part``, lighter and darker.

    Textures of hair run along it, so that the flow is the direction in which v changes. Levels are left out.
    """
    rng = np.random.default_rng((seed, 8))
    found = _strewn(mesh, part, count, rng, 0.8)
    if found is None:
        return avatar
    size = np.array(STRAND) * rng.uniform(0.6, 1.3, (len(found.rgb), 1))
    tone = found.rgb * rng.uniform(0.65, 1.45, (len(found.rgb), 1)) + rng.uniform(0, 0.03, (len(found.rgb), 1))
    return added(avatar, mesh, found.laid(found.along, size, tone, 0.8))


def with_brow_hairs(avatar: Avatar, mesh: RiggedMesh, part: str, count: int, seed: int = 0) -> Avatar:
    """The avatar with ``count`` hairs on its brows ``part``: upright at the nose, lying along the brow at the temple.

    Levels are left out.
    """
    rng = np.random.default_rng((seed, 9))
    found = _strewn(mesh, part, count, rng, _BROWS)
    if found is None:
        return avatar
    aside = np.abs(found.means[:, 0])
    share = ((aside - aside.min()) / max(float(np.ptp(aside)), 1e-9))[:, None] + rng.normal(0, 0.12, (count, 1))
    way = np.concatenate([np.sign(found.means[:, :1]) * (0.25 + 0.75 * share), 1.0 - 1.25 * share, 0 * share], axis=1)
    way -= np.einsum("nc,nc->n", way, found.facing)[:, None] * found.facing
    size = np.array(_BROW_HAIR) * rng.uniform(0.7, 1.2, (count, 1))
    return added(avatar, mesh, found.laid(way, size, found.rgb * rng.uniform(0.7, 1.2, (count, 1)), 0.75))


class _Strewn(NamedTuple):
    """Points on a part of the mesh."""

    means: F64
    facing: F64  # unit normals, outwards
    along: F64  # of the hair, as the texture has it
    rgb: F64
    faces: Indices

    def laid(self, ways: F64, scales: F64, rgb: F64, opacity: float) -> Extra:
        """A splat a point, along ``ways``, just above the surface."""
        axes, opacities = frames(ways, self.facing), np.full(len(self.means), opacity)
        return Extra(self.means + self.facing * 0.0008, axes, scales, opacities, np.clip(rgb, 0, 1), self.faces)


def _strewn(mesh: RiggedMesh, part: str, count: int, rng: np.random.Generator, solid: float) -> _Strewn | None:
    """``count`` points where the texture of a ``part`` is as ``solid`` as that, even over its area; None without it."""
    begin = 0
    for hair in mesh.parts:
        if hair.name == part:
            break
        begin += len(hair.faces)
    else:
        return None
    corners = mesh.vertices[hair.faces]
    along, normal, area = _flow(corners, hair.uv)
    places: list[Indices] = []
    weights: list[F64] = []
    colours: list[F64] = []
    for _ in range(_TRIES):
        which = rng.choice(len(area), 4 * count, p=area / area.sum())
        edge, other = np.sqrt(rng.random(4 * count)), rng.random(4 * count)
        bary = np.stack([1 - edge, edge * (1 - other), edge * other], axis=1)
        rgba = hair.sample(np.einsum("nk,nkc->nc", bary, hair.uv[which]))
        good = rgba[:, 3] > solid
        places.append(which[good])
        weights.append(bary[good])
        colours.append(rgba[good, :3])
        if sum(map(len, places)) >= count:
            break
    which, bary, rgb = (
        np.concatenate(places)[:count],
        np.concatenate(weights)[:count],
        np.concatenate(colours)[:count],
    )
    if len(which) < max(count, 1):
        return None
    means = np.einsum("nk,nkc->nc", bary, corners[which])
    outward = np.einsum("ni,ni->n", normal[which], means - corners.mean(axis=(0, 1)))
    facing = normal[which] * np.where(outward < 0, -1, 1)[:, None]
    return _Strewn(means, facing, along[which], rgb, (which + begin).astype(np.intp))


def _fringe(ball: Eyeball, edges: LidEdges, upper: bool, rng: np.random.Generator, long: float) -> Extra:
    """Two splats a lash: the first half stands off, the second curls up (or down)."""
    count = _LASHES if upper else _LOWER
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
    length = (
        long * (_LONG if upper else _SHORT) * rng.uniform(0.75, 1.1, count)[:, None] * (1 - 0.7 * spread[:, None] ** 2)
    )
    joint = root + 0.5 * length * first
    ways = np.concatenate([first, second])
    means = np.concatenate([root + 0.25 * length * first, joint + 0.25 * length * second])
    across = np.cross(ways, np.array([1.0, 0, 0]))
    scales = np.concatenate([np.tile(length, (2, 1)) * 0.17, np.full((2 * count, 2), _THICK)], axis=1)
    scales[count:, 1:] *= 0.7
    opacity = np.repeat([0.95, 0.8] if upper else [0.6, 0.4], count)
    return Extra(means, frames(ways, across), scales, opacity, np.tile(LASH, (2 * count, 1)), np.tile(face[row], 2))


def _shadow(ball: Eyeball, edges: LidEdges) -> Extra:
    """Dark veils on the eyeball below the upper lid's edge, denser at the edge."""
    rows = np.arange(1, len(edges.side) - 1, 2)
    means, opacity, face, ways = [], [], [], []
    for below, strength in ((-1.0, 0.55), (3.0, 0.34), (7.0, 0.18)):
        way = directions(edges.side[rows], np.maximum(edges.upper[rows] - np.radians(below), edges.lower[rows]))
        ways.append(way)
        means.append(ball.centre + (ball.radius + 0.0002) * way)
        opacity.append(np.full(len(rows), strength))
        face.append(edges.upper_face[rows])
    outward = np.concatenate(ways)
    axes = frames(np.cross(np.array([0.0, 1, 0]), outward), outward)
    scales = np.tile([0.0011, 0.0007, 0.00008], (len(outward), 1))
    rgb = np.tile(VEIL, (len(outward), 1))
    return Extra(np.concatenate(means), axes, scales, np.concatenate(opacity), rgb, np.concatenate(face))


def _glint(ball: Eyeball, edges: LidEdges) -> Extra:
    """One bright spot before the iris, below the lid's edge."""
    left, up = _MIRRORED
    up = min(float(up), float(edges.upper[len(edges.side) // 2]) - np.radians(5))
    way = directions(np.array([left]), np.array([up]))
    axes = frames(np.cross(np.array([[0.0, 1, 0]]), way), way)
    face = edges.upper_face[len(edges.side) // 2][None]
    scales = np.array([[0.00055, 0.00055, 0.00008]])
    return Extra(ball.centre + (ball.radius + 0.0004) * way, axes, scales, np.array([0.85]), GLINT[None], face)


def _going_out(shapes: Shapes, first: int, joints: Sequence[str]) -> Shapes:
    """The lights' own entries: none but the blink, which draws them into the eye."""
    kept = shapes.rows < first
    rows, targets, moves = [shapes.rows[kept]], [shapes.targets[kept].astype(np.int64)], [shapes.metres[kept]]
    bends = [shapes.bends[kept] * BEND]
    for number, joint in enumerate(joints[: shapes.splats - first]):
        name = "eyeBlinkLeft" if joint.startswith("left") else "eyeBlinkRight"
        if name in shapes.names:
            rows.append(np.array([first + number]))
            targets.append(np.array([shapes.names.index(name)]))
            moves.append(np.array([[0, 0, -0.008]], np.float32))
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


def added(avatar: Avatar, mesh: RiggedMesh, extra: Extra) -> Avatar:
    """The avatar and more splats, bound to the middles of triangles of ``mesh``."""
    own = avatar.splats
    quats = matrix_quaternions(extra.axes)
    more = Splats.create(extra.means, quats, extra.scales, extra.opacities, rgb=extra.rgb, antialias=own.antialias)
    corners = mesh.faces[extra.faces]
    count, wide = len(extra.faces), len(mesh.skeleton)
    dense = np.zeros((count, wide))
    for corner in range(3):
        for one in range(mesh.joints.shape[1]):
            np.add.at(
                dense, (np.arange(count), mesh.joints[corners[:, corner], one]), mesh.weights[corners[:, corner], one]
            )
    skin = Skin.create(np.broadcast_to(np.arange(wide), dense.shape), dense, wide, avatar.skin.joints.shape[1])
    riding = Avatar(more, avatar.skeleton, skin)
    if mesh.morphs is not None:
        riding = with_shapes(riding, mesh, extra.faces)
    return joined(avatar, riding)


def joined(avatar: Avatar, other: Avatar) -> Avatar:
    """Both in one, on the first's skeleton; without levels and cones."""
    both = [avatar.splats, other.splats]
    keys = ("means", "quats", "scales", "opacities", "sh")
    splats = Splats.create(*(np.concatenate([getattr(s, k) for s in both]) for k in keys), antialias=both[0].antialias)
    skins = [avatar.skin, other.skin]
    skin = Skin(
        np.concatenate([one.joints for one in skins]).astype(skins[0].joints.dtype),
        np.concatenate([one.weights for one in skins]),
    )
    shapes = avatar.shapes
    if shapes is not None and other.shapes is not None:
        assert shapes.names == other.shapes.names
        pair = (shapes, other.shapes)
        shapes = Shapes.create(
            shapes.names,
            len(splats),
            splats=np.concatenate([shapes.rows, other.shapes.rows + len(avatar.splats)]),
            targets=np.concatenate([one.targets for one in pair]),
            moves=np.concatenate([one.metres for one in pair]),
            bends=np.concatenate([one.bends for one in pair]) * BEND,
            limits=shapes.limits,
        )
    return replace(avatar, splats=splats, skin=skin, shapes=shapes, levels=())


def frames(first: F64, third: F64) -> F64:
    """[N, 3, 3] right-handed axes: along ``first``, the last nearest to ``third``."""
    one = unit_vectors(first, 1e-30)
    two = unit_vectors(np.cross(third, one), 1e-30)
    return np.stack([one, two, np.cross(one, two)], axis=2)


def _flow(corners: F64, uv: F64) -> tuple[F64, F64, F64]:
    """Of triangles [F, 3, 3] with coordinates [F, 3, 2]: the direction of v [F, 3], the normal, and the area."""
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(one, other)
    area = np.linalg.norm(normal, axis=1) / 2
    first, second = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    along = other * first[:, :1] - one * second[:, :1]
    return along, normal / np.maximum(2 * area, 1e-30)[:, None], area
