"""Label each pixel of a person with the layer it shows, from the fitted body's projection, colours and edges.

The projection gives the depth order and is right to a few percent of the person's height. Within that distance of an
arm, colours decide (GrabCut, Rother et al. 2004), for forearm and upper arm separately, since a sleeve ends between
them. Background between arm and trunk inside the mask is found by its colour, and things beside the body near a hand
count as held.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.body.segments import LAYER_COUNT, layer_of
from glsplat.extras.authoring.compute.threads import map_threads
from glsplat.extras.authoring.paint.picture_layers.fill import disc
from glsplat.rotations import component_sums

Mask = NDArray[np.bool_]
F64 = NDArray[np.float64]
Labels = NDArray[np.intp]

NOTHING = -1
"""The label of pixels that show nothing of the body."""

# fractions of the person's height, unless another length is named
_ARM_REACH_FRACTION = 0.03  # pixels of an arm are at most this far from its projection
_CORE_FRACTION, _MAX_CORE_FACTOR = 0.014, 0.6  # this deep in a projected arm is surely arm; over its greatest depth
_BONE_WIDTH_FRACTION, _FINGER_WIDTH_FRACTION = 0.016, 0.006  # drawn widths
_SURE_ARM_FRACTION, _MAX_ARM_FRACTION = 0.018, 0.035  # from a bone: surely arm, and perhaps
_HAND_REACH_FACTOR = 0.5  # of the forearm's length, beyond the wrist
_UPPER_ARM_START_FACTOR = 0.45  # of the upper arm, from the shoulder: surely arm beyond
_AREA_RANGE = 0.4, 2.0  # of an arm over its projection; other results are discarded
_MIN_PX = 12  # of a segment, and of either side of a cut
_MIN_ISLAND_FRACTION = 0.006  # of the person's area; smaller pieces of trunk are nobody's
# of background, squared distance in standard deviations: at most, and over that to the person
_MAX_ROOM_DISTANCE, _MAX_ROOM_RATIO = 12.0, 0.25
_HAIR_FACTOR = 0.4  # stricter near the head: hair may be fair, or thin
_ROOM_EDGE_PX = 2  # around background, where pixels may be mixed with it
_ROOM_DEPTH_FRACTION = 0.02  # background lies no deeper in the projected trunk
_ROOM_REACH_FRACTION, _NEAR_FRACTION = 0.08, 0.03  # background and body colours are taken from
_MIN_VARIANCE = 16  # of Lab
_BLUR_SIGMA_PX = 4.0  # at least, in the smaller picture of a wide blur
_HELD_REACH_FRACTION, _MIN_HELD_FRACTION = 0.06, 0.0012  # to a hand; of the height squared
_GROW_HELD_FRACTION, _MAX_HELD_GROWTH = 0.08, 4  # around a held thing; of its area
_BESIDE_FRACTION = 0.012  # between the body and things beside it
_NO_COLOUR = (255, 0, 255)  # Lab; no person has it


def labels_of(
    rgb: NDArray[np.uint8], mask: Mask, segment: Labels, hand: Mask, head: Mask, bones: F64 | None = None
) -> Labels:
    """Return [H, W] the layer that each pixel shows; NOTHING outside the ``mask`` and on things inside it.

    ``segment`` [H, W] is the fitted body's there, NOTHING beside it; ``hand`` and ``head`` are where it has one.
    ``bones`` [2, 24, 2] are pixels of shoulders, elbows, wrists and 21 landmarks of the hands, left and right; not
    finite where they were not detected.
    """
    rows = np.flatnonzero(mask.any(axis=1))
    height = float(rows[-1] - rows[0] + 1)
    lab = cv2.cvtColor(rgb, cv2.COLOR_RGB2LAB)
    label = np.where(mask, 0, NOTHING).astype(np.intp)
    arms = range(1, LAYER_COUNT)
    found = map_threads(lambda k: _arm(lab, mask, segment, k, height, None if bones is None else bones[k - 1]), arms)
    for layer, arm in zip(arms, found, strict=True):
        label[arm & ((label == 0) | (layer_of(segment) == layer))] = layer
    label[_background(lab, mask, segment, label, head, height)] = NOTHING
    count, pieces, sizes, _ = cv2.connectedComponentsWithStats((label == 0).astype(np.uint8), connectivity=4)
    small = np.flatnonzero(sizes[:, cv2.CC_STAT_AREA] < _MIN_ISLAND_FRACTION * mask.sum())
    label[np.isin(pieces, small[small > 0]) & (count > 2)] = NOTHING
    label[_held_objects(lab, mask, segment, label, hand, height)] = NOTHING
    return label


def _arm(lab: NDArray[np.uint8], mask: Mask, segment: Labels, layer: int, height: float, bones: F64 | None) -> Mask:
    """Return [H, W] where the arm of this layer is visible."""
    parts = [segment == number for number in (2 * layer - 1, 2 * layer)]
    distance = [_distance(part) for part in parts]
    whole = parts[0] | parts[1]
    total = np.zeros(mask.shape, bool)
    for index, part in enumerate(parts):
        if part.sum() < _MIN_PX:
            continue
        near = mask & (distance[index] <= _ARM_REACH_FRACTION * height) & (distance[index] <= distance[1 - index])
        likely = part
        deep = cv2.distanceTransform(part.astype(np.uint8), cv2.DIST_L2, 3)
        core = mask & (deep > min(_CORE_FRACTION * height, _MAX_CORE_FACTOR * float(deep.max())))
        if bones is not None and np.isfinite(bones[:3]).all():
            # landmarks are more precise than the fit's depth
            first, last = bones[index], bones[index + 1]
            start = first if index else first + _UPPER_ARM_START_FACTOR * (last - first)
            bone = _draw_bone(start, last, mask.shape, height)
            fingers = np.zeros_like(bone)
            if index and np.isfinite(bones[3:]).all():
                fingers = _draw_hand(bones[3:], mask.shape, height)
            extended = _draw_bone(first, last + index * _HAND_REACH_FACTOR * (last - first), mask.shape, height)
            bone_distance = _distance((extended | fingers) > 0)
            near |= mask & ((fingers > 0) | ((bone > 0) & (distance[index] <= 2 * _ARM_REACH_FRACTION * height)))
            near &= bone_distance <= _MAX_ARM_FRACTION * height
            likely = part & (bone_distance <= _SURE_ARM_FRACTION * height)
            core = mask & ((bone | fingers) > 0) & near
        visible = lab.copy()
        visible[~mask | (parts[1 - index] & ~near)] = _NO_COLOUR
        around = distance[index] <= 3 * _ARM_REACH_FRACTION * height
        found = _grab_cut(visible, near, likely & near, core & near, around)
        plausible = _AREA_RANGE[0] * part.sum() < found.sum() < _AREA_RANGE[1] * part.sum()
        total |= (found if plausible else part) & mask
    arm = cv2.morphologyEx(total.astype(np.uint8), cv2.MORPH_OPEN, disc(1))
    arm = cv2.morphologyEx(arm, cv2.MORPH_CLOSE, disc(2))
    _, pieces = cv2.connectedComponents(arm)
    return np.asarray((arm > 0) & np.isin(pieces, np.unique(pieces[whole & (arm > 0)])))


def _draw_bone(first: F64, last: F64, shape: tuple[int, ...], height: float) -> NDArray[np.uint8]:
    """Return [H, W] ones along a bone between two pixels [2]."""
    ends = [tuple(int(side) for side in point.clip(-1e4, 1e4)) for point in (first, last)]
    width = max(3, round(_BONE_WIDTH_FRACTION * height))
    return np.asarray(cv2.line(np.zeros(shape, np.uint8), ends[0], ends[1], 1, width))


def _draw_hand(points: F64, shape: tuple[int, ...], height: float) -> NDArray[np.uint8]:
    """Return [H, W] ones on the palm and along the fingers of a hand's landmarks [21, 2]."""
    drawn = np.zeros(shape, np.uint8)
    at = points.clip(-1e4, 1e4).astype(np.int32)
    cv2.fillConvexPoly(drawn, cv2.convexHull(at[[0, 1, 5, 9, 13, 17]]), 1)
    chains = [at[[0, *range(first, first + 4)]] for first in (1, 5, 9, 13, 17)]
    cv2.polylines(drawn, chains, False, 1, max(1, round(_FINGER_WIDTH_FRACTION * height)))
    return drawn


def _grab_cut(visible: NDArray[np.uint8], near: Mask, likely: Mask, sure: Mask, around: Mask) -> Mask:
    """Return the foreground of GrabCut within ``near``, starting from ``likely``; it reads pixels ``around`` only."""
    trimap = np.full(near.shape, cv2.GC_BGD, np.uint8)
    trimap[near], trimap[likely], trimap[sure] = cv2.GC_PR_BGD, cv2.GC_PR_FGD, cv2.GC_FGD
    rows, columns = np.flatnonzero(around.any(axis=1)), np.flatnonzero(around.any(axis=0))
    box = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    found = np.ascontiguousarray(trimap[box])
    kinds = [int(((found == a) | (found == b)).sum()) for a, b in ((0, 2), (1, 3))]
    out = np.zeros(near.shape, bool)
    if sure.sum() < _MIN_PX or min(kinds) < _MIN_PX:
        return out
    cv2.setRNGSeed(0)
    models = np.zeros((1, 65)), np.zeros((1, 65))
    cv2.grabCut(np.ascontiguousarray(visible[box]), found, None, *models, 3, cv2.GC_INIT_WITH_MASK)
    out[box] = (found == cv2.GC_FGD) | (found == cv2.GC_PR_FGD)
    return out & near


def _background(lab: NDArray[np.uint8], mask: Mask, segment: Labels, label: Labels, head: Mask, height: float) -> Mask:
    """Return [H, W] pixels much more like the background nearby than like arm or trunk nearby."""
    layer, colours = layer_of(segment), lab.astype(np.float32)
    inner = cv2.erode(mask.astype(np.uint8), disc(2)) > 0
    outer = cv2.dilate(mask.astype(np.uint8), disc(2)) == 0
    # a fitted hand that the picture lacks may lie on the wall
    own = [((layer == k) & (label == k)).astype(np.uint8) for k in range(LAYER_COUNT)]
    cores = [inner & (cv2.erode(one, disc(3)) > 0) for one in own]
    jobs = [(outer, _ROOM_REACH_FRACTION), (outer, _NEAR_FRACTION), *((core, _NEAR_FRACTION) for core in cores)]
    distances = map_threads(lambda some: _colour_distance(colours, some[0], some[1] * height), jobs)
    room, person = np.minimum(distances[1], distances[0]), np.minimum.reduce(distances[2:])
    shallow = cv2.distanceTransform((layer == 0).astype(np.uint8), cv2.DIST_L2, 3) < _ROOM_DEPTH_FRACTION * height
    strict = np.where(_distance(head) < _ARM_REACH_FRACTION * height, np.float32(_HAIR_FACTOR), np.float32(1))
    found = mask & shallow & (room < _MAX_ROOM_DISTANCE * strict) & (room < _MAX_ROOM_RATIO * strict * person)
    found = cv2.morphologyEx(found.astype(np.uint8), cv2.MORPH_OPEN, disc(1))
    # edges are mixed with the person
    return np.asarray((found > 0) | (mask & (cv2.dilate(found, disc(_ROOM_EDGE_PX)) > 0) & (room < strict * person)))


def _colour_distance(colours: NDArray[np.float32], some: Mask, reach: float) -> NDArray[np.float32]:
    """Return [H, W] squared distance of each colour to ``some`` pixels nearby, in standard deviations."""
    weight = some.astype(np.float32)
    total = _blurred(weight, reach)
    known = np.maximum(total, 1e-5)[..., None]
    mean = _blurred(colours * weight[..., None], reach) / known
    spread = _blurred(colours**2 * weight[..., None], reach) / known - mean**2
    distance = component_sums((colours - mean) ** 2 / (np.maximum(spread, 0) + _MIN_VARIANCE))
    return np.where(total > 2e-3, distance, np.float32(1e6))


def _blurred(values: NDArray[np.float32], sigma: float) -> NDArray[np.float32]:
    """Return ``values`` [H, W] or [H, W, 3] blurred; wide blurs are made of a smaller picture."""
    shrink = max(1, int(sigma / _BLUR_SIGMA_PX))
    height, width = (max(1, side // shrink) for side in values.shape[:2])
    small = cv2.resize(values, (width, height), interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), sigma / shrink)
    return np.asarray(cv2.resize(small, values.shape[1::-1], interpolation=cv2.INTER_LINEAR), np.float32)


def _held_objects(
    lab: NDArray[np.uint8], mask: Mask, segment: Labels, label: Labels, hand: Mask, height: float
) -> Mask:
    """Return [H, W] bags and balls: parts of the mask beside the body near a hand, and body pixels of their colours."""
    out = np.zeros(mask.shape, bool)
    if not hand.any():
        return out
    body = cv2.dilate((segment >= 0).astype(np.uint8), disc(max(2, int(_BESIDE_FRACTION * height)))) > 0
    beside = mask & (label == 0) & ~body
    distance = _distance(hand)
    count, pieces, sizes, _ = cv2.connectedComponentsWithStats(beside.astype(np.uint8))
    for number in range(1, count):
        piece = pieces == number
        small = sizes[number, cv2.CC_STAT_AREA] < _MIN_HELD_FRACTION * height**2
        if small or distance[piece].min() > _HELD_REACH_FRACTION * height:
            continue
        near = (_distance(piece) <= _GROW_HELD_FRACTION * height) & (label == 0)
        visible = lab.copy()
        visible[~mask | (label > 0)] = _NO_COLOUR
        core = cv2.erode(piece.astype(np.uint8), disc(1)) > 0
        held = _grab_cut(visible, near, near & beside, core, _distance(piece) <= 2 * _GROW_HELD_FRACTION * height)
        out |= held if held.sum() < _MAX_HELD_GROWTH * piece.sum() else piece
    return out


def _distance(some: Mask) -> NDArray[np.float32]:
    """Return [H, W] pixels to the nearest of ``some``; 1e9 if there is none."""
    if not some.any():
        return np.full(some.shape, 1e9, np.float32)
    return np.asarray(cv2.distanceTransform((~some).astype(np.uint8), cv2.DIST_L2, 3), np.float32)
