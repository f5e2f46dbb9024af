"""Add upper lids in the skin's colours, which photographs of open eyes do not show.

They are tiled as they lie when the eye is closed. With the eye open they are small and lie folded behind the
photographed lid. As they come down they grow and come before the eye. The photograph's own splats there retreat behind
them, since a fit that is a millimetre off has painted lids with eyes and lashes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.spatial import cKDTree
from trimesh.triangles import points_to_barycentric

from glsplat.arrays import F64
from glsplat.avatar import Avatar
from glsplat.extras.authoring.compute.threads import map_threads
from glsplat.extras.authoring.faces.eyes import BLINK_SHAPES, Eyeball, LidEdges, Opening, blink_shape_of, directions
from glsplat.extras.authoring.faces.lashes import LASH_RGB, ExtraSplats, add_splats, axes_along
from glsplat.extras.authoring.geometry.attribute_transfer import sorted_axes
from glsplat.extras.authoring.geometry.surface_points import nearest_on
from glsplat.extras.authoring.paint.ramps import ramp, smoothstep
from glsplat.extras.authoring.sample.cells import SamplerConfig
from glsplat.extras.authoring.sample.merge import merge_avatars
from glsplat.extras.authoring.sample.surface import make_avatar
from glsplat.meshes import MeshPart, RiggedMesh
from glsplat.rotations import unit_vectors
from glsplat.skinning.shapes import BEND, Shapes, long_axes
from glsplat.splats import SH_C0, Splats

Indices = NDArray[np.integer]
_SAMPLER = SamplerConfig(samples=16, candidates=5, rounds=6, probe=0)  # nothing hides a lid
_LID_SPLATS = 240
_OPAQUE_RAD, _MAX_BEYOND_RAD = np.radians(7), np.radians(14)  # beyond the opening: a lid starts to fade, and ends
_FOLD_DEPTH_M, _LID_LIFT_M = 0.0045, 0.0012  # behind the lid's surface at rest; before it when closed
_FOLD_RAD, _FOLD_FALLOFF_RAD = 0.10, np.radians(8)  # away from the edges of the opening; over which it fades
_MIN_RADIUS_FACTOR = 0.82  # of the eyeball; an eyeball that pokes through lids hides them
_GAP_FACTOR = 1.7  # on the size of a lid's splats, so that they leave no gaps
_GROWTH = 2.5  # of a lid's splat in a blink, in sizes at rest
_COVERED_RETREAT_M, _COVERED_SHRINK = 0.003, 0.7  # of splats behind a closing lid; of their size
_COVERED_OPACITY = 0.85  # of the lid, where these begin
_LASH_TURN_FACTOR, _LASH_LIFT_M = 1.7, 0.0025  # lashes turn down by this over their height, and come before the lid
# how far splats stretch: those on lids have the eye's colours in part, and smear; those in a mouth become strings
_MAX_LID_BEND, _MAX_BEND = round(0.8 / BEND), round(1.5 / BEND)
_MIN_BLINK_M, _MIN_TONGUE_M = 0.002, 0.006  # movement of splats on a lid in a blink, and of a tongue put out
_MIN_MOVE_M = 1e-4  # smaller moves are dropped
_MIN_TRIANGLES = 8
_LID_RADIUS_M = 0.027  # around an eye's middle
_LINE_SIGMA_M, _LINE_SIGMA_STEPS, _LINE_SMOOTHING_STEPS = 0.0006, 0.9, 9  # of the lash line: across, along
_LINE_LIFT_M, _LINE_OPACITY, _LINE_DARKNESS = 0.0042, 0.9, 0.9  # before the lid; weight of the lashes' colour
_SEARCH_RADIUS_M, _MIN_GAP_RAD = 0.034, np.radians(8)  # around an eye's middle; beyond its opening
_FALLOFF_RAD = np.radians(20)  # of a sample's weight, beyond the opening
_DARK_QUANTILE = 0.6  # of the samples that are darker than skin: brows, lashes, shade
_MAX_SKIN_DISTANCE = 0.18  # sRGB, from the median of the brighter samples
_FIT_ROUNDS = 8
_OUTLIER_SIGMAS, _MIN_SIGMA = 2.5, 0.012  # of brightness
_BRIGHT_FACTOR = 3.0  # on the sigma of brighter samples, since shade, lashes and brows are dark
_LIGHT_RANGE = 0.95, 1.12  # of a lid over the mean: a quadratic may run away where it has no samples
_HUE_RANGE = 0.94, 1.06
_LID_HUE_POWER = 1.06  # lids are thin, so blood shows
_CREASE_DEPTH, _CREASE_ABOVE_M, _CREASE_SIGMA_M = 0.11, 0.0014, 0.0012  # darkening; above the opening; width
_LASH_EDGE_DEPTH, _LASH_EDGE_M = 0.10, 0.0012  # darkening at the lashes, and its reach
_CORNER_DEPTH, _CORNER_RAD, _CORNER_FADE_RAD = 0.04, np.radians(10), np.radians(12)  # darkening at both corners
_BLEND_RAD = np.radians((5, 13))  # beyond the opening: a lid takes the brightness of its surroundings ...
_BLEND_RANGE = 0.8, 1.05  # ... within these factors, because of brows
_NEIGHBOURS = 6


def with_lids(avatar: Avatar, face: RiggedMesh, eyes: Sequence[Opening], lashes: range, seed: int = 0) -> Avatar:
    """Return the avatar, made on ``face`` with its expressions, with a closing lid for each of the ``eyes``.

    Other splats keep their places at rest. On lids they stretch less, and retreat from the closing lid, except the
    ``lashes``, which come before it.
    """
    shapes = avatar.shapes
    assert shapes is not None and face.morphs is not None
    blinks = [shapes.names.index(name) for name in BLINK_SHAPES]
    blinking = np.isin(shapes.targets, blinks) & (np.linalg.norm(shapes.metres, axis=1) > _MIN_BLINK_M)
    on_lids = np.isin(shapes.rows, shapes.rows[blinking])[:, None, None]
    tongue_out = (shapes.targets == shapes.names.index("tongueOut")) & (shapes.metres[:, 2] > _MIN_TONGUE_M)
    most = np.where(on_lids | tongue_out[:, None, None], _MAX_LID_BEND, _MAX_BEND)
    made = replace(avatar, shapes=replace(shapes, bends=np.clip(shapes.bends, -most, most).astype(shapes.bends.dtype)))
    lids = map_threads(lambda eye: _lid(avatar, face, eye.ball, eye.edges, seed), eyes)
    for (ball, edges), lid in zip(eyes, lids, strict=True):
        if lid is not None:
            made = merge_avatars(replace(made, shapes=_shapes_behind_lid(made, ball, edges, lashes)), lid)
    return made


def _shapes_behind_lid(avatar: Avatar, ball: Eyeball, edges: LidEdges, lashes: range) -> Shapes:
    """Return the avatar's shapes, in which splats retreat and shrink behind the lid as it closes."""
    shapes, splats = avatar.shapes, avatar.splats
    assert shapes is not None
    blink = shapes.names.index(blink_shape_of(ball))
    mine = shapes.targets == blink
    move, bend = np.zeros((len(splats), 3)), np.zeros((len(splats), 2, 3))
    move[shapes.rows[mine]], bend[shapes.rows[mine]] = shapes.metres[mine], shapes.bends[mine] * BEND
    there = splats.means.astype(np.float64) - ball.centre + move
    near = splats.finite() & (np.linalg.norm(there, axis=1) < _LID_RADIUS_M) & (there[:, 2] > 0)
    share = np.zeros((len(splats), 1))
    share[near, 0] = ramp(_lid_opacity(there[near], edges), _COVERED_OPACITY, 1)
    share[lashes] = 0
    move -= _COVERED_RETREAT_M * share * unit_vectors(there)
    moving_lashes = np.flatnonzero(np.isin(np.arange(len(splats)), lashes) & (move[:, 1] < -_MIN_BLINK_M) & near)
    height = there[moving_lashes] - move[moving_lashes]  # at rest
    height = edges.above(height)[1] * np.linalg.norm(height, axis=1)
    drop = _LASH_TURN_FACTOR * height.clip(0)[:, None]
    move[moving_lashes] += _LASH_LIFT_M * unit_vectors(there[moving_lashes]) - drop * (0, 1, 0)
    bend[moving_lashes] = -_LASH_TURN_FACTOR * _long_axes(splats)[moving_lashes] * (0, 1, 0)
    bend -= share[:, :, None] * (bend + _COVERED_SHRINK * _long_axes(splats))
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
    """Return the lid before ``ball``, with ``edges`` at rest; None where no skin comes before the eye."""
    assert face.morphs is not None
    closes = face.morphs.dense(blink_shape_of(ball), len(face.vertices))
    shut = face.vertices + closes
    corners = shut[face.faces] - ball.centre
    outward = (np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) * corners[:, 0]).sum(axis=1) > 0
    skin = face.joints[face.faces[:, 0], 0] != face.skeleton.names.index(ball.joint)
    middle = corners.mean(axis=1)
    near = (np.linalg.norm(corners, axis=2) < _LID_RADIUS_M).all(axis=1) & (middle[:, 2] > 0)
    mine = face.faces[near & skin & outward & (edges.beyond(middle) < _MAX_BEYOND_RAD)]
    if len(mine) < _MIN_TRIANGLES:
        return None
    part = MeshPart("lid", mine, np.full((len(mine), 3, 2), 0.5), np.full((2, 2, 4), 255, np.uint8))
    closed = replace(face, vertices=shut, morphs=None)
    lid = make_avatar(replace(closed, parts=(part,)), _LID_SPLATS, seed, _SAMPLER)
    there, count = lid.splats.means.astype(np.float64), len(lid.splats)
    _, _, which, bary = nearest_on(shut, mine, there)
    edge = face.faces[edges.upper_face]
    along = np.nan_to_num(points_to_barycentric(face.vertices[edge], edges.upper_at), nan=1 / 3).clip(0, 1)
    line = _lash_line(ball, edges.upper_at + np.einsum("nk,nkc->nc", along, closes[edge]), edges)
    lid = add_splats(lid, closed, line)

    rgb = lid_colours(avatar.splats, lid.splats.means.astype(np.float64), Opening(ball, edges))
    rgb[count:] += _LINE_DARKNESS * (line.rgb - rgb[count:])
    solid = lid.splats.opacities.astype(np.float64)
    solid[:count] *= _lid_opacity(there - ball.centre, edges)
    scales = lid.splats.scales * np.where(np.arange(len(lid.splats)) < count, _GAP_FACTOR, 1)[:, None]
    quats, smooth = lid.splats.quats, avatar.splats.antialias
    splats = Splats.create(lid.splats.means, quats, scales, solid, rgb=rgb, antialias=smooth)
    ends = np.linspace(-1, 1, len(line.means)) ** 4  # lashes lie close at the corners
    before = np.concatenate([np.full(count, _LID_LIFT_M), _LINE_LIFT_M + ends * (_LID_LIFT_M - _LINE_LIFT_M)])[:, None]
    where = np.concatenate([bary, along])[:, :, None], np.concatenate([mine[which], edge])
    return _fold_away(replace(lid, splats=splats), face, Opening(ball, edges), where, before)


def _lash_line(ball: Eyeball, places: F64, edges: LidEdges) -> ExtraSplats:
    """Return lashes of the closed lid, close together: dark splats along its edge at ``places`` [K, 3].

    They stay above and before the lower lid's edge: at its corners a lid may close too far.
    """
    above = np.maximum(edges.above(places - ball.centre)[0], 0) + edges.lower
    far = np.maximum(*(np.linalg.norm(at - ball.centre, axis=1) for at in (places, edges.lower_at)))
    edge = directions(edges.side, above) * far[:, None]
    smooth = uniform_filter1d(edge, _LINE_SMOOTHING_STEPS, axis=0, mode="nearest")
    step = np.gradient(smooth, axis=0)
    middle = np.abs(np.linspace(-1, 1, len(places)))
    long = _LINE_SIGMA_STEPS * np.linalg.norm(step, axis=1)
    scales = np.stack([long, _LINE_SIGMA_M * (1 - 0.5 * middle), np.full(len(places), 0.3 * _LINE_SIGMA_M)], axis=1)
    colours = np.tile(LASH_RGB, (len(places), 1))
    solid = _LINE_OPACITY * (1 - 0.85 * middle**2)
    return ExtraSplats(ball.centre + smooth, axes_along(step, smooth), scales, solid, colours, edges.upper_face)


def _fold_away(lid: Avatar, face: RiggedMesh, eye: Opening, where: tuple[F64, Indices], before: F64) -> Avatar:
    """Return the closed ``lid`` folded away below the photographed one, with shapes that close it.

    ``where`` gives its splats' places on ``face``: barycentric coordinates [N, 3, 1] of corners [N, 3]; ``before`` [N,
    1] is their distance before it, metres.
    """
    assert face.morphs is not None
    (ball, edges), (bary, corners) = eye, where
    splats, there = lid.splats, lid.splats.means.astype(np.float64) - ball.centre
    names, count = face.morphs.names, len(face.vertices)
    blink = names.index(blink_shape_of(ball))
    moved = np.stack([(bary * face.morphs.dense(name, count)[corners]).sum(axis=1) for name in names])
    closes = moved[blink]
    rest = there - closes
    low, high, _ = edges.above(rest)
    fold = _FOLD_RAD * np.exp(-np.minimum(np.abs(low), np.abs(high)) / _FOLD_FALLOFF_RAD)
    aside = np.where(low + high > 0, fold, -fold)
    hidden = unit_vectors(unit_vectors(rest) + aside[:, None] * (0, 1, 0))
    depth = np.linalg.norm(rest, axis=1, keepdims=True) - _FOLD_DEPTH_M
    folded = np.maximum(depth, _MIN_RADIUS_FACTOR * ball.radius) * hidden
    comes = there + before * unit_vectors(there) - folded
    share = ((moved * comes).sum(axis=2) / np.maximum((comes**2).sum(axis=1), 1e-12)).clip(0, 1)[:, :, None]
    share[blink] = 1
    moved = moved + share * (comes - closes)
    targets, rows = np.nonzero(np.linalg.norm(moved, axis=2) > _MIN_MOVE_M)
    bends = _GROWTH * share[targets, rows][:, :, None] * _long_axes(splats)[rows]
    shapes = Shapes.create(names, len(there), splats=rows, targets=targets, moves=moved[targets, rows], bends=bends)
    scales, order = splats.scales.astype(np.float64), long_axes(splats.scales)[:, :2]
    small = np.take_along_axis(scales, order, axis=1) / (1 + _GROWTH)
    scales[:] = 0.3 * small.min(axis=1, keepdims=True)
    np.put_along_axis(scales, order, small, axis=1)
    at, rgb = ball.centre + folded, splats.sh[:, 0] * SH_C0 + 0.5
    made = Splats.create(at, splats.quats, scales, splats.opacities, rgb=rgb, antialias=splats.antialias)
    return replace(lid, splats=made, shapes=shapes)


def _lid_opacity(offsets: F64, edges: LidEdges) -> F64:
    """Return [N] a lid's opacity at ``offsets`` [N, 3] from the eye's middle: 1 at the opening, 0 well beyond."""
    return smoothstep(edges.beyond(offsets), _MAX_BEYOND_RAD, _OPAQUE_RAD)


def _long_axes(splats: Splats) -> F64:
    """Return [N, 2, 3] the two long axes."""
    return sorted_axes(splats)[:, :, :2].transpose(0, 2, 1)


class _SkinModel(NamedTuple):
    """The skin around an eye, without brows, lashes, glasses and the eye itself."""

    ball: Eyeball
    light: F64  # [6] of a quadratic in x and y
    hue: F64  # [3, 3] of a plane: red, green and blue over their mean
    usual_hue: F64  # [3]
    usual: float  # light at the middle

    def at(self, offsets: F64, hue_power: float = 1.0) -> F64:
        """Return [N, 3] sRGB at ``offsets`` [N, 3], metres from the eye's middle; ``hue_power`` deepens the hue."""
        terms = _terms(offsets, self.ball)
        hue = (self.usual_hue * (terms[:, :3] @ self.hue / self.usual_hue).clip(*_HUE_RANGE)) ** hue_power
        light = (terms @ self.light).clip(self.usual * _LIGHT_RANGE[0], self.usual * _LIGHT_RANGE[1])
        return np.asarray(light[:, None] * hue / hue.mean(axis=1, keepdims=True))


def lid_colours(splats: Splats, places: F64, eye: Opening) -> F64:
    """Return [N, 3] sRGB at ``places`` [N, 3] of the closed lid of ``eye``; grey where ``splats`` show no skin."""
    offsets = places - eye.ball.centre
    skin, shaded = _fit_skin(splats, eye), _lid_shading(offsets, *eye)[:, None]
    if skin is None:
        return np.full((len(places), 3), 0.5) * shaded
    rgb = skin.at(offsets, _LID_HUE_POWER) * shaded
    share = ramp(eye.edges.beyond(offsets), *_BLEND_RAD)[:, None]
    _, nearest = cKDTree(np.where(splats.finite()[:, None], splats.means, 0)).query(places, k=_NEIGHBOURS)
    around = (splats.sh[nearest, 0].astype(np.float64) * SH_C0 + 0.5).mean(axis=(1, 2))[:, None]
    light = (around / rgb.mean(axis=1, keepdims=True)).clip(*_BLEND_RANGE)
    return np.asarray((rgb * (1 + share * (light - 1))).clip(0, 1))


def _fit_skin(splats: Splats, eye: Opening) -> _SkinModel | None:
    """Return the skin model, or None without visible skin.

    By iteratively reweighted least squares (Tukey's biweight: Beaton and Tukey 1974).
    """
    ball, edges = eye
    rgb, offsets = splats.sh[:, 0].astype(np.float64) * SH_C0 + 0.5, splats.means.astype(np.float64) - ball.centre
    about = (np.linalg.norm(offsets, axis=1) < _SEARCH_RADIUS_M) & (offsets[:, 2] > 0) & splats.finite()
    beyond = np.zeros(len(offsets))
    beyond[about] = edges.beyond(offsets[about])
    about &= (beyond > _MIN_GAP_RAD) & (np.linalg.norm(offsets, axis=1) > ball.radius)
    if not about.any():
        return None
    samples, at, falloff = rgb[about], offsets[about], np.exp(-beyond[about] / _FALLOFF_RAD)
    light = samples.mean(axis=1)
    hue = np.median(samples[light >= np.quantile(light, _DARK_QUANTILE)], axis=0).clip(1e-3)
    difference = np.linalg.norm(samples - hue, axis=1)
    skin_like = difference <= max(_MAX_SKIN_DISTANCE, difference.min())
    samples, at, light, falloff = samples[skin_like], at[skin_like], light[skin_like], falloff[skin_like]
    weights, terms = np.ones(len(at)), _terms(at, ball)
    light_penalty = 1e-3 * len(at) * np.diag([1e-6, 0.1, 0.1, 1, 1, 1])  # keeps the fit flat with skin on one side only
    for _ in range(_FIT_ROUNDS):
        weighted = terms * (weights * falloff)[:, None]
        solved = np.linalg.solve(weighted.T @ terms + light_penalty, weighted.T @ light)
        residual = light - terms @ solved
        spread = max(float(np.median(np.abs(residual))), _MIN_SIGMA) * np.where(residual < 0, 1, _BRIGHT_FACTOR)
        weights = (1 - (residual / (_OUTLIER_SIGMAS * spread)) ** 2).clip(1e-3, 1) ** 2
    shares, plane = samples / light[:, None].clip(_MIN_SIGMA), terms[:, :3] * (weights * falloff)[:, None]
    hue_penalty = 1e-2 * len(at) * np.diag([1e-6, 1, 1])
    hues = np.linalg.solve(plane.T @ terms[:, :3] + hue_penalty, plane.T @ shares)
    return _SkinModel(ball, solved, hues, hue / hue.mean(), float(np.average(light, weights=weights)))


def _terms(offsets: F64, ball: Eyeball) -> F64:
    """Return [N, 6] the terms of a quadratic in x and y, in radii of the eye."""
    x, y = (offsets[:, :2] / ball.radius).T
    return np.stack([np.ones(len(x)), x, y, x * x, x * y, y * y], axis=1)


def _lid_shading(offsets: F64, ball: Eyeball, edges: LidEdges) -> F64:
    """Return [N] a lid's light over the skin's: darker in the crease, at the lashes and in the corners."""
    low, high, aside = edges.above(offsets)
    radius = np.linalg.norm(offsets, axis=1)
    inside = (-aside / _CORNER_FADE_RAD).clip(0, 1)
    crease = _CREASE_DEPTH * np.exp(-0.5 * ((high * radius - _CREASE_ABOVE_M) / _CREASE_SIGMA_M) ** 2)
    lashes = _LASH_EDGE_DEPTH * np.exp(-np.abs(low * radius) / _LASH_EDGE_M)
    return np.asarray(1 - inside * (crease + lashes) - _CORNER_DEPTH * np.exp(-((aside / _CORNER_RAD) ** 2)))
