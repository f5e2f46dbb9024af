"""Find hair in the front picture: by a network, or by colours like those of the crown or beside the face."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2

from glsplat.extras.authoring.body.segments import trunk_vertices
from glsplat.extras.authoring.fit.offsets import face_vertices
from glsplat.extras.authoring.networks.head_parts import HeadPart
from glsplat.extras.authoring.templates.head_view import HeadView, value_at
from glsplat.pictures import to_linear, to_srgb

F64 = NDArray[np.float64]
Bools = NDArray[np.bool_]

_METRIC = np.array([0.6, 1.0, 1.0], np.float32)  # of CIELAB: light changes lightness more than hue
_SHADES = (0.35, 0.5, 0.7, 1.0)  # of one colour, in linear light, from above to below the face
_MIN_UNLIKE_SKIN = 13.0  # of a crown with hair, in CIELAB; below it the outline decides
_MIN_RIM_FRACTION = 0.15  # of the bare head's area in the picture: hair beside it that is like skin
_MIN_WORN = 18.0  # of hair beside the face
_MIN_HAT = 20.0  # between a hat and the hair below it
_MAX_LIGHTER = 40.0  # of hair beside the face than this, in lightness: more is a hand or the room beside a dark mask
_MAX_LIKE, _SURE_LIKE = 40.0, 10.0  # distance of hair from its median colour
_MIN_CLOTH_FRACTION = 0.25  # of the chest, for a colour that is no print
_OUTSIDE_BONUS = 8.0  # in CIELAB; what stands out beside the bare head is probably hair
_SAME_AS_CLOTH = 12.0  # hair on cloth of its colour ends at the shoulders
_NEVER_HAIR = (HeadPart.BACKGROUND, HeadPart.LEFT_EAR, HeadPart.RIGHT_EAR, HeadPart.CLOTH, HeadPart.HAT)
_MIN_PIXELS = 60  # of a lock
_BROWS_M = 0.03  # above the eyes
# of the pixels above the eyes: those labelled room or cloth, at most; a hat's and hair's, at least
_MAX_UNKNOWN, _MIN_HAT_FRACTION, _MIN_HAIR_FRACTION = 0.25, 0.2, 0.08
_BESIDE_HEADS = 1.3  # of the head's height, to both sides, that is searched
_BELOW_HEADS = 2.2  # below the chin


@dataclass(frozen=True, slots=True, eq=False)
class SeenHair:
    """Hair in the front picture."""

    mask: Bools  # [H, W]
    plane: F64 | NDArray[np.float32]  # [M, 2] metres of its pixels in the head's plane, at most 20,000
    hat: float | None  # height of a hat's rim in that plane; None without a hat


def seen_hair(head: HeadView, parts: NDArray[np.uint8] | None = None) -> SeenHair | None:
    """Return the hair that the picture shows, or None for a bald or wholly covered head.

    ``parts`` are the person's ``head_parts`` [H, W]. Colours decide without them, and where they show no hair.
    """
    shot, sizes = head.shot, head.sizes
    box = _box(head)
    rgb, mask = shot.rgb[box], shot.mask[box]
    rows, columns = np.mgrid[box]
    pixels = np.stack([columns, rows], axis=-1) + 0.5
    where = head.plane(pixels)
    aside, up = np.abs(where[..., 0]), where[..., 1]
    look = cv2.cvtColor(rgb.astype(np.float32) / 255, cv2.COLOR_RGB2LAB)
    tall = sizes.top - sizes.chin
    near = mask & (aside < _BESIDE_HEADS * tall) & (up > sizes.chin - _BELOW_HEADS * tall)

    def away(colour: F64) -> NDArray[np.float32]:
        return np.linalg.norm((look - colour.astype(np.float32)) * _METRIC, axis=2)

    def seen(found: Bools, hat: float | None = None) -> SeenHair:
        out = np.zeros(shot.mask.shape, bool)
        out[box] = found
        plane = where[found]
        return SeenHair(out, plane[:: max(1, len(plane) // 20_000)], hat)

    main, scalp = _cloths(head, look, box), ~_face(head, box)
    beard = (aside < 0.65 * sizes.half_width) & (up < sizes.eyes + 0.02)  # or face, throat and collar
    if (
        parts is not None
        and (labelled := _labelled_hair(head, look, parts[box], main, near, scalp, beard, aside, up)) is not None
    ):
        return seen(*labelled)
    face = _vertex_pixels(head, face_vertices(head.body), box)
    skin = np.median(look[face], axis=0)
    above = near & (up > sizes.top - 0.035) & (aside < 0.06)
    beside = near & (np.abs(up - sizes.eyes) < 0.05) & (aside > 0.85 * sizes.half_width)
    crown = np.median(look[above], axis=0) if above.any() else skin
    flanks = beside & (away(skin) > 16)
    flank = np.median(look[flanks], axis=0) if flanks.sum() > 30 else crown
    worn = flanks.sum() > 0.15 * max(beside.sum(), 1) and _apart(flank, skin) > _MIN_WORN
    worn &= flank[0] - skin[0] < _MAX_LIGHTER
    # by a hat, unless the crown is the same hair in other light
    covered = worn and min(_apart(crown, lit) for lit in _shaded(flank, (*_SHADES, 1.4, 2.0, 2.8))) > _MIN_HAT
    hair = flank if covered else crown
    like = np.min([away(shade) for shade in _shaded(hair, _SHADES)], axis=0)
    bare = np.isfinite(head.body_z(pixels.reshape(-1, 2))).reshape(mask.shape)
    outside = near & (up > sizes.chin) & ~bare
    if not worn and _apart(crown, skin) < _MIN_UNLIKE_SKIN:
        rim = outside & (like < _SURE_LIKE)
        return seen(rim) if rim.sum() > _MIN_RIM_FRACTION * (bare & (up > sizes.chin)).sum() else None
    like = like - np.where(outside, _OUTSIDE_BONUS, 0.0).astype(np.float32)
    other = np.min([away(shade) for shade in _shaded(skin, (*_SHADES, 1.3))], axis=0)
    cloths = [cloth for cloth, _ in main if _apart(cloth, hair) > _SAME_AS_CLOTH]
    like_hair = sum(share for cloth, share in main if _apart(cloth, hair) <= _SAME_AS_CLOTH)
    below = up < sizes.chin + 0.01
    never = ~near | beard
    core = np.zeros(mask.shape, np.uint8)
    core[face] = 1
    core = cv2.morphologyEx(core, cv2.MORPH_CLOSE, np.ones((max(3, int(0.012 * head.scale)),) * 2, np.uint8))
    never |= (core > 0) & (away(skin) < 25)
    for cloth in cloths:
        never |= below & (away(cloth) < like)
        other = np.where(below, np.minimum(other, away(cloth)), other)
    if like_hair:
        never |= (up < sizes.chin - 0.03) & ((aside < sizes.half_width) | (like_hair > 0.5))
    high = up < sizes.eyes + 0.06 if covered else up > sizes.eyes - 0.02
    unlike = away(skin) > min(18.0, 0.5 * _apart(hair, skin))
    sure = cv2.erode((near & (like < _SURE_LIKE) & unlike & high).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    found = _grown(rgb, near, sure, never, like < np.minimum(away(skin), _MAX_LIKE), rgb[face])
    if found is None:
        return None
    lock = near & (like < 0.85 * other) & (like < 26) & (aside < 0.8 * tall)
    found |= _opened(lock & ~never)
    found = _opened(found & near & (like < np.minimum(other, _MAX_LIKE)))
    found = _with_fringe(_from_head(found, up, sizes.eyes, scalp), lock & beard)
    if not found.any():
        return None
    hat = None
    if covered:
        cap = near & (up > sizes.eyes) & ~found & (away(crown) < away(hair)) & (aside > 0.7 * sizes.half_width)
        hat = float(np.quantile(up[cap], 0.1)) if cap.any() else sizes.eyes + 0.05
    return seen(found, hat)


def _labelled_hair(
    head: HeadView,
    look: NDArray[np.float32],
    parts: NDArray[np.uint8],
    main: list[tuple[F64, float]],
    near: Bools,
    scalp: Bools,
    beard: Bools,
    aside: NDArray[np.floating],
    up: NDArray[np.floating],
) -> tuple[Bools, float | None] | None:
    """Return the mask of hair [h, w] and the height of a hat's rim, both by the labels ``parts`` of a network.

    None if they show no hair, or room and cloth where the skull is. ``main`` are the chest's colours: cloth between
    locks is no hair, and hair that is labelled as a collar is.
    """
    sizes = head.sizes
    above = near & (up > sizes.eyes)
    unknown = np.isin(parts[above], (HeadPart.BACKGROUND, HeadPart.CLOTH))
    if unknown.sum() > _MAX_UNKNOWN * len(unknown):
        return None
    hat = above & (parts == HeadPart.HAT)
    found = near & ((parts == HeadPart.HAIR) | ((parts == HeadPart.HAT) & ~hat))
    sure = found & ~beard
    if not sure.any():
        return None
    hair = np.median(look[sure], axis=0)
    if hat.any() and _apart(np.median(look[hat], axis=0), hair) < _MIN_HAT:  # the same in other light
        found, hat = found | hat, np.zeros_like(hat)

    def away(colours: F64) -> NDArray[np.float32]:
        return np.min([np.linalg.norm((look - one.astype(np.float32)) * _METRIC, axis=2) for one in colours], axis=0)

    like = away(_shaded(hair, _SHADES))
    beside = (aside > sizes.half_width) & (up > sizes.chin)
    found |= near & (parts == HeadPart.CLOTH) & (like < _SURE_LIKE) & beside
    face = (parts == HeadPart.SKIN) & beard & (up > sizes.chin)
    skin = np.median(look[face], axis=0) if face.any() else hair
    high = sure & scalp & (up > sizes.eyes + _BROWS_M)  # a cheek in shade is labelled as hair, and no forehead is
    top = np.median(look[high], axis=0) if high.any() else hair
    if min(_apart(skin, hair), _apart(skin, top)) > _MIN_UNLIKE_SKIN:  # sleek hair is labelled as forehead or glasses
        other = away(_shaded(skin, (*_SHADES, 1.3)))
        found |= near & (up > sizes.eyes - 0.03) & ~np.isin(parts, _NEVER_HAIR) & (like < np.minimum(0.85 * other, 26))
    for cloth, _ in main:
        if _apart(cloth, hair) > _SAME_AS_CLOTH:
            found &= (up > sizes.chin) | (like < away(cloth[None]))
    found = _opened(found)
    found = _with_fringe(_from_head(found & ~beard, up, sizes.eyes, scalp), found & beard)
    if not found.any() or found.sum() < _MIN_HAIR_FRACTION * above.sum():
        return None
    worn = hat.sum() > _MIN_HAT_FRACTION * above.sum()
    sides = hat & (aside > 0.7 * sizes.half_width)
    return found, float(np.quantile(up[sides if sides.any() else hat], 0.1)) if worn else None


def _from_head(mask: Bools, up: NDArray[np.floating], eyes: float, scalp: Bools) -> Bools:
    """Return the connected components of ``mask`` with a pixel of ``scalp`` [h, w] above the eyes: no eyebrows."""
    count, label = cv2.connectedComponents(mask.astype(np.uint8))
    highest = scalp & (up > eyes - 0.03)
    kept = [k for k in range(1, count) if (m := label == k).sum() > _MIN_PIXELS and highest[m].any()]
    return np.isin(label, kept)


def _face(head: HeadView, box: tuple[slice, slice]) -> Bools:
    """Return the pixels in ``box`` within the outline of the bare face."""
    face = head.shot.project(head.camera(head.bare[face_vertices(head.body)])) - (box[1].start, box[0].start)
    out = np.zeros((box[0].stop - box[0].start, box[1].stop - box[1].start), np.uint8)
    return cv2.fillConvexPoly(out, cv2.convexHull(face.astype(np.int32)), 1) > 0


def _with_fringe(hair: Bools, face: Bools) -> Bools:
    """Return ``hair`` [h, w], continued downwards through the pixels of ``face`` that may be hair; a beard is apart."""
    out = hair.copy()
    for row in range(1, len(out)):
        out[row] |= out[row - 1] & face[row]
    return out


def _box(head: HeadView) -> tuple[slice, slice]:
    """Return rows and columns of the picture about the head and the hair below it."""
    sizes, shot = head.sizes, head.shot
    tall = sizes.top - sizes.chin
    corner = shot.project(head.camera(head.middle[None]))[0]
    wide, high, low = (head.scale * size for size in (1.5 * tall, 1.6 * tall, (_BELOW_HEADS + 0.7) * tall))
    first = np.maximum(corner - (wide, high), 0).astype(int)
    last = (corner + (wide, low)).astype(int)
    return slice(first[1], min(last[1], shot.mask.shape[0])), slice(first[0], min(last[0], shot.mask.shape[1]))


def _vertex_pixels(head: HeadView, some: Bools, box: tuple[slice, slice]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return rows and columns in ``box`` of the vertices ``some`` [V] on the person that clearly face the camera.

    An arm may hide them: labels of the picture's layers would take a second.
    """
    shot = head.shot
    pixels = shot.view.pixels[some & (shot.facing > 0.5) & value_at(shot.mask, shot.view.pixels)]
    row, column = pixels[:, 1].astype(np.intp) - box[0].start, pixels[:, 0].astype(np.intp) - box[1].start
    inside = (row >= 0) & (column >= 0) & (row < box[0].stop - box[0].start) & (column < box[1].stop - box[1].start)
    return row[inside], column[inside]


def _cloths(head: HeadView, look: NDArray[np.float32], box: tuple[slice, slice]) -> list[tuple[F64, float]]:
    """Return the main colours of the chest, and the fraction of each."""
    colours = look[_vertex_pixels(head, trunk_vertices(head.body), box)].astype(np.float64)
    if len(colours) < 30:
        return []
    middles, kind = kmeans2(colours, 3, minit="++", seed=0)
    shares = np.bincount(kind, minlength=3) / len(kind)
    return [(middle, share) for middle, share in zip(middles, shares, strict=True) if share > _MIN_CLOTH_FRACTION]


def _grown(
    rgb: NDArray[np.uint8], near: Bools, sure: Bools, never: Bools, likely: Bools, face: NDArray[np.uint8]
) -> Bools | None:
    """Return the pixels that GrabCut takes for hair; None without enough ``sure`` ones."""
    cut = np.where(likely, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    cut[sure] = cv2.GC_FGD
    cut[never] = cv2.GC_BGD
    if (cut == cv2.GC_FGD).sum() < 40:
        return None
    cv2.setRNGSeed(0)
    seen = rgb.copy()
    seen[~near] = np.median(face, axis=0)  # a grey wall is no reason against grey hair
    cv2.grabCut(
        np.ascontiguousarray(seen[..., ::-1]), cut, None, np.zeros((1, 65)), np.zeros((1, 65)), 3, cv2.GC_INIT_WITH_MASK
    )
    return (cut == cv2.GC_FGD) | (cut == cv2.GC_PR_FGD)


def _opened(mask: Bools) -> Bools:
    return cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)) > 0


def _apart(one: F64, other: F64) -> float:
    return float(np.linalg.norm((one - other) * _METRIC))


def _shaded(colour: F64, factors: tuple[float, ...]) -> F64:
    """Return a CIELAB colour [3] in several lights, [N, 3]."""
    rgb = cv2.cvtColor(colour.astype(np.float32).reshape(1, 1, 3), cv2.COLOR_LAB2RGB)[0].clip(0, 1)
    lit = to_srgb(to_linear(rgb.astype(np.float64)) * np.array(factors)[:, None])
    return np.asarray(cv2.cvtColor(lit.astype(np.float32)[:, None], cv2.COLOR_RGB2LAB)[:, 0], np.float64)
