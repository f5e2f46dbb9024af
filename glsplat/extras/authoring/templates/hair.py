"""Choose a template for hair that the front picture shows, and deform it to the outline of that hair."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.spatial import cKDTree

from glsplat.extras.authoring.compute.threads import map_threads
from glsplat.extras.authoring.fit.offsets import face_vertices
from glsplat.extras.authoring.geometry.surface_points import SurfacePoints, triangle_areas
from glsplat.extras.authoring.paint.head import ears_of, vertices_of
from glsplat.extras.authoring.paint.ramps import smoothstep
from glsplat.extras.authoring.paint.view_sample import FittedPicture
from glsplat.extras.authoring.templates.hair_mask import SeenHair
from glsplat.extras.authoring.templates.head_view import HeadView, value_at
from glsplat.extras.authoring.templates.library import template
from glsplat.meshes import RiggedMesh, vertex_normals
from glsplat.rotations import lengths
from glsplat.skinning.smplx import JOINT_NAMES

F64 = NDArray[np.float64]
Bools = NDArray[np.bool_]

MIN_AGREEMENT = 0.45
"""Of a template; below it the hair was mistaken, or no template is like it."""

MIN_ALPHA = 0.45
"""Of a template's texture, where it has hair."""

_BY_LENGTH = {
    "long": ("long01", "braid01", "bob02"),
    "bob": ("bob01", "bob02", "short03"),
    "short": ("short01", "short02", "short03", "short04", "afro01"),
}
_ONE_SIDED = ("short03", "bob01", "bob02")  # with a fringe or parting at one side: mirrored ones are tried, too
_LONG_M, _LONG_WIDE_M = 0.045, 0.02  # below the chin; the second if it is as wide as the head there
_AFRO_RATIO = 1.35  # of the hair's radius about the eyes to the skull's
_BRAID_PREFERENCE = -0.15  # most long hair hangs loose, which the front does not show
_TRIAL_POINTS, _GRAIN_M = 6000, 0.008  # that try a template, and the cells that they cover
_ROW_M = 0.005
_MIN_EXTENT_M = 0.03  # aside, for a width to be compared
_STRETCH = 0.75, 1.5  # of widths and heights
_DEEPER = 0.95, 1.2  # of depths
_BEHIND_SHOULDERS_M, _FREE_M = 0.12, 0.03  # that hair goes on where shoulders hide it, and where it ends above them
_REACHES_SHOULDERS_M = 0.02  # below the chin, on the picture's vertical
_MAX_LOCK_M = 0.03  # from that end
_FRONT_PLAY_M = 0.006  # hair so far behind the bare body still counts as visible
_OUTLINE_PLAY_M = 0.012  # a head's sides are some pixels wide
_HAIR_PLAY_M, _GAP_M = 0.006, 0.02
_UNDER_BRIM_M = 0.03  # that hair behind goes on under a hat's brim, so that there is no gap
_MIN_BRIM_M = 0.03  # of a hat's widest place, beyond its lower edge
_BRIM_PLAY_M = 0.005  # nearer to a brim's edge, splats of hair would show on it
_NEAR_VERTICES = 16  # of a hat, in a point's direction
_SKULL_GAP_M, _CLOTH_GAP_M = 0.004, 0.010  # of hair over skin, and over a dressed back
_NECK_REACH_M = 0.025  # from seen hair: there a neck has its outline
_FACE_BULGE_M = 0.02  # a face wears nothing: more is hair beside it
_SMOOTHING_ROUNDS = 4
_CHAIN = ("spine1", "spine2", "spine3", "head")  # that hair follows, by height


@dataclass(frozen=True, eq=False)
class FittedHair:
    """A template fitted to the hair of the front picture."""

    name: str
    agreement: float  # above the chin, overlap of the template and the seen hair over their union
    long: bool
    end: float  # height in the head's plane down to which it hangs on a back
    head: HeadView
    seen: SeenHair
    mesh: RiggedMesh  # in the zero pose, bound to head, neck and back


def fit_hair(head: HeadView, seen: SeenHair, names: tuple[str, ...]) -> FittedHair | None:
    """Return the template among ``names`` that agrees best with the hair's length and outline.

    None without any, and for short hair below a hat.
    """
    length = _length(head, seen)
    if length == "short" and seen.hat is not None:
        return None  # little of it is seen, and a bald crown looks like a hat
    own = [name for name in _BY_LENGTH[length] if name in names]
    if "afro01" in own and _volume(head, seen) < _AFRO_RATIO:
        own.remove("afro01")
    trials = [(name, mirrored) for name in own for mirrored in ((False, True) if name in _ONE_SIDED else (False,))]
    fitted = map_threads(lambda trial: _fitted(head, seen, *trial, length == "long"), trials)
    return max(fitted, key=lambda hair: hair.agreement + (hair.name == "braid01") * _BRAID_PREFERENCE, default=None)


def _length(head: HeadView, seen: SeenHair) -> str:
    """Return short, bob or long, by the lowest hair against ears and chin."""
    sizes, aside, up = head.sizes, np.abs(seen.plane[:, 0]), seen.plane[:, 1]
    low = np.quantile(up, 0.02)
    below, end = sizes.chin - low, aside[up < low + 0.015].max()
    if below > _LONG_M or (below > _LONG_WIDE_M and end > 0.95 * sizes.half_width):
        return "long"
    beside = (aside > 0.8 * sizes.half_width) & (up < sizes.eyes - 0.03)
    ears = head.plane_of(head.bare[np.any(ears_of(head.body), axis=0)])[:, 1].min()
    return "bob" if low < ears and beside.mean() > 0.06 else "short"


def _volume(head: HeadView, seen: SeenHair) -> float:
    """Return the radius of the hair above the eyes over the bare skull's; 1 below a hat, and without hair there."""
    if seen.hat is not None:
        return 1.0
    both = [flat[flat[:, 1] > head.sizes.eyes + 0.03] for flat in (seen.plane, head.plane_of(head.bare[head.skull]))]
    if not len(both[0]):
        return 1.0  # a wreath of hair
    hair, skull = (np.quantile(np.hypot(*(flat - (0, head.sizes.eyes)).T), 0.98) for flat in both)
    return float(hair / skull)


def _fitted(head: HeadView, seen: SeenHair, name: str, mirrored: bool, long: bool) -> FittedHair:
    """Return the template ``name`` with the outline of the seen hair, and how well it agrees."""
    body, own = head.body, template(name)
    start = own.vertices * (-1.0, 1.0, 1.0) if mirrored else own.vertices
    where = _outside(head, _carried(start, body.vertices[head.skull], head.bare[head.skull]))
    where = _outside(head, _with_outline(head, seen, where, long))
    joints, weights = _binding(head, where)
    (part,) = own.parts
    end = _hair_end(head, seen, long)
    reached = head.plane_of(where)[:, 1] > end - _MAX_LOCK_M
    rows = np.flatnonzero(reached[part.faces].any(axis=1))
    part = replace(part, faces=part.faces[rows], uv=part.uv[rows])
    mesh = RiggedMesh(where, head.shot.mesh.skeleton, joints, weights, (part,))
    return FittedHair(name, round(_agreement(head, seen, mesh), 3), long, end, head, seen, mesh)


def _agreement(head: HeadView, seen: SeenHair, mesh: RiggedMesh) -> float:
    """Return the overlap of the template and the seen hair over their union, above the chin and below a hat.

    What a picture shows as skin counts against a template: hairline and fringe distinguish templates.
    """
    spots, _, rgba = scattered(mesh, _TRIAL_POINTS, np.random.default_rng(0))
    there = head.camera(spots.at(mesh.vertices)[rgba[:, 3] > MIN_ALPHA])
    pixels = head.shot.project(there)
    front = there[:, 2] < head.body_z(pixels) + _FRONT_PLAY_M
    grain = max(1, round(head.scale * _GRAIN_M))
    size = tuple(side // grain + 1 for side in seen.mask.shape)
    mine, theirs = np.zeros(size, np.uint8), np.zeros(size, np.uint8)
    columns, rows = (pixels[front] / grain).astype(np.intp).T
    mine[rows.clip(0, size[0] - 1), columns.clip(0, size[1] - 1)] = 1
    mine = cv2.morphologyEx(mine, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    rows, columns = np.nonzero(seen.mask)
    theirs[rows // grain, columns // grain] = 1
    either = (mine | theirs) > 0
    at = (np.stack(np.nonzero(either)[::-1], axis=1).astype(np.float64) + 0.5) * grain
    up = head.plane(at)[:, 1]
    counted = (up > head.sizes.chin) & (up < (np.inf if seen.hat is None else seen.hat))
    return float((mine & theirs)[either][counted].mean()) if counted.any() else 0.0


def scattered(mesh: RiggedMesh, count: int, rng: np.random.Generator) -> tuple[SurfacePoints, NDArray[np.intp], F64]:
    """Return ``count`` points, evenly by area, with their faces [count] and texture colours [count, 4]."""
    (part,) = mesh.parts
    total = np.cumsum(triangle_areas(mesh.vertices, part.faces))
    face = np.searchsorted(total, (np.arange(count) + rng.random()) / count * total[-1]).clip(0, len(total) - 1)
    edge, along = rng.random((2, count))
    root = np.sqrt(edge)
    share = np.stack([1 - root, root * (1 - along), root * along], axis=1)
    rgba = part.sample(np.einsum("nk,nkc->nc", share, part.uv[face]))
    return SurfacePoints(part.faces[face].astype(np.intp), share), face, rgba


def carved(hair: FittedHair, points: F64) -> Bools:
    """Return [M] which ``points`` [M, 3] of the zero pose the picture does not contradict.

    Points before skin or clothes that the picture shows go, so do those outside its outline, above a hat's rim, and
    below the end of ``hair``.
    """
    head, seen = hair.head, hair.seen
    there = head.camera(points)
    pixels = head.shot.project(there)
    flat = head.plane(pixels)
    inside = value_at(_grown(head, head.shot.mask, _OUTLINE_PLAY_M), pixels)
    on_hair = value_at(_grown(head, seen.mask, _HAIR_PLAY_M), pixels)
    behind = head.body_z(pixels)
    beside = cv2.morphologyEx(seen.mask.astype(np.uint8), cv2.MORPH_CLOSE, _square(head, _GAP_M)) > 0
    on_hair |= value_at(beside, pixels) & np.isinf(behind)  # gaps in it, but none before the face
    front = there[:, 2] < behind + _FRONT_PLAY_M
    facing = (there[:, 2] < head.camera_z + 0.02) & (flat[:, 1] > head.sizes.chin - 0.02)
    locks = (
        0.012 * np.sin(points[:, 0] * 210) + 0.009 * np.sin(points[:, 0] * 530 + 1) + 0.01 * np.sin(points[:, 2] * 300)
    )
    stays = inside & (on_hair | ~(front | facing)) & (flat[:, 1] > hair.end + locks)
    if seen.hat is not None:
        above = flat[:, 1] > seen.hat
        some = np.flatnonzero(stays & above & (flat[:, 1] < seen.hat + _UNDER_BRIM_M) & (there[:, 2] > head.camera_z))
        stays &= ~above
        stays[some] = _under_brim(head, seen.hat, points[some])
    return stays


def _under_brim(head: HeadView, rim: float, points: F64) -> Bools:
    """Return [M] which ``points`` [M, 3] a brim covers: between the widest place and the lower edge of the hat."""
    hat = head.shot.mesh.vertices[head.skull & (head.plane_of(head.bare)[:, 1] > rim)] - head.middle
    if len(hat) < _NEAR_VERTICES or not len(points):
        return np.zeros(len(points), bool)
    around, at = hat[:, ::2], (points - head.middle)[:, ::2]
    far, aside = lengths(around), lengths(at)
    near = cKDTree(around / far[:, None]).query(at / aside[:, None], k=_NEAR_VERTICES)[1]
    edge = np.take_along_axis(near, hat[near, 1].argmin(axis=1)[:, None], axis=1)[:, 0]
    wide, narrow = far[near].max(axis=1), far[edge]
    return np.asarray((aside > narrow) & (aside < wide - _BRIM_PLAY_M) & (np.median(wide - narrow) > _MIN_BRIM_M))


def bared(hair: FittedHair, shots: tuple[FittedPicture, ...]) -> tuple[FittedHair, tuple[FittedPicture, ...]]:
    """Give head and neck under the hair the bare body's shape; return the hair and the pictures of that body.

    The fit had drawn them out to the hair's outline. A face moves only where hair covers it and its fit bulges; what is
    under a hat stays.
    """
    head, mesh = hair.head, shots[0].mesh
    body, beside = head.body, _grown(head, hair.seen.mask, _NECK_REACH_M)
    bulge, pixels = lengths(mesh.vertices - head.bare), shots[0].view.pixels
    covered = (bulge > _FACE_BULGE_M) & value_at(hair.seen.mask, pixels)
    gone = head.skull & (~face_vertices(body) | covered)
    gone |= vertices_of(body, "neck") & value_at(beside, pixels)
    if hair.seen.hat is not None:
        gone &= head.plane_of(head.bare)[:, 1] < hair.seen.hat
    share, degree = gone.astype(np.float64), np.asarray(body.neighbours.sum(axis=1)).ravel().clip(1)
    for _ in range(_SMOOTHING_ROUNDS):
        share = np.where(gone & (share > 0.99), 1.0, body.neighbours @ share / degree)
    share *= body.skin
    mesh = replace(mesh, vertices=mesh.vertices + share[:, None] * (head.bare - mesh.vertices))
    views = [shot.view.moved(mesh, share > 0) for shot in shots]
    out = tuple(
        replace(shot, mesh=mesh, view=replace(view, pixels=shot.project(view.vertices)))
        for shot, view in zip(shots, views, strict=True)
    )
    return replace(hair, head=replace(head, shot=out[0])), out


def haired(hair: FittedHair) -> Bools:
    """Return a mask [V] of the skin of head and neck, below a hat's rim, that a template covers with hair."""
    out = hair.head.body.skin & vertices_of(hair.head.body, "head", "jaw", "neck")
    if hair.seen.hat is not None:
        out &= hair.head.plane_of(hair.head.bare)[:, 1] < hair.seen.hat
    return out


def _hair_end(head: HeadView, seen: SeenHair, long: bool) -> float:
    """Return the height in the head's plane down to which hair hangs on a back.

    Shoulders hide the end of ``long`` hair, unless it ends at the chin's height: it hangs down, also from a tilted
    head. The neck hides that of other hair.
    """
    hidden = 1.0
    if long:
        low = np.quantile(seen.plane @ -head.up, 0.02)
        hidden = float(smoothstep(-head.sizes.chin * head.up[1] - low, 0.0, _REACHES_SHOULDERS_M))
    return float(np.quantile(seen.plane[:, 1], 0.01)) - _FREE_M - hidden * (_BEHIND_SHOULDERS_M - _FREE_M)


def _grown(head: HeadView, mask: Bools, metres: float) -> Bools:
    return cv2.dilate(mask.astype(np.uint8), _square(head, metres)) > 0


def _square(head: HeadView, metres: float) -> NDArray[np.uint8]:
    return np.ones((2 * max(1, int(metres * head.scale)) + 1,) * 2, np.uint8)


def _carried(points: F64, source: F64, target: F64) -> F64:
    """Return ``points`` [N, 3] moved as ``source`` [K, 3] to ``target``: affinely, and near it by what that leaves."""
    ones = np.ones((len(source), 1))
    affine = np.linalg.lstsq(np.hstack([source, ones]), target, rcond=None)[0]
    left = target - np.hstack([source, ones]) @ affine
    distance, near = cKDTree(source).query(points, k=8)
    weight = 1 / (distance**2 + 1e-5)
    weight *= np.exp(-distance[:, :1] / 0.05) / weight.sum(axis=1, keepdims=True)
    return np.asarray(
        np.hstack([points, np.ones((len(points), 1))]) @ affine + np.einsum("nk,nkc->nc", weight, left[near])
    )


def _outside(head: HeadView, points: F64) -> F64:
    """Return points moved out of the bare head and the dressed body."""
    mesh, out = head.shot.mesh, points.copy()
    low = points[:, 1] < mesh.skeleton.joints[JOINT_NAMES.index("neck"), 1] + 0.03
    skin = head.body.skin
    dressed = np.where(vertices_of(head.body, "neck")[:, None], head.bare, mesh.vertices)  # hair made a neck's outline
    for some, vertices, gap in ((~low, head.bare, _SKULL_GAP_M), (low, dressed, _CLOTH_GAP_M)):
        if not some.any():
            continue
        normals = vertex_normals(vertices, mesh.faces)[skin]
        distance, near = cKDTree(vertices[skin]).query(points[some], k=4)
        weight = 1 / (distance**2 + 1e-6)
        weight /= weight.sum(axis=1, keepdims=True)
        base, normal = (np.einsum("nk,nkc->nc", weight, each[near]) for each in (vertices[skin], normals))
        normal /= np.linalg.norm(normal, axis=1, keepdims=True) + 1e-9
        height = ((points[some] - base) * normal).sum(axis=1)
        out[some] += (gap - height).clip(0, 0.06)[:, None] * normal
    return out


def _with_outline(head: HeadView, seen: SeenHair, where: F64, long: bool) -> F64:
    """Return vertices as wide as the seen hair at each height.

    Above the eyes, the outline is stretched as a curve about them. The hair's depth follows its width; hair that
    hangs keeps it.
    """
    sizes = head.sizes
    flat = head.plane_of(where)
    tall = np.ones(len(where))
    upper = flat[:, 1] > sizes.eyes
    if seen.hat is None:
        high = np.quantile(seen.plane[:, 1], 0.995) - sizes.eyes
        tall[upper] = np.clip(high / (flat[:, 1].max() - sizes.eyes), 0.8, 1.5)
        flat[upper, 1] = sizes.eyes + (flat[upper, 1] - sizes.eyes) * tall[upper]
    low = np.minimum(flat[:, 1], sizes.eyes)
    rows = np.arange(min(low.min(), seen.plane[:, 1].min()), sizes.eyes + _ROW_M, _ROW_M)
    mine, photo = _row_ends(flat, rows, 0.0), _row_ends(seen.plane, rows, 0.01)
    scales = np.full((len(rows), 2), np.nan)
    for side, sign in ((0, -1), (1, 1)):
        good = (sign * photo[:, side] > _MIN_EXTENT_M) & (sign * mine[:, side] > _MIN_EXTENT_M)
        if good.sum() > 3:
            ratio = (photo[good, side] / mine[good, side]).clip(*_STRETCH)
            scales[:, side] = gaussian_filter1d(np.interp(rows, rows[good], ratio), 0.015 / _ROW_M)
    scales = np.where(np.isnan(scales), scales[:, ::-1], scales)
    scales = np.where(np.isnan(scales), 1.0, scales)
    left, right = (np.interp(low, rows, scales[:, side]) for side in (0, 1))
    wide = left + (right - left) * smoothstep(flat[:, 0], -0.04, 0.04)  # smooth, so that the parting does not tear
    if seen.hat is None:
        round_, near = _round_scale(seen.plane, flat, sizes.eyes), smoothstep(flat[:, 1] - sizes.eyes, 0.0, 0.03)
        wide = wide + near * (round_ - wide)
        tall *= 1 + near * (round_ - 1)
    hangs = 1 - smoothstep(flat[:, 1], sizes.chin - 0.03, sizes.eyes) if long else np.zeros(len(where))
    # one depth: hair beside the ears may stand out, behind them it would be a beak
    deep = 1 + (1 - hangs) * (np.median(wide[upper]).clip(*_DEEPER) - 1)
    wide = wide + hangs * (wide.clip(0.85, 1.2) - wide)
    centre = np.array([0.0, sizes.eyes_rest, head.middle[2]])
    return np.asarray(centre + (where - centre) * np.stack([wide, tall, deep], axis=1))


def _row_ends(flat: F64 | NDArray[np.float32], rows: F64, low: float) -> F64:
    """Return [R, 2] left and right ends of points [N, 2] in each row, NaN where there are fewer than three."""
    ends = np.full((len(rows), 2), np.nan)
    index = np.round((flat[:, 1] - rows[0]) / _ROW_M).astype(np.intp)
    for row in range(len(rows)):
        aside = flat[index == row, 0]
        if len(aside) > 2:
            ends[row] = np.quantile(aside, [low, 1 - low])
    return ends


def _round_scale(photo: F64 | NDArray[np.float32], mine: F64, eyes: float) -> F64:
    """Return [N] the seen hair's reach from the eyes over that of ``mine`` [N, 2], in each point's direction."""
    angles = np.linspace(0, np.pi, 37)
    reach = np.full((2, len(angles)), np.nan)
    for row, (flat, quantile) in enumerate(((photo, 0.98), (mine, 1.0))):
        direction, far = np.arctan2(flat[:, 1] - eyes, flat[:, 0]), np.hypot(flat[:, 0], flat[:, 1] - eyes)
        for column, angle in enumerate(angles):
            near = np.abs(direction - angle) < 0.07
            if near.sum() > 2:
                reach[row, column] = np.quantile(far[near], quantile)
    good = np.isfinite(reach).all(axis=0)
    if good.sum() < 6:
        return np.ones(len(mine))
    ratio = (reach[0, good] / reach[1, good]).clip(_STRETCH[0], 1.45)
    smooth = gaussian_filter1d(np.interp(angles, angles[good], ratio), 2)
    return np.interp(np.arctan2(mine[:, 1] - eyes, mine[:, 0]), angles, smooth)


def _binding(head: HeadView, where: F64) -> tuple[NDArray[np.int64], F64]:
    """Return joints and weights [V, 2]: hair above the neck follows the head, lower hair the back, joint by joint."""
    ids = np.array([JOINT_NAMES.index(name) for name in _CHAIN])
    heights = head.shot.mesh.skeleton.joints[ids, 1]
    heights[-1] = head.shot.mesh.skeleton.joints[JOINT_NAMES.index("neck"), 1] + 0.04
    at = np.interp(where[:, 1], heights, np.arange(len(ids)))
    low = np.floor(at).astype(np.intp).clip(0, len(ids) - 2)
    upper = smoothstep(at - low, 0.0, 1.0)
    return np.stack([ids[low], ids[low + 1]], axis=1), np.stack([1 - upper, upper], axis=1)
