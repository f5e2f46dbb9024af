"""Fill a hole in a picture of cloth with patches of the cloth around it, so that stripes and checks go on.

Each patch across the hole takes the most similar known one, and each pixel the mean of the patches over it, from coarse
to fine, some rounds each (Wexler, Shechtman and Irani 2007). Patches of about the same height are preferred, since hems
and borders run across.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from glsplat.extras.authoring.paint.picture_layers.fill import disc

Mask = NDArray[np.bool_]
Picture = NDArray[np.float32]
F32 = NDArray[np.float32]
Ints = NDArray[np.intp]

_LEVEL_HEIGHTS_PX = (90.0, 180.0, 360.0)  # of the person
_LEVEL_ROUNDS = (6, 4, 3)
_HALF_PX = 3  # of a patch, around its middle
_SOURCE_FRACTION = 0.16  # of the height: patches are taken this near to the hole
_UPRIGHT_WEIGHT, _ASIDE_WEIGHT = 1.6, 0.4  # root mean square of colour per height of distance, along it and across
_COMPONENTS, _DIGITS = 12, 4  # principal components of a patch; last bits differ with the number of threads
# of the height: pixels this near to another layer are filled anew; sources keep this distance
_REFILL_FRACTION, _SOURCE_GAP_FRACTION = 0.006, 0.014
_THIN_FRACTION = 0.01  # of the height
_MAX_PATCHES = 12_000
_MATCH_FACTOR = 0.5  # of the median difference: less similar patches get less weight
_NEIGHBOUR_FACTOR = 1.05  # of its difference, for a patch beside a neighbour's
_NEIGHBOUR_PASSES = 2
_MIN_PATCHES = 200


def continue_cloth(picture: Picture, known: Mask, body: Mask, label: Ints, layer: int) -> Picture:
    """Return ``picture`` [H, W, 3] of a person's layer with its cloth continued where other things occlude it.

    The picture shows ``known`` pixels of the layer; the fitted body covers ``body``. ``label`` [H, W] is the layer of
    each pixel, negative for none.
    """
    rows = np.flatnonzero((label >= 0).any(axis=1))
    if not len(rows):
        return picture
    height = float(rows[-1] - rows[0] + 1)
    shares = _REFILL_FRACTION, _SOURCE_GAP_FRACTION, _THIN_FRACTION
    near, far, thin = (disc(max(1, round(share * height))) for share in shares)
    # foreign pixels are thin along outlines; thick ones are things
    things = cv2.morphologyEx(((label < 0) & body).astype(np.uint8), cv2.MORPH_OPEN, thin)
    before = ((label >= 0) & (label != layer)).astype(np.uint8) | things
    if layer:  # an arm may lie beside its projection
        before |= cv2.morphologyEx((body & (label != layer)).astype(np.uint8), cv2.MORPH_OPEN, near)
    beside, apart = cv2.dilate(before, near) > 0, cv2.dilate(before, far) > 0
    return fill_with_patches(picture, known & ~apart, body & beside, height)


def fill_with_patches(picture: Picture, known: Mask, hole: Mask, height: float) -> Picture:
    """Return ``picture`` [H, W, 3], linear, with its ``hole`` filled from ``known``, starting from its pixels there.

    ``height`` is the person's in pixels. Without enough known pixels the picture is returned unchanged.
    """
    rows, columns = np.flatnonzero(hole.any(axis=1)), np.flatnonzero(hole.any(axis=0))
    if not len(rows):
        return picture
    margin = int(_SOURCE_FRACTION * height)
    box = tuple(slice(max(used[0] - margin, 0), used[-1] + 1 + margin) for used in (rows, columns))
    visible, weights, wanted = np.sqrt(picture[box].clip(0, 1)), known[box] & ~hole[box], hole[box]
    filled, source = visible, None
    for level, rounds in zip(_LEVEL_HEIGHTS_PX, _LEVEL_ROUNDS, strict=True):
        scale = min(level / height, 1.0)
        size = max(8, round(visible.shape[1] * scale)), max(8, round(visible.shape[0] * scale))
        small = cv2.resize(filled, size, interpolation=cv2.INTER_AREA)
        some = cv2.resize(weights.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.99
        open_ = cv2.resize(wanted.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.01
        found = _fill_level(small, some & ~open_, open_, rounds, level)
        if found is None:
            continue
        small, source = found
        grown = cv2.resize(small, visible.shape[1::-1], interpolation=cv2.INTER_LINEAR)
        filled = np.where(wanted[..., None], grown, visible)
        if scale == 1.0:
            break
    if source is None:
        return picture
    out = picture.copy()
    inside = out[box]
    inside[wanted] = _with_detail(visible, weights, wanted, filled, source) ** 2
    return out


def _fill_level(small: Picture, known: Mask, hole: Mask, rounds: int, height: float) -> tuple[Picture, Ints] | None:
    """Return the hole of one level filled, and [h, w, 2] the source row and column of its pixels, -1 elsewhere."""
    side = 2 * _HALF_PX + 1
    square = np.ones((side, side), np.uint8)
    whole = cv2.erode(known.astype(np.uint8), square, borderValue=0) > 0
    inner = np.s_[_HALF_PX:-_HALF_PX, _HALF_PX:-_HALF_PX]
    whole[:_HALF_PX], whole[-_HALF_PX:], whole[:, :_HALF_PX], whole[:, -_HALF_PX:] = False, False, False, False
    at = np.argwhere(whole)
    if len(at) < _MIN_PATCHES or not hole.any():
        return None
    at = at[:: -(-len(at) // _MAX_PATCHES)]
    touched = np.argwhere(cv2.dilate(hole.astype(np.uint8), square) > 0)
    padded = np.pad(small, ((_HALF_PX, _HALF_PX), (_HALF_PX, _HALF_PX), (0, 0)), mode="edge")
    offsets = np.argwhere(np.ones((side, side), bool))
    patches = _patches(padded, at, offsets).astype(np.float64)
    mean = patches.mean(axis=0)
    basis = np.linalg.eigh(np.cov((patches - mean).T))[1][:, : -_COMPONENTS - 1 : -1]
    place = np.array([_UPRIGHT_WEIGHT, _ASIDE_WEIGHT]) / height * side
    tree = cKDTree(np.hstack([np.round((patches - mean) @ basis, _DIGITS), at * place]))
    out, source, framed = small.copy(), np.full((*hole.shape, 2), -1, np.intp), padded.copy()
    for _ in range(rounds):
        padded[inner] = out
        wanted = _patches(padded, touched, offsets)
        _, nearest = tree.query(np.hstack([np.round((wanted - mean) @ basis, _DIGITS), touched * place]), workers=-1)
        source[touched[:, 0], touched[:, 1]] = at[nearest]
        difference = _align_with_neighbours(source, wanted, touched, whole, framed, offsets)
        usual = max(float(np.median(difference)) * _MATCH_FACTOR, 1e-4)
        sources = source[touched[:, 0], touched[:, 1]]
        weight = np.exp(-0.5 * (np.minimum(difference / usual, 8.0)) ** 2).astype(np.float32) + np.float32(1e-6)
        total, weights = np.zeros_like(padded), np.zeros(padded.shape[:2], np.float32)
        for row, column in offsets:
            # one offset reaches each pixel once, so no index repeats here
            there = touched[:, 0] + row, touched[:, 1] + column
            from_ = sources + (row - _HALF_PX, column - _HALF_PX)
            total[there] += weight[:, None] * small[from_[:, 0], from_[:, 1]]
            weights[there] += weight
        total, weights = total[inner], weights[inner]
        out[hole] = total[hole] / np.maximum(weights[hole], 1e-9)[:, None]
    return out, source


def _align_with_neighbours(
    source: Ints, wanted: F32, touched: Ints, whole: Mask, framed: Picture, offsets: Ints
) -> F32:
    """Return [K] differences between ``wanted`` [K, S] and the patches of ``source`` [h, w, 2] at ``touched``.

    First, a pixel takes the patch beside its neighbour's where that is hardly worse, so that few seams remain.
    """
    own = source[touched[:, 0], touched[:, 1]]
    difference = np.linalg.norm(_patches(framed, own, offsets) - wanted, axis=1)
    for step in ((-1, 0), (0, -1), (1, 0), (0, 1)) * _NEIGHBOUR_PASSES:
        beside = touched + step
        inside = ((beside >= 0) & (beside < whole.shape)).all(axis=1)
        other = source[beside[:, 0].clip(0, whole.shape[0] - 1), beside[:, 1].clip(0, whole.shape[1] - 1)] - step
        inside &= ((other >= 0) & (other < whole.shape)).all(axis=1)
        other = other.clip(0, np.array(whole.shape) - 1)
        inside &= whole[other[:, 0], other[:, 1]]
        unlike = np.linalg.norm(_patches(framed, other, offsets) - wanted, axis=1)
        better = inside & (unlike <= _NEIGHBOUR_FACTOR * difference)
        own, difference = np.where(better[:, None], other, own), np.where(better, unlike, difference)
        source[touched[:, 0], touched[:, 1]] = own
    return np.asarray(difference, np.float32)


def _patches(padded: Picture, at: Ints, offsets: Ints) -> F32:
    """Return [K, S] the flattened patches around pixels [K, 2]."""
    return np.asarray(padded[at[:, None, 0] + offsets[:, 0], at[:, None, 1] + offsets[:, 1]].reshape(len(at), -1))


def _with_detail(visible: Picture, known: Mask, wanted: Mask, filled: Picture, source: Ints) -> Picture:
    """Return [K, 3] the ``wanted`` pixels: ``filled``, with the fine detail of each source pixel."""
    rows, columns = np.nonzero(wanted)
    down, right = np.array(source.shape[:2]) / np.array(visible.shape[:2])
    own = np.stack([(rows * down).astype(np.intp), (columns * right).astype(np.intp)], axis=1)
    shift = np.round((source[own[:, 0], own[:, 1]] - own) / (down, right)).astype(np.intp)
    there = np.stack([rows, columns], axis=1) + shift
    there = there.clip(0, np.array(visible.shape[:2]) - 1)
    blurred = cv2.resize(cv2.resize(visible, source.shape[1::-1], interpolation=cv2.INTER_AREA), visible.shape[1::-1])
    detail = visible[there[:, 0], there[:, 1]] - blurred[there[:, 0], there[:, 1]]
    detail[~known[there[:, 0], there[:, 1]] | (source[own[:, 0], own[:, 1], 0] < 0)] = 0
    # details do not match where neighbours have other sources
    at = source - np.indices(source.shape[:2]).transpose(1, 2, 0)
    torn = sum((np.abs(at - np.roll(at, 1, axis)).max(axis=2) > 0).astype(np.float32) for axis in (0, 1))
    whole = 1 - np.minimum(cv2.blur(np.asarray(torn, np.float32), (3, 3)), 1)
    return np.asarray((filled[wanted] + whole[own[:, 0], own[:, 1], None] * detail).clip(0, 1))
