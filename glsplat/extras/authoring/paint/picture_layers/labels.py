"""What each pixel of a person shows, from the fitted body's own projection, colours and edges.

The projection knows the order of depth and is right to a few percent of the person's height. Within that distance of
an arm each pixel goes to arm or not by its colours (GrabCut, Rother et al. 2004), forearm and upper arm on their own,
since a sleeve ends between them. Pieces of the room between arm and trunk, which masks hold, are told by their colour,
too; and what lies beside the body near a hand is a thing that is held.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.body.segments import LAYER_COUNT, layer_of
from glsplat.extras.authoring.compute.threads import map_threads
from glsplat.extras.authoring.paint.picture_layers.fill import disc
from glsplat.rotations import component_sums

__all__ = ["NOTHING", "labels_of"]

Mask = NDArray[np.bool_]
F64 = NDArray[np.float64]
Labels = NDArray[np.intp]

NOTHING = -1
"""The label of pixels that show nothing of the body."""

_UNSURE = 0.03  # of the person's height: how far from a projected arm its pixels may lie
_CORE = 0.014  # of it: so deep inside a projected arm nothing else is
_BONE = 0.016  # of it, the width that an arm at least has
_WIDE = 0.018, 0.035  # of it: so far aside of a bone an arm surely is, and may be
_BEYOND = 0.5  # of the forearm's length: how far beyond the wrist the hand reaches
_FINGER = 0.006  # of it, the width that a finger at least has
_BELOW = 0.45  # of the upper arm: where its own layer begins for sure
_LIKELY = 0.4, 2.0  # area of an arm against its projection; other answers are not believed
_FEWEST = 12  # pixels of a segment that is asked for
_ISLAND = 0.006  # of the person's area; smaller pieces of the trunk beyond an arm are nobody's
_ROOM = 12.0, 0.25  # squared distance to the room's colours, at most, and against the person's
_HAIR = 0.4
_EDGED = 2  # pixels around a piece of the room that are of it where they are more like it than like the person
_EDGE = 0.02  # of the height: deeper in the projected trunk there is no room
_HELD, _THING = 0.06, 0.0012  # of the height to a hand; of its square
_APART = 0.012  # of the height between the body and what is beside it
_NOBODY = (255, 0, 255)  # a colour that no person has


def labels_of(
    rgb: NDArray[np.uint8], mask: Mask, segment: Labels, hand: Mask, head: Mask, bones: F64 | None = None
) -> Labels:
    """[H, W] the layer that each pixel shows, NOTHING outside the ``mask`` and where the mask holds other things.

    ``segment`` [H, W] is what the fitted body shows there, NOTHING beside it; ``hand`` and ``head`` where that is one.
    ``bones`` [2, 24, 2] are pixels of shoulders, elbows, wrists and 21 landmarks of the hands, left and right, not
    finite where they are not seen.
    """
    rows = np.flatnonzero(mask.any(axis=1))
    height = float(rows[-1] - rows[0] + 1)
    lab = cv2.cvtColor(rgb, cv2.COLOR_RGB2LAB)
    label = np.where(mask, 0, NOTHING).astype(np.intp)
    arms = range(1, LAYER_COUNT)
    found = map_threads(lambda k: _arm(lab, mask, segment, k, height, None if bones is None else bones[k - 1]), arms)
    for layer, arm in zip(arms, found, strict=True):
        label[arm & ((label == 0) | (layer_of(segment) == layer))] = layer
    label[_room(lab, mask, segment, label, head, height)] = NOTHING
    count, pieces, sizes, _ = cv2.connectedComponentsWithStats((label == 0).astype(np.uint8), connectivity=4)
    small = np.flatnonzero(sizes[:, cv2.CC_STAT_AREA] < _ISLAND * mask.sum())
    label[np.isin(pieces, small[small > 0]) & (count > 2)] = NOTHING
    label[_held_things(lab, mask, segment, label, hand, height)] = NOTHING
    return label


def _arm(lab: NDArray[np.uint8], mask: Mask, segment: Labels, layer: int, height: float, bones: F64 | None) -> Mask:
    """Where the arm of this layer shows."""
    parts = [segment == number for number in (2 * layer - 1, 2 * layer)]
    away = [_distance(part) for part in parts]
    whole = parts[0] | parts[1]
    total = np.zeros(mask.shape, bool)
    for index, part in enumerate(parts):
        if part.sum() < _FEWEST:
            continue
        near = mask & (away[index] <= _UNSURE * height) & (away[index] <= away[1 - index])
        likely = part
        deep = cv2.distanceTransform(part.astype(np.uint8), cv2.DIST_L2, 3)
        core = mask & (deep > min(_CORE * height, 0.6 * float(deep.max())))
        if bones is not None and np.isfinite(bones[:3]).all():
            # the landmarks are nearer to the truth than the fit's depth
            first, last = bones[index], bones[index + 1]
            bone = _line(first if index else first + _BELOW * (last - first), last, mask.shape, height)
            fingers = np.zeros_like(bone)
            if index and np.isfinite(bones[3:]).all():
                fingers = _hand(bones[3:], mask.shape, height)
            reached = _line(first, last + index * _BEYOND * (last - first), mask.shape, height)
            aside = _distance((reached | fingers) > 0)
            near |= mask & ((fingers > 0) | ((bone > 0) & (away[index] <= 2 * _UNSURE * height)))
            near &= aside <= _WIDE[1] * height
            likely = part & (aside <= _WIDE[0] * height)
            core = mask & ((bone | fingers) > 0) & near
        seen = lab.copy()
        seen[~mask | (parts[1 - index] & ~near)] = _NOBODY
        mine = _cut(seen, near, likely & near, core & near, away[index] <= 3 * _UNSURE * height)
        believed = _LIKELY[0] * part.sum() < mine.sum() < _LIKELY[1] * part.sum()
        total |= (mine if believed else part) & mask
    arm = cv2.morphologyEx(total.astype(np.uint8), cv2.MORPH_OPEN, disc(1))
    arm = cv2.morphologyEx(arm, cv2.MORPH_CLOSE, disc(2))
    _, pieces = cv2.connectedComponents(arm)
    return np.asarray((arm > 0) & np.isin(pieces, np.unique(pieces[whole & (arm > 0)])))


def _line(first: F64, last: F64, shape: tuple[int, ...], height: float) -> NDArray[np.uint8]:
    """[H, W] one along a bone between two pixels [2]."""
    ends = [tuple(int(side) for side in point.clip(-1e4, 1e4)) for point in (first, last)]
    return np.asarray(cv2.line(np.zeros(shape, np.uint8), ends[0], ends[1], 1, max(3, round(_BONE * height))))


def _hand(points: F64, shape: tuple[int, ...], height: float) -> NDArray[np.uint8]:
    """[H, W] one on the palm and along the fingers of a hand's landmarks [21, 2]."""
    drawn = np.zeros(shape, np.uint8)
    at = points.clip(-1e4, 1e4).astype(np.int32)
    cv2.fillConvexPoly(drawn, cv2.convexHull(at[[0, 1, 5, 9, 13, 17]]), 1)
    chains = [at[[0, *range(first, first + 4)]] for first in (1, 5, 9, 13, 17)]
    cv2.polylines(drawn, chains, False, 1, max(1, round(_FINGER * height)))
    return drawn


def _cut(seen: NDArray[np.uint8], near: Mask, likely: Mask, sure: Mask, around: Mask) -> Mask:
    """GrabCut within ``near``, begun from ``likely``; ``around`` says how much beside it is looked at."""
    trimap = np.full(near.shape, cv2.GC_BGD, np.uint8)
    trimap[near], trimap[likely], trimap[sure] = cv2.GC_PR_BGD, cv2.GC_PR_FGD, cv2.GC_FGD
    rows, columns = np.flatnonzero(around.any(axis=1)), np.flatnonzero(around.any(axis=0))
    box = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    found = np.ascontiguousarray(trimap[box])
    kinds = [int(((found == a) | (found == b)).sum()) for a, b in ((0, 2), (1, 3))]
    out = np.zeros(near.shape, bool)
    if sure.sum() < _FEWEST or min(kinds) < _FEWEST:
        return out
    cv2.setRNGSeed(0)
    models = np.zeros((1, 65)), np.zeros((1, 65))
    cv2.grabCut(np.ascontiguousarray(seen[box]), found, None, *models, 3, cv2.GC_INIT_WITH_MASK)
    out[box] = (found == cv2.GC_FGD) | (found == cv2.GC_PR_FGD)
    return out & near


def _room(lab: NDArray[np.uint8], mask: Mask, segment: Labels, label: Labels, head: Mask, height: float) -> Mask:
    """What is much more like the room nearby than like arm or trunk nearby."""
    layer, colours = layer_of(segment), lab.astype(np.float32)
    inner = cv2.erode(mask.astype(np.uint8), disc(2)) > 0
    outer = cv2.dilate(mask.astype(np.uint8), disc(2)) == 0
    # where the fit has a hand and the picture has none, there may be the wall
    cores = [
        inner & (cv2.erode(((layer == k) & (label == k)).astype(np.uint8), disc(3)) > 0) for k in range(LAYER_COUNT)
    ]
    asked = [(outer, 0.08), (outer, 0.03), *((core, 0.03) for core in cores)]
    unlike = map_threads(lambda some: _unlike(colours, some[0], some[1] * height), asked)
    room, person = np.minimum(unlike[1], unlike[0]), np.minimum.reduce(unlike[2:])
    shallow = cv2.distanceTransform((layer == 0).astype(np.uint8), cv2.DIST_L2, 3) < _EDGE * height
    strict = np.where(_distance(head) < _UNSURE * height, np.float32(_HAIR), np.float32(1))  # hair may be fair, or thin
    found = mask & shallow & (room < _ROOM[0] * strict) & (room < _ROOM[1] * strict * person)
    found = cv2.morphologyEx(found.astype(np.uint8), cv2.MORPH_OPEN, disc(1))
    # its edges are mixed with the person
    return np.asarray((found > 0) | (mask & (cv2.dilate(found, disc(_EDGED)) > 0) & (room < strict * person)))


def _unlike(colours: NDArray[np.float32], some: Mask, reach: float) -> NDArray[np.float32]:
    """[H, W] squared distance of each colour to those of ``some`` pixels nearby, in standard deviations."""
    weight = some.astype(np.float32)
    total = cv2.GaussianBlur(weight, (0, 0), reach)
    known = np.maximum(total, 1e-5)[..., None]
    mean = cv2.GaussianBlur(colours * weight[..., None], (0, 0), reach) / known
    spread = cv2.GaussianBlur(colours**2 * weight[..., None], (0, 0), reach) / known - mean**2
    away = component_sums((colours - mean) ** 2 / (np.maximum(spread, 0) + 16))
    return np.where(total > 2e-3, away, np.float32(1e6))


def _held_things(lab: NDArray[np.uint8], mask: Mask, segment: Labels, label: Labels, hand: Mask, height: float) -> Mask:
    """Bags, balls: what the mask holds beside the body near a hand, and what of the body has its colours."""
    out = np.zeros(mask.shape, bool)
    if not hand.any():
        return out
    body = cv2.dilate((segment >= 0).astype(np.uint8), disc(max(2, int(_APART * height)))) > 0
    beside = mask & (label == 0) & ~body
    away = _distance(hand)
    count, pieces, sizes, _ = cv2.connectedComponentsWithStats(beside.astype(np.uint8))
    for number in range(1, count):
        piece = pieces == number
        if sizes[number, cv2.CC_STAT_AREA] < _THING * height**2 or away[piece].min() > _HELD * height:
            continue
        near = (_distance(piece) <= 0.08 * height) & (label == 0)
        seen = lab.copy()
        seen[~mask | (label > 0)] = _NOBODY
        core = cv2.erode(piece.astype(np.uint8), disc(1)) > 0
        thing = _cut(seen, near, near & beside, core, _distance(piece) <= 0.16 * height)
        out |= thing if thing.sum() < 4 * piece.sum() else piece
    return out


def _distance(some: Mask) -> NDArray[np.float32]:
    """[H, W] pixels to the nearest of ``some``, far where there is none."""
    if not some.any():
        return np.full(some.shape, 1e9, np.float32)
    return np.asarray(cv2.distanceTransform((~some).astype(np.uint8), cv2.DIST_L2, 3), np.float32)
