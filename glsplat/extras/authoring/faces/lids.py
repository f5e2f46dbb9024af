"""Upper lids in the skin's colours, which photographs of open eyes do not show.

They are tiled as they lie when the eye is shut. With the eye open they are small and lie folded behind the lid that the
photograph shows; as they come down they grow and come before the eye, and what the photograph painted there draws back
behind them, since a fit that is a millimetre off has painted lids with eyes and lashes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from trimesh.triangles import points_to_barycentric

from glsplat.avatar import Avatar
from glsplat.extras.authoring.compute.threads import map_threads
from glsplat.extras.authoring.faces.blinks import BLINKS, blink_of
from glsplat.extras.authoring.faces.eyeballs import Eyeball
from glsplat.extras.authoring.faces.lashes_and_hair import LASH, Extra, added, frames, joined
from glsplat.extras.authoring.faces.lid_colours import lid_colours
from glsplat.extras.authoring.faces.openings import LidEdges, Opening, directions
from glsplat.extras.authoring.geometry.nearest import nearest_on
from glsplat.extras.authoring.sample.cells import SamplerConfig
from glsplat.extras.authoring.sample.surface import make_avatar
from glsplat.meshes import MeshPart, RiggedMesh
from glsplat.rotations import quaternion_matrices, unit_vectors
from glsplat.skinning.shapes import BEND, Shapes, long_axes
from glsplat.splats import SH_C0, Splats

__all__ = ["with_lids"]

F64 = NDArray[np.float64]
Indices = NDArray[np.integer]

_SAMPLER = SamplerConfig(samples=16, candidates=5, rounds=6, probe=0)  # nothing hides a lid
_SPLATS = 240  # of a lid
_SOLID, _MARGIN = np.radians(7), np.radians(14)  # beyond the opening, up to which a lid is solid, and where it ends
_BEHIND, _BEFORE, _GONE = 0.0045, 0.0012, 0.003  # metres from the lid's surface: at rest, shut, and what it covers
_AWAY = 0.10  # radians by which they are folded away from the opening at its edges ...
_RIM = np.radians(8)  # ... over which it becomes less
_OFF = 0.82  # radii of the eye that they keep from its middle: where a ball comes through lids it hides them
_LARGER = 1.7  # times as large as they lie, so that they leave no gaps
_GROWS = 2.5  # times its size at rest that a splat grows by
_SHRINKS = 0.7  # of its size, what it covers
_TURNED = 1.7  # of the way that lashes stand up, by which they turn down
_CARRIED = 0.0025  # metres that lashes come forward, to be before the lid
_COVERS = 0.85  # how solid it is where that begins
_BENT, _TAUT = round(0.8 / BEND), round(1.5 / BEND)  # how far splats stretch: those on lids have the eye's colours in
# part, and smear; those in a mouth become strings
_STIRRED = 0.002  # metres that a blink moves what lies on a lid
_PUT_OUT = 0.006  # metres ahead: a tongue's, which stretches as little
_LEAST = 1e-4  # metres; what moves a splat less is left out
_FEWEST = 8
_AROUND = 0.027  # metres from an eye's middle, as far as lids reach
_THIN, _ALONG, _EVEN = 0.0006, 0.9, 9  # of the lash line: metres, steps along it, steps that it is smoothed over
_FORE, _LASHED, _DARK = 0.0042, 0.9, 0.9  # metres from the lid, opacity, and how far it has the colour of lashes


def with_lids(avatar: Avatar, face: RiggedMesh, eyes: Sequence[Opening], lashes: range, seed: int = 0) -> Avatar:
    """The avatar, which was made on ``face`` and has its expressions, with a lid that closes for each of the ``eyes``.

    Other splats keep their places at rest; on lids they stretch less, and give way to the lid that closes, but for the
    ``lashes``, which come before it.
    """
    shapes = avatar.shapes
    assert shapes is not None and face.morphs is not None
    blinks = [shapes.names.index(name) for name in BLINKS]
    blinking = np.isin(shapes.targets, blinks) & (np.linalg.norm(shapes.metres, axis=1) > _STIRRED)
    on_lids = np.isin(shapes.rows, shapes.rows[blinking])[:, None, None]
    out = (shapes.targets == shapes.names.index("tongueOut")) & (shapes.metres[:, 2] > _PUT_OUT)
    most = np.where(on_lids | out[:, None, None], _BENT, _TAUT)
    made = replace(avatar, shapes=replace(shapes, bends=np.clip(shapes.bends, -most, most).astype(shapes.bends.dtype)))
    lids = map_threads(lambda eye: _lid(avatar, face, eye.ball, eye.edges, seed), eyes)
    for (ball, edges), lid in zip(eyes, lids, strict=True):
        if lid is not None:
            made = joined(replace(made, shapes=_gone(made, ball, edges, lashes)), lid)
    return made


def _gone(avatar: Avatar, ball: Eyeball, edges: LidEdges, lashes: range) -> Shapes:
    """The avatar's shapes, in which what lies where the lid will be draws back and shrinks as it closes."""
    shapes, splats = avatar.shapes, avatar.splats
    assert shapes is not None
    blink = shapes.names.index(blink_of(ball))
    mine = shapes.targets == blink
    move, bend = np.zeros((len(splats), 3)), np.zeros((len(splats), 2, 3))
    move[shapes.rows[mine]], bend[shapes.rows[mine]] = shapes.metres[mine], shapes.bends[mine] * BEND
    there = splats.means.astype(np.float64) - ball.centre + move
    near = splats.finite() & (np.linalg.norm(there, axis=1) < _AROUND) & (there[:, 2] > 0)
    share = np.zeros((len(splats), 1))
    share[near, 0] = ((_solid(there[near], edges) - _COVERS) / (1 - _COVERS)).clip(0, 1)
    share[lashes] = 0
    move -= _GONE * share * unit_vectors(there)
    carried = np.flatnonzero(np.isin(np.arange(len(splats)), lashes) & (move[:, 1] < -_STIRRED) & near)
    upwards = there[carried] - move[carried]  # at rest
    upwards = edges.above(upwards)[1] * np.linalg.norm(upwards, axis=1)
    move[carried] += _CARRIED * unit_vectors(there[carried]) - _TURNED * upwards.clip(0)[:, None] * (0, 1, 0)
    bend[carried] = -_TURNED * _long_ones(splats)[carried] * (0, 1, 0)
    bend -= share[:, :, None] * (bend + _SHRINKS * _long_ones(splats))
    moved = np.flatnonzero((share[:, 0] > 0) | np.isin(np.arange(len(splats)), shapes.rows[mine]))
    return Shapes.create(
        shapes.names,
        shapes.splats,
        splats=np.concatenate([shapes.rows[~mine], moved]),
        targets=np.concatenate([shapes.targets[~mine], np.full(len(moved), blink)]),
        moves=np.concatenate([shapes.metres[~mine], move[moved]]),
        bends=np.concatenate([shapes.bends[~mine] * BEND, bend[moved]]),
        limits=shapes.limits,
    )


def _lid(avatar: Avatar, face: RiggedMesh, ball: Eyeball, edges: LidEdges, seed: int) -> Avatar | None:
    """The lid before ``ball``, which has ``edges`` at rest; None where nothing comes before it."""
    assert face.morphs is not None
    closes = face.morphs.dense(blink_of(ball), len(face.vertices))
    shut = face.vertices + closes
    corners = shut[face.faces] - ball.centre
    outward = (np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) * corners[:, 0]).sum(axis=1) > 0
    skin = face.joints[face.faces[:, 0], 0] != face.skeleton.names.index(ball.joint)
    middle = corners.mean(axis=1)
    near = (np.linalg.norm(corners, axis=2) < _AROUND).all(axis=1) & (middle[:, 2] > 0)
    mine = face.faces[near & skin & outward & (edges.beyond(middle) < _MARGIN)]
    if len(mine) < _FEWEST:
        return None
    part = MeshPart("lid", mine, np.full((len(mine), 3, 2), 0.5), np.full((2, 2, 4), 255, np.uint8))
    closed = replace(face, vertices=shut, morphs=None)
    lid = make_avatar(replace(closed, parts=(part,)), _SPLATS, seed, _SAMPLER)
    there, count = lid.splats.means.astype(np.float64), len(lid.splats)
    _, _, which, bary = nearest_on(shut, mine, there)
    edge = face.faces[edges.upper_face]
    along = np.nan_to_num(points_to_barycentric(face.vertices[edge], edges.upper_at), nan=1 / 3).clip(0, 1)
    line = _line(ball, edges.upper_at + np.einsum("nk,nkc->nc", along, closes[edge]), edges)
    lid = added(lid, closed, line)

    rgb = lid_colours(avatar.splats, lid.splats.means.astype(np.float64), Opening(ball, edges))
    rgb[count:] += _DARK * (line.rgb - rgb[count:])
    solid = lid.splats.opacities.astype(np.float64)
    solid[:count] *= _solid(there - ball.centre, edges)
    scales = lid.splats.scales * np.where(np.arange(len(lid.splats)) < count, _LARGER, 1)[:, None]
    quats, smooth = lid.splats.quats, avatar.splats.antialias
    splats = Splats.create(lid.splats.means, quats, scales, solid, rgb=rgb, antialias=smooth)
    ends = np.linspace(-1, 1, len(line.means)) ** 4  # at the corners lashes lie close
    before = np.concatenate([np.full(count, _BEFORE), _FORE + ends * (_BEFORE - _FORE)])[:, None]
    where = np.concatenate([bary, along])[:, :, None], np.concatenate([mine[which], edge])
    return _folded(replace(lid, splats=splats), face, Opening(ball, edges), where, before)


def _line(ball: Eyeball, places: F64, edges: LidEdges) -> Extra:
    """Lashes of the lid that is shut, close together: dark splats along its edge, which is at ``places`` [K, 3].

    Nowhere below the lower lid's edge, nor behind it: at its corners a lid may close too far.
    """
    above = np.maximum(edges.above(places - ball.centre)[0], 0) + edges.lower
    far = np.maximum(*(np.linalg.norm(at - ball.centre, axis=1) for at in (places, edges.lower_at)))
    smooth = uniform_filter1d(directions(edges.side, above) * far[:, None], _EVEN, axis=0, mode="nearest")
    step = np.gradient(smooth, axis=0)
    middle = np.abs(np.linspace(-1, 1, len(places)))
    long = _ALONG * np.linalg.norm(step, axis=1)
    scales = np.stack([long, _THIN * (1 - 0.5 * middle), np.full(len(places), 0.3 * _THIN)], axis=1)
    colours = np.tile(LASH, (len(places), 1))
    solid = _LASHED * (1 - 0.85 * middle**2)
    return Extra(ball.centre + smooth, frames(step, smooth), scales, solid, colours, edges.upper_face)


def _folded(lid: Avatar, face: RiggedMesh, eye: Opening, where: tuple[F64, Indices], before: F64) -> Avatar:
    """The ``lid`` as it lies shut, folded away below the one that the photograph shows, with shapes that close it.

    ``where`` its splats are on ``face``: barycentric coordinates [N, 3, 1] of corners [N, 3]; ``before`` [N, 1] metres
    that they come before it.
    """
    assert face.morphs is not None
    (ball, edges), (bary, corners) = eye, where
    splats, there = lid.splats, lid.splats.means.astype(np.float64) - ball.centre
    names, count = face.morphs.names, len(face.vertices)
    blink = names.index(blink_of(ball))
    moved = np.stack([(bary * face.morphs.dense(name, count)[corners]).sum(axis=1) for name in names])
    closes = moved[blink]
    rest = there - closes
    low, high, _ = edges.above(rest)
    aside = np.where(low + high > 0, 1, -1) * _AWAY * np.exp(-np.minimum(np.abs(low), np.abs(high)) / _RIM)
    hidden = unit_vectors(unit_vectors(rest) + aside[:, None] * (0, 1, 0))
    folded = np.maximum(np.linalg.norm(rest, axis=1, keepdims=True) - _BEHIND, _OFF * ball.radius) * hidden
    comes = there + before * unit_vectors(there) - folded
    share = ((moved * comes).sum(axis=2) / np.maximum((comes**2).sum(axis=1), 1e-12)).clip(0, 1)[:, :, None]
    share[blink] = 1
    moved = moved + share * (comes - closes)
    targets, rows = np.nonzero(np.linalg.norm(moved, axis=2) > _LEAST)
    bends = _GROWS * share[targets, rows][:, :, None] * _long_ones(splats)[rows]
    shapes = Shapes.create(names, len(there), splats=rows, targets=targets, moves=moved[targets, rows], bends=bends)
    scales, order = splats.scales.astype(np.float64), long_axes(splats.scales)[:, :2]
    small = np.take_along_axis(scales, order, axis=1) / (1 + _GROWS)
    scales[:] = 0.3 * small.min(axis=1, keepdims=True)
    np.put_along_axis(scales, order, small, axis=1)
    at, rgb = ball.centre + folded, splats.sh[:, 0] * SH_C0 + 0.5
    made = Splats.create(at, splats.quats, scales, splats.opacities, rgb=rgb, antialias=splats.antialias)
    return replace(lid, splats=made, shapes=shapes)


def _solid(ways: F64, edges: LidEdges) -> F64:
    """[N] how solid a lid is in ways [N, 3] from the middle of the eye: 1 before the opening, 0 well beyond it."""
    part = ((_MARGIN - edges.beyond(ways)) / (_MARGIN - _SOLID)).clip(0, 1)
    return np.asarray(part * part * (3 - 2 * part))


def _long_ones(splats: Splats) -> F64:
    """[N, 2, 3] the two long axes."""
    axes = quaternion_matrices(np.where(splats.finite()[:, None], splats.quats, (1, 0, 0, 0)).astype(np.float64))
    return np.take_along_axis(axes, long_axes(splats.scales)[:, None, :2], axis=2).transpose(0, 2, 1)
