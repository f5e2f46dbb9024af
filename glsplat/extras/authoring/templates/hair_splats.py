"""Turn fitted hair into splats, coloured by the picture's hair, and what it covers into a shaded scalp."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from glsplat.avatar import Avatar
from glsplat.extras.authoring.fit.offsets import face_vertices
from glsplat.extras.authoring.geometry.surface_points import triangle_areas
from glsplat.extras.authoring.paint.head import ears_of
from glsplat.extras.authoring.paint.lamp import Lamp
from glsplat.extras.authoring.paint.pixels import masked_blur
from glsplat.extras.authoring.paint.ramps import smoothstep
from glsplat.extras.authoring.sample.cells import Cloud, avatar_of, skin_of, tessellate
from glsplat.extras.authoring.sample.merge import merge_avatars
from glsplat.extras.authoring.sample.scatter import PHOTO_SAMPLER
from glsplat.extras.authoring.templates.hair import MIN_ALPHA, FittedHair, carved, scattered
from glsplat.extras.authoring.templates.head_view import HeadView, value_at
from glsplat.meshes import vertex_normals
from glsplat.pictures import to_linear, to_srgb
from glsplat.rotations import component_sums, lengths, unit_vectors
from glsplat.skinning.smplx import JOINT_NAMES
from glsplat.splats import SH_C0

F64 = NDArray[np.float64]
Bools = NDArray[np.bool_]

HAIR_SPLATS = 8_000
"""Of an avatar whose hair is a template."""

# a smaller sigma shows cracks, a larger one blurs the locks, which cells follow by their light and dark
_SAMPLER = replace(PHOTO_SAMPLER, sigma=1.85, color_weight=4.0, candidates=12)
_POINTS_PER_SPLAT = 32
_MIN_FACE_FRACTION = 0.4
_FLOATING_M, _MAX_FLOATING_M = 0.02, 0.15  # before the face: drawn back along the picture's rays
_DEPTH_POINT_PX = 5  # of the picture with the template's own depth
_CONTRAST = 0.01, 0.05  # standard deviation of the locks' lightness
_LOCK_M = 0.01  # standard deviation of a blur that leaves light and shade, without locks
_SCALP_SHADE, _SEEN_SCALP_SHADE = 0.6, 0.9  # of hair's colour, in its own shadow
_SCALP_REACH_M, _CLOTH_REACH_M = 0.035, 0.03  # from the template: what it covers
_MAX_SCALP_SIGMA_M = 0.012  # wider splats would show around the hair
_NEAR_POINTS = 24  # the nearest of HAIR_SPLATS points of the hair, whose mean is taken
_MAX_OFF_CENTRE_RAD = 0.03  # from a splat to the mean of these, seen from the middle of the head
_MIN_VISIBILITY = 0.15
_BRIGHTEST_QUANTILE = 0.95  # of the picture's hair
_HARD_LIGHT_RATIO = 8.0  # of a head's lit half to the other in linear light
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


class HairSplats(NamedTuple):
    """The splats of a template, and the M points that they were made of."""

    avatar: Avatar
    points: F64  # [M, 3] in the zero pose, metres
    colour: F64  # [3] linear, the median of the picture's hair


def hair_splats(hair: FittedHair, light: Lamp, seed: int) -> HairSplats:
    """Return the splats of the hair, whose unseen sides are lit by ``light``."""
    head, seen, mesh = hair.head, hair.seen, hair.mesh
    shot, rng = head.shot, np.random.default_rng(seed)
    spots, face, rgba = scattered(mesh, HAIR_SPLATS * _POINTS_PER_SPLAT, rng)
    points = spots.at(mesh.vertices)
    stays = carved(hair, points)
    share = np.bincount(face, stays) / np.maximum(np.bincount(face), 1)
    stays &= share[face] > _MIN_FACE_FRACTION  # what is left of a carved lock would be dots
    keep = np.flatnonzero(stays & (rgba[:, 3] > MIN_ALPHA))
    area = float(triangle_areas(mesh.vertices, mesh.faces).sum()) * len(keep) / len(points)
    spots, face, rgba, points = spots.take(keep), face[keep], rgba[keep], _drawn_back(head, points[keep])
    # cards have two sides: the outer one counts
    corner = mesh.vertices[mesh.faces]
    normals = unit_vectors(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]))[face]
    outwards = points - head.middle
    outwards[:, 1] = outwards[:, 1].clip(0, None)
    normals *= np.where(component_sums(normals * outwards) < 0, -1.0, 1.0)[:, None]
    own = _lit(head, seen.mask)
    guess = _coloured(rgba[:, :3], own, _contrast(head, seen.mask), points)
    there = head.camera(points)
    trust = _trust(head, seen.mask, there, unit_vectors(outwards) @ head.rotation.T)
    shade = light.shade(normals @ head.rotation.T)
    sure = trust > 0.5
    usual = float(np.median(shade[sure] if sure.sum() > 50 else shade))
    guess *= (shade / usual).clip(0.6, 1.1)[:, None]
    guess *= (np.median(_lightness(own)) / np.median(_lightness(guess))) ** 3
    pictured = shot.sample(shot.project(there))
    brightest = np.quantile(own @ _LUMINANCE, _BRIGHTEST_QUANTILE)  # more is the room between locks
    pictured *= (brightest / (pictured @ _LUMINANCE).clip(brightest, None))[:, None]
    rgb = to_srgb(guess + trust[:, None] * (pictured - guess))
    even = np.ones(len(points))
    corners = spots.matrix(len(mesh.vertices))
    cloud = Cloud(points, normals, rgb, even, even, 0 * even, corners, skin_of(mesh), area, face)
    made = avatar_of([tessellate(cloud, HAIR_SPLATS, _SAMPLER, rng)], mesh, _SAMPLER.opacity)
    return HairSplats(made, points, np.median(own, axis=0))


def with_template_hair(avatar: Avatar, hair: FittedHair, made: HairSplats) -> Avatar:
    """Return the painted ``avatar`` with the splats ``made`` of its hair."""
    return merge_avatars(_with_scalp(avatar, hair, made.points, made.colour), made.avatar)


def covered_by_hair(hair: FittedHair) -> Bools:
    """Return a mask [V] of the body's vertices under the template that the picture does not show as a face."""
    head = hair.head
    points = scattered(hair.mesh, HAIR_SPLATS, np.random.default_rng(0))[0].at(hair.mesh.vertices)
    points = points[carved(hair, points)]
    under = np.zeros(len(head.bare), bool)
    under[head.skull] = cKDTree(points).query(head.bare[head.skull])[0] < _SCALP_REACH_M
    under &= ~np.any(ears_of(head.body), axis=0)  # few splats would blur them
    return under & ((head.shot.visibility < _MIN_VISIBILITY) | value_at(hair.seen.mask, head.shot.view.pixels))


def _drawn_back(head: HeadView, points: F64) -> F64:
    """Return points that float before the face nearer to it, along the rays that show them there."""
    there = head.camera(points)
    pixels = head.shot.project(there)
    behind = head.body_z(pixels)
    gap = np.where(np.isfinite(behind), behind, 0) - there[:, 2]
    some = (gap > _FLOATING_M) & (gap < _MAX_FLOATING_M) & (head.plane(pixels)[:, 1] < head.sizes.eyes + 0.03)
    return head.rest(there * np.where(some, 1 + 0.9 * (gap - _FLOATING_M) / there[:, 2], 1.0)[:, None])


def _lit(head: HeadView, mask: Bools) -> F64:
    """Return the linear colours [M, 3] within ``mask`` [H, W], or of the half that is lit by a hard light's side.

    There face and hair are so much brighter than in the other half of the head, which is in shade.
    """
    shot = head.shot
    colours = to_linear(shot.rgb[mask] / 255)
    hair = np.stack(np.nonzero(mask)[::-1], axis=1).astype(np.float64) + 0.5
    face = shot.view.pixels[face_vertices(head.body) & (shot.visibility > _MIN_VISIBILITY)]
    both = [(light @ _LUMINANCE, head.plane(at)[:, 0]) for light, at in ((colours, hair), (shot.sample(face), face))]
    for side in (-1, 1):
        halves = [(light[aside * side > 0], light[aside * side < 0]) for light, aside in both]
        if all(len(lit) and len(dark) and np.median(lit) > _HARD_LIGHT_RATIO * np.median(dark) for lit, dark in halves):
            return np.asarray(colours[both[0][1] * side > 0])
    return np.asarray(colours)


def _contrast(head: HeadView, mask: Bools) -> float:
    """Return the standard deviation of lightness within ``mask`` [H, W], less a blur of ``_LOCK_M``."""
    rows, columns = np.nonzero(mask)
    box = np.s_[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
    light = _lightness(to_linear(head.shot.rgb[box] / 255)).astype(np.float32)[..., None]
    sigma = max(_LOCK_M * head.scale, 1.0)
    locks = light - masked_blur(light, mask[box], sigma, sigma)[0]
    inner = cv2.erode(mask[box].astype(np.uint8), np.ones((3, 3), np.uint8)) > 0  # edges are mixed with the room
    return float(locks[inner].std()) if inner.any() else 0.0


def _coloured(rgb: F64, own: F64, contrast: float, points: F64) -> F64:
    """Return linear colours [M, 3]: the template's light and dark at a contrast, in the picture's ``own`` colour.

    ``contrast`` is set for groups of splats; what is finer, splats average.
    """
    mine, theirs = _lightness(to_linear(rgb)), _lightness(own)
    tree = cKDTree(points[:: max(1, len(points) // HAIR_SPLATS)])
    cell = tree.query(points)[1]
    cells = np.bincount(cell, mine, tree.n) / np.bincount(cell, minlength=tree.n).clip(1)
    broad = cells[tree.query(tree.data, k=_NEAR_POINTS)[1]].mean(axis=1)
    contrast = float(np.clip(contrast, *_CONTRAST))
    light = contrast / max(float(mine.std()), 1e-3) * (broad[cell] - np.median(mine))
    light += contrast / max(float((cells - broad).std()), 1e-3) * (mine - broad[cell])
    light = (np.median(theirs) + light).clip(0.3 * np.median(theirs), 1.0) ** 3
    colour = np.median(own, axis=0)
    return light[:, None] * (colour / max(colour @ _LUMINANCE, 1e-4))


def _lightness(linear: F64) -> F64:
    """Return [...] the lightness of linear colours [..., 3], 0 to 1, even to the eye."""
    return np.cbrt(linear @ _LUMINANCE)


def _trust(head: HeadView, mask: Bools, there: F64, outwards: F64) -> F64:
    """Return [M] how far the picture's hair shows the points [M, 3] in camera axes; ``outwards`` are unit vectors."""
    shot = head.shot
    pixels = shot.project(there)
    scale = head.depth.shape[0] / shot.mask.shape[0] / 2
    own = np.full(tuple(int(side * scale) + 1 for side in shot.mask.shape), 1e3, np.float32)
    at = np.floor(pixels * scale).astype(np.intp)
    np.minimum.at(own, (at[:, 1].clip(0, own.shape[0] - 1), at[:, 0].clip(0, own.shape[1] - 1)), there[:, 2])
    nearest = value_at(cv2.erode(own, np.ones((_DEPTH_POINT_PX,) * 2, np.uint8)), pixels, scale)
    shown = (there[:, 2] < nearest + 0.03) & (there[:, 2] < head.body_z(pixels) + 0.02)
    closed = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((7, 7), np.uint8))
    width = max(3, int(0.006 * head.scale) | 1)
    inner = cv2.GaussianBlur(cv2.erode(closed, np.ones((width, width), np.uint8)).astype(np.float32), (0, 0), width / 3)
    facing = -component_sums(outwards * there) / lengths(there)
    return smoothstep(facing, -0.05, 0.25) * shown * value_at(inner, pixels)


def _under(points: F64, means: F64, middle: F64) -> Bools:
    """Return a mask [N] of the ``means`` [N, 3] that hair ``points`` surround on all sides, seen from ``middle``.

    False at the edge of the hair, where wide splats would show beside it.
    """
    some = unit_vectors(points[:: max(1, len(points) // HAIR_SPLATS)] - middle)
    outwards = unit_vectors(means - middle)
    around = some[cKDTree(some).query(outwards, k=_NEAR_POINTS)[1]].mean(axis=1)
    return lengths(around - outwards) < _MAX_OFF_CENTRE_RAD


def _with_scalp(avatar: Avatar, hair: FittedHair, points: F64, colour: F64) -> Avatar:
    """Return the avatar whose hair painted on the head is a scalp below the template's ``points``.

    Cloth below hanging hair becomes as dark. Without both, cracks between locks would shine.
    """
    head, shot = hair.head, hair.head.shot
    body, rest = head.body, shot.mesh.vertices
    means = avatar.splats.means.astype(np.float64)
    near = cKDTree(rest).query(means, workers=-1)[1]
    tree = cKDTree(points[:: max(1, len(points) // HAIR_SPLATS)])
    on_head = body.skin & np.isin(body.part, [JOINT_NAMES.index(name) for name in ("head", "neck", "jaw")])
    mine = np.flatnonzero(on_head[near])
    vertex = near[mine]
    on_hair, visible = value_at(hair.seen.mask, shot.view.pixels), shot.visibility > _MIN_VISIBILITY
    pictured, shown = on_hair[vertex], visible[vertex]
    hairy = np.where(shown, pictured, ~face_vertices(body)[vertex])  # folds of lids are no scalp
    ears = np.any(ears_of(body), axis=0)
    if 2 * on_hair[ears & visible].sum() < (ears & visible).sum():
        hairy &= ~ears[vertex]  # both are skin, as painted
    hairy &= _under(points, means[mine], head.middle) | (means[mine, 1] > rest[ears, 1].max())
    if hair.seen.hat is not None:
        hairy &= head.plane_of(head.bare[vertex])[:, 1] < hair.seen.hat
    mine, vertex, own = mine[hairy], vertex[hairy], (shown & pictured)[hairy]
    scales, sh = avatar.splats.scales.copy(), avatar.splats.sh.copy()
    scales[mine] = np.minimum(scales[mine], _MAX_SCALP_SIGMA_M)
    painted = to_linear((sh[mine, 0] * SH_C0 + 0.5).clip(0, 1).astype(np.float64))
    scalp = np.where(own[:, None], _SEEN_SCALP_SHADE * painted, _SCALP_SHADE * colour)
    sh[mine, 0] = (to_srgb(scalp) - 0.5) / SH_C0
    backwards = vertex_normals(rest, shot.mesh.faces)[:, 2] < 0
    unseen = ~on_head[near] & (backwards & (shot.visibility < 0.1))[near] & (means[:, 1] > points[:, 1].min())
    below = np.flatnonzero(unseen)
    below = below[tree.query(means[below])[0] < _CLOTH_REACH_M]
    sh[below, 0] = (to_srgb(_SCALP_SHADE * colour) - 0.5) / SH_C0
    return replace(avatar, splats=replace(avatar.splats, scales=scales, sh=sh))
