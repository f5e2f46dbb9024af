"""Upper lids in the skin's colour, which photographs of open eyes do not show.

They are tiled as they lie when the eye is shut. With the eye open they are small and lie folded behind the lid that the
photograph shows; as they come down they grow and come before the eye and whatever else lies on the lid, since a fit
that is a millimetre off has painted lids with eyes and lashes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from glsplat.authoring.cells import SamplerConfig
from glsplat.authoring.faces.eyeballs import Eyeball
from glsplat.authoring.faces.trimmings import LidEdges, joined
from glsplat.authoring.importers import nearest_on
from glsplat.authoring.surface import FEWEST, make_avatar
from glsplat.avatar import Avatar
from glsplat.meshes import MeshPart, RiggedMesh
from glsplat.rotations import quaternion_matrices
from glsplat.skinning.pose import Pose
from glsplat.skinning.shapes import BEND, Shapes, long_axes
from glsplat.splats import SH_C0, Splats

__all__ = ["ShutLid", "shut_lids", "with_lids"]

F64 = NDArray[np.float64]

_SAMPLER = SamplerConfig(samples=16, candidates=5, rounds=6, probe=0)  # nothing hides a lid
_SPLATS = FEWEST  # of a lid
_MARGIN, _ABOVE = np.radians(5), 0.4  # about the opening, over which a lid's skin begins; above it that counts so much
_BEHIND, _BEFORE = 0.0045, 0.002  # metres from the lid's surface: at rest, deeper than what shows it, and shut
_OFF = 1.04  # radii of the eye that they keep from its middle
_LARGER = 1.35  # times as large as they lie, so that they leave no gaps
_GROWS = 2.5  # times its size at rest that a splat grows by
_BENT, _TAUT = round(0.8 / BEND), round(1.5 / BEND)  # how far splats stretch: those on lids have the eye's colours in
# part, and smear; those in a mouth become strings
_STIRRED = 0.002  # metres that a blink moves what lies on a lid
_LEAST = 1e-4  # metres; what moves a splat less is left out
_FEWEST = 8
_AROUND, _APART = 0.027, np.radians(9)  # metres from a lid's middle, and beyond the opening, where skin is looked for
_ALIKE = 0.15  # of 1, from the middle colour of that: what differs more is a brow, a lash or glasses
_SPREAD = 0.006  # metres, standard deviation, over which colours of skin are mixed


class ShutLid(NamedTuple):
    """An upper lid before it has colours."""

    splats: Avatar  # white ones, at rest
    there: F64  # [N, 3] where they lie when it is shut
    ball: Eyeball
    edges: LidEdges


def shut_lids(face: RiggedMesh, openings: Sequence[tuple[Eyeball, LidEdges]], seed: int = 0) -> list[ShutLid]:
    """The lids of a ``face`` that has expressions; none of an eye that is shut, or has no lids."""
    found = [_lid(face, ball, edges, seed) for ball, edges in openings if len(edges.side) >= _FEWEST]
    return [lid for lid in found if lid is not None]


def with_lids(avatar: Avatar, lids: Sequence[ShutLid]) -> Avatar:
    """The avatar, which was made on the lids' mesh and has its expressions, with ``lids`` that close.

    They are of the skin's colour. Other splats keep their places; on lids they stretch less.
    """
    shapes = avatar.shapes
    assert shapes is not None
    blinks = [index for index, name in enumerate(shapes.names) if name.startswith("eyeBlink")]
    blinking = np.isin(shapes.targets, blinks) & (np.linalg.norm(shapes.metres, axis=1) > _STIRRED)
    on_lids = np.isin(shapes.rows, shapes.rows[blinking])[:, None, None]
    most = np.where(on_lids, _BENT, _TAUT)
    bends = np.clip(shapes.bends, -most, most).astype(shapes.bends.dtype)
    out = replace(avatar, shapes=replace(shapes, bends=bends))
    for lid in lids:
        white = lid.splats.splats
        rgb = _skin_at(avatar.splats, lid.there, lid.ball, lid.edges)
        skin = Splats.create(
            white.means, white.quats, white.scales, white.opacities, rgb=rgb, antialias=avatar.splats.antialias
        )
        out = joined(out, replace(lid.splats, splats=skin))
    return out


def _lid(face: RiggedMesh, ball: Eyeball, edges: LidEdges, seed: int) -> ShutLid | None:
    """The lid before ``ball``, which has ``edges`` at rest; None where nothing comes before it."""
    assert face.morphs is not None
    blink = "eyeBlinkLeft" if ball.joint.startswith("left") else "eyeBlinkRight"
    offsets = {name: _moved(face, name) for name in face.morphs.names}
    shut = face.vertices + offsets[blink]
    corners = shut[face.faces] - ball.centre
    outward = (np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) * corners[:, 0]).sum(axis=1) > 0
    skin = face.joints[face.faces[:, 0], 0] != face.skeleton.names.index(ball.joint)
    middle = corners.mean(axis=1)
    near = (np.linalg.norm(corners, axis=2) < _AROUND).all(axis=1) & (middle[:, 2] > 0)
    mine = face.faces[near & skin & outward & (_beyond(middle, edges) < _MARGIN)]
    if len(mine) < _FEWEST:
        return None
    part = MeshPart("lid", mine, np.full((len(mine), 3, 2), 0.5), np.full((2, 2, 4), 255, np.uint8))
    lid = make_avatar(replace(face, vertices=shut, parts=(part,), morphs=None), _SPLATS, seed, _SAMPLER)

    splats, there = lid.splats, lid.splats.means.astype(np.float64)
    _, _, which, bary = nearest_on(shut, mine, there)
    rest = np.einsum("nk,nkc->nc", bary, face.vertices[mine[which]])
    away = np.linalg.norm(rest - ball.centre, axis=1, keepdims=True)
    folded = ball.centre + np.maximum(away - _BEHIND, _OFF * ball.radius) * _unit(rest - ball.centre)
    comes = there + _BEFORE * _unit(there - ball.centre) - folded
    order = long_axes(splats.scales)[:, :2]
    long_ones = np.take_along_axis(quaternion_matrices(splats.quats.astype(np.float64)), order[:, None], axis=2)
    long_ones = long_ones.transpose(0, 2, 1)  # [N, 2, 3]
    moves, bends = [], []
    for name in face.morphs.names:
        move = np.einsum("nk,nkc->nc", bary, offsets[name][mine[which]])
        share = ((move * comes).sum(axis=1) / np.maximum((comes**2).sum(axis=1), 1e-12)).clip(0, 1)[:, None]
        if name == blink:
            move, share = comes, np.ones_like(share)
        else:
            move = move + share * (comes - (there - rest))
        moves.append(move)
        bends.append(_GROWS * share[:, :, None] * long_ones)
    every = np.stack(moves)
    targets, rows = np.nonzero(np.linalg.norm(every, axis=2) > _LEAST)
    bent = np.stack(bends)[targets, rows]
    names = face.morphs.names
    whole = Shapes.create(names, len(there), splats=rows, targets=targets, moves=every[targets, rows], bends=bent)
    scales = splats.scales.astype(np.float64)
    small = np.take_along_axis(scales, order, axis=1) * _LARGER / (1 + _GROWS)
    scales[:] = 0.3 * small.min(axis=1, keepdims=True)
    np.put_along_axis(scales, order, small, axis=1)
    solid = splats.opacities * (1 - _beyond(there - ball.centre, edges) / _MARGIN).clip(0, 1)
    white = Splats.create(folded, splats.quats, scales, solid, rgb=np.ones((len(there), 3)))
    return ShutLid(replace(lid, splats=white, shapes=whole), there, ball, edges)


def _moved(face: RiggedMesh, name: str) -> F64:
    """[V, 3] how an expression moves the vertices."""
    assert face.morphs is not None
    pose = Pose(np.zeros((len(face.skeleton), 3)), expression={name: 1.0})
    return face.morphs.moved(pose, len(face.vertices))


def _beyond(ways: F64, edges: LidEdges) -> F64:
    """[N] radians that ways [N, 3] from the middle of an eye are beyond the opening of its lids; 0 within.

    Above it they count less: there a lid goes on.
    """
    side = np.arctan2(ways[:, 0], ways[:, 2])
    up = np.arcsin((ways[:, 1] / np.maximum(np.linalg.norm(ways, axis=1), 1e-12)).clip(-1, 1))
    order = np.argsort(edges.side)
    upper, lower = (np.interp(side, edges.side[order], edge[order]) for edge in (edges.upper, edges.lower))
    aside = np.maximum(edges.side.min() - side, side - edges.side.max())
    return np.asarray(np.maximum.reduce([_ABOVE * (up - upper), lower - up, aside, np.zeros(len(ways))]))


def _skin_at(splats: Splats, places: F64, ball: Eyeball, edges: LidEdges) -> F64:
    """[N, 3] sRGB of the skin about an eye, mixed by how near it is to ``places`` [N, 3]."""
    means, rgb = splats.means.astype(np.float64), splats.sh[:, 0].astype(np.float64) * SH_C0 + 0.5
    ways = means - ball.centre
    about = (np.linalg.norm(means - places.mean(axis=0), axis=1) < _AROUND) & (ways[:, 2] > 0)
    about &= (np.linalg.norm(ways, axis=1) > ball.radius) & splats.finite()
    about[about] = _beyond(ways[about], edges) > _APART
    if not about.any():
        return np.full((len(places), 3), 0.5)
    found, at = rgb[about], means[about]
    bright = found.sum(axis=1)
    usual = np.median(found[bright >= np.quantile(bright, 0.4)], axis=0)  # brows are darker
    off = np.linalg.norm(found - usual, axis=1)
    alike = off <= max(_ALIKE, off.min())
    found, at = found[alike], at[alike]
    away = ((places[:, None] - at) ** 2).sum(axis=2)
    away -= away.min(axis=1, keepdims=True)  # whoever is nearest counts, however far
    weight = np.exp(-0.5 * away / _SPREAD**2)
    return np.asarray(weight @ found / weight.sum(axis=1, keepdims=True))


def _unit(ways: F64) -> F64:
    return np.asarray(ways / np.maximum(np.linalg.norm(ways, axis=1, keepdims=True), 1e-12))
