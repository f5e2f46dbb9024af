"""What is finer than a mesh's texture, as splats: lashes, the upper lid's shadow, a catch light, strands of hair."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from glsplat.authoring.faces.eyeballs import Eyeball
from glsplat.authoring.faces.shapes import with_shapes
from glsplat.avatar import Avatar
from glsplat.meshes import RiggedMesh
from glsplat.rotations import matrix_quaternions
from glsplat.skinning.shapes import BEND, Shapes
from glsplat.skinning.skin import Skin
from glsplat.splats import Splats

__all__ = ["GLINT", "LASH", "STRAND", "VEIL", "lid_edges", "with_brow_hairs", "with_lashes", "with_strands"]

F64 = NDArray[np.float64]
Indices = NDArray[np.intp]

_SIDES = np.radians(np.linspace(-62, 62, 63))  # directions from the middle of the eye, to the sides ...
_HEIGHTS = np.radians(np.linspace(-50, 50, 101))  # ... and up
_HIGH = 25  # of those heights, from the middle: no opening begins beyond
_LID = 1.35  # radii of the ball, at most, from its middle to a lid's edge
_ABOUT = 0.035  # metres from the middle of an eye; lids are no farther
_LASHES, _LOWER = 34, 18  # of an upper and a lower lid
_LONG, _SHORT, _THICK = 0.0085, 0.0045, 0.00011  # metres
LASH, VEIL, GLINT = np.array([22, 15, 12]) / 255, np.array([46, 28, 22]) / 255, np.ones(3)
"""Colours of lashes, of the shadow under an upper lid, and of the light in an eye."""
_MIRRORED = np.radians((10.0, 13.0))  # to the person's left and up: where a window would be mirrored
STRAND = (0.0075, 0.00050, 0.00018)
"""Standard deviations of a strand of hair, metres."""
_BROW_HAIR, _BROWS = (0.0014, 0.00011, 0.00008), 0.35  # metres; alpha from which a texel has hair
_TRIES = 20
_RAYS = 512  # at a time


class LidEdges(NamedTuple):
    """Where lids end before an eyeball, K directions from nose to temple or the other way."""

    side: F64  # [K] radians to the person's left
    upper: F64  # [K] radians up
    lower: F64  # [K]
    upper_face: Indices  # [K] the mesh's triangle there
    lower_face: Indices  # [K]
    upper_at: F64  # [K, 3] metres
    lower_at: F64  # [K, 3]


class _Extra(NamedTuple):
    means: F64
    axes: F64  # [N, 3, 3] columns, the longest first
    scales: F64
    opacities: F64
    rgb: F64
    faces: Indices


def lid_edges(mesh: RiggedMesh, ball: Eyeball) -> LidEdges:
    """The opening between the lids, seen from the middle of the ball, at rest; what is shut at a side is left out."""
    faces = mesh.faces
    skin = ~np.isin(mesh.joints[faces[:, 0], 0], [mesh.skeleton.names.index(ball.joint)])
    corners = mesh.vertices[faces]
    near = (np.linalg.norm(corners - ball.centre, axis=2) < _ABOUT).all(axis=1) & skin
    mine = np.flatnonzero(near)
    side, up = np.meshgrid(_SIDES, _HEIGHTS, indexing="ij")
    hit, distance = _hits(corners[mine] - ball.centre, _directions(side.ravel(), up.ravel()), 0.9 * ball.radius)
    hit, distance = hit.reshape(side.shape), distance.reshape(side.shape)
    found = []
    for index in range(len(_SIDES)):
        row = hit[index]
        middle = len(_HEIGHTS) // 2
        open_ = np.flatnonzero(row < 0)
        if not len(open_) or np.abs(open_ - middle).min() > _HIGH:  # shut, or a gap above the lid
            continue
        start = int(open_[np.abs(open_ - middle).argmin()])
        low = high = start
        while low > 0 and row[low - 1] < 0:
            low -= 1
        while high < len(row) - 1 and row[high + 1] < 0:
            high += 1
        if low == 0 or high == len(row) - 1 or high - low < 3:
            continue
        if max(distance[index, high + 1], distance[index, low - 1]) > _LID * ball.radius:
            continue  # the nose, or a brow
        found.append((index, high + 1, low - 1))
    k = np.array(found, np.intp).reshape(-1, 3)
    ways = [_directions(_SIDES[k[:, 0]], _HEIGHTS[k[:, n]]) for n in (1, 2)]
    at = [ball.centre + way * distance[k[:, 0], k[:, n]][:, None] for n, way in zip((1, 2), ways, strict=True)]
    upper, lower = (mine[hit[k[:, 0], k[:, n]]] for n in (1, 2))
    return LidEdges(_SIDES[k[:, 0]], _HEIGHTS[k[:, 1]], _HEIGHTS[k[:, 2]], upper, lower, at[0], at[1])


def with_lashes(
    avatar: Avatar,
    mesh: RiggedMesh,
    balls: Sequence[Eyeball],
    seed: int = 0,
    *,
    strength: float = 1.0,  # of lashes and shadows
    length: float = 1.0,  # of lashes
    light: bool = True,  # in the eyes; photographs have their own
    openings: Sequence[LidEdges] | None = None,  # of the balls, where they are known
) -> Avatar:
    """The avatar, made of ``mesh``, with lashes on its lids, shadows under the upper ones and a light in its eyes.

    All follow the lids' expressions; the light stays where it is when the eye turns, as mirrors do, and goes out when
    the lids close. Levels are left out.
    """
    rng = np.random.default_rng((seed, 7))
    parts, veils, glints, lit = [], [], [], []
    for ball, edges in zip(balls, openings or [lid_edges(mesh, ball) for ball in balls], strict=True):
        if len(edges.side) < 8:
            continue
        parts += [_fringe(ball, edges, up, rng, length) for up in (True, False)]
        veils.append(_shadow(ball, edges))
        if light:
            glints.append(_glint(ball, edges))
            lit.append(ball.joint)
    if not parts:
        return avatar
    many = [*parts, *veils, *glints]
    extra = _Extra(*(np.concatenate([getattr(one, key) for one in many]) for key in _Extra._fields))
    extra = extra._replace(opacities=extra.opacities * strength)
    made = _added(avatar, mesh, extra)
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
    return _added(avatar, mesh, found.laid(found.along, size, tone, 0.8))


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
    return _added(avatar, mesh, found.laid(way, size, found.rgb * rng.uniform(0.7, 1.2, (count, 1)), 0.75))


class _Strewn(NamedTuple):
    """Points on a part of the mesh."""

    means: F64
    facing: F64  # unit normals, outwards
    along: F64  # of the hair, as the texture has it
    rgb: F64
    faces: Indices

    def laid(self, ways: F64, scales: F64, rgb: F64, opacity: float) -> _Extra:
        """A splat a point, along ``ways``, just above the surface."""
        axes, opacities = _frames(ways, self.facing), np.full(len(self.means), opacity)
        return _Extra(self.means + self.facing * 0.0008, axes, scales, opacities, np.clip(rgb, 0, 1), self.faces)


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


def _fringe(ball: Eyeball, edges: LidEdges, upper: bool, rng: np.random.Generator, long: float) -> _Extra:
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
    first = root - ball.centre
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    fan = np.stack([0.7 * spread + rng.normal(0, 0.08, count), np.full(count, 0.15 * up), np.zeros(count)], axis=1)
    first = first + fan
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = first + np.array([0, 0.75 * up, 0])
    second /= np.linalg.norm(second, axis=1, keepdims=True)
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
    return _Extra(means, _frames(ways, across), scales, opacity, np.tile(LASH, (2 * count, 1)), np.tile(face[row], 2))


def _shadow(ball: Eyeball, edges: LidEdges) -> _Extra:
    """Dark veils on the eyeball below the upper lid's edge, denser at the edge."""
    rows = np.arange(1, len(edges.side) - 1, 2)
    means, opacity, face, ways = [], [], [], []
    for below, strength in ((-1.0, 0.55), (3.0, 0.34), (7.0, 0.18)):
        way = _directions(edges.side[rows], np.maximum(edges.upper[rows] - np.radians(below), edges.lower[rows]))
        ways.append(way)
        means.append(ball.centre + (ball.radius + 0.0002) * way)
        opacity.append(np.full(len(rows), strength))
        face.append(edges.upper_face[rows])
    outward = np.concatenate(ways)
    axes = _frames(np.cross(np.array([0.0, 1, 0]), outward), outward)
    scales = np.tile([0.0011, 0.0007, 0.00008], (len(outward), 1))
    rgb = np.tile(VEIL, (len(outward), 1))
    return _Extra(np.concatenate(means), axes, scales, np.concatenate(opacity), rgb, np.concatenate(face))


def _glint(ball: Eyeball, edges: LidEdges) -> _Extra:
    """One bright spot before the iris, below the lid's edge."""
    left, up = _MIRRORED
    up = min(float(up), float(edges.upper[len(edges.side) // 2]) - np.radians(5))
    way = _directions(np.array([left]), np.array([up]))
    axes = _frames(np.cross(np.array([[0.0, 1, 0]]), way), way)
    face = edges.upper_face[len(edges.side) // 2][None]
    scales = np.array([[0.00055, 0.00055, 0.00008]])
    return _Extra(ball.centre + (ball.radius + 0.0004) * way, axes, scales, np.array([0.85]), GLINT[None], face)


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


def _added(avatar: Avatar, mesh: RiggedMesh, extra: _Extra) -> Avatar:
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


def _directions(side: F64, up: F64) -> F64:
    return np.stack([np.cos(up) * np.sin(side), np.sin(up), np.cos(up) * np.cos(side)], axis=1)


def _frames(first: F64, third: F64) -> F64:
    """[N, 3, 3] right-handed axes: along ``first``, the last nearest to ``third``."""
    one = first / np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-30)
    two = np.cross(third, one)
    two /= np.maximum(np.linalg.norm(two, axis=1, keepdims=True), 1e-30)
    return np.stack([one, two, np.cross(one, two)], axis=2)


def _hits(corners: F64, ways: F64, least: float) -> tuple[Indices, F64]:
    """[N] the first triangle [F, 3, 3] beyond ``least`` that rays from the origin meet, -1 for none, and how far.

    Moeller and Trumbore 1997.
    """
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    lifted = np.cross(-corners[:, 0], first)
    normal, aside = np.cross(second, first), np.cross(second, -corners[:, 0])
    best: Indices = np.full(len(ways), -1, np.intp)
    far: F64 = np.full(len(ways), np.inf)
    if not len(corners):
        return best, far
    for begin in range(0, len(ways), _RAYS):
        some = ways[begin : begin + _RAYS]
        with np.errstate(divide="ignore", invalid="ignore"):
            size = some @ normal.T
            u, v, t = some @ aside.T / size, some @ lifted.T / size, (second * lifted).sum(axis=1) / size
            met = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > least)
        t = np.where(met, t, np.inf)
        nearest = t.argmin(axis=1)
        far[begin : begin + _RAYS] = t[np.arange(len(some)), nearest]
        best[begin : begin + _RAYS] = np.where(met.any(axis=1), nearest, -1)
    return best, far


def _flow(corners: F64, uv: F64) -> tuple[F64, F64, F64]:
    """Of triangles [F, 3, 3] with coordinates [F, 3, 2]: the direction of v [F, 3], the normal, and the area."""
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(one, other)
    area = np.linalg.norm(normal, axis=1) / 2
    first, second = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    along = other * first[:, :1] - one * second[:, :1]
    return along, normal / np.maximum(2 * area, 1e-30)[:, None], area
