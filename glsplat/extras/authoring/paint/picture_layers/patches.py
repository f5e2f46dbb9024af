"""A hole in a picture of cloth filled by pieces of the cloth around it, so that stripes and checks go on.

Each piece across the hole becomes the most alike one that is known, and each pixel what the pieces over it say, from
coarse to fine, some rounds each (Wexler, Shechtman and Irani 2007). Pieces of about the same height are preferred,
since hems and borders run across.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from glsplat.extras.authoring.paint.picture_layers.fill import disc

__all__ = ["patched", "woven"]

Mask = NDArray[np.bool_]
Picture = NDArray[np.float32]
F32 = NDArray[np.float32]
Ints = NDArray[np.intp]

_LEVELS = (90.0, 180.0, 360.0)  # pixels of the person's height
_ROUNDS = (6, 4, 3)
_HALF = 3  # pixels of a piece around its middle
_AROUND = 0.16  # of the height: so far from the hole pieces are taken
_UPRIGHT, _ASIDE = 1.6, 0.4  # root mean square of colour that a height of distance counts as, along it and across
_KEPT, _DIGITS = 12, 4  # principal components of a piece, which differ in their last bits with the number of threads
_NEAR, _FAR = 0.006, 0.014  # of the height: so near to another layer one is guessed anew; cloth is looked for no nearer
_THIN = 0.01  # of it
_MOST = 12_000  # pieces that are compared
_SHARP = 0.5  # of the usual difference: pieces that are less alike say less
_LIKED = 1.05  # so much more unlike a piece may be that lies beside a neighbour's
_PASSES = 2
_FEWEST = 200


def woven(picture: Picture, known: Mask, there: Mask, label: Ints, layer: int) -> Picture:
    """``picture`` [H, W, 3] of one layer of a person with its cloth carried on where something else is in its way.

    Of the layer the picture shows what is ``known``, the fitted body what is ``there``; ``label`` [H, W] is the layer
    that each pixel shows, below zero none.
    """
    rows = np.flatnonzero((label >= 0).any(axis=1))
    if not len(rows):
        return picture
    height = float(rows[-1] - rows[0] + 1)
    near, far, thin = (disc(max(1, round(share * height))) for share in (_NEAR, _FAR, _THIN))
    # what is not the body's is thin along outlines, and is a thing where it is not
    things = cv2.morphologyEx(((label < 0) & there).astype(np.uint8), cv2.MORPH_OPEN, thin)
    before = ((label >= 0) & (label != layer)).astype(np.uint8) | things
    if layer:  # an arm is looked for beside its projection, and may not be where that is
        before |= cv2.morphologyEx((there & (label != layer)).astype(np.uint8), cv2.MORPH_OPEN, near)
    beside, apart = cv2.dilate(before, near) > 0, cv2.dilate(before, far) > 0
    return patched(picture, known & ~apart, there & beside, height)


def patched(picture: Picture, known: Mask, hole: Mask, height: float) -> Picture:
    """``picture`` [H, W, 3], linear, with its ``hole`` filled from what is ``known``; begun from what is there.

    ``height`` is the person's in pixels. The picture comes back as it is where too little is known.
    """
    rows, columns = np.flatnonzero(hole.any(axis=1)), np.flatnonzero(hole.any(axis=0))
    if not len(rows):
        return picture
    margin = int(_AROUND * height)
    box = (
        slice(max(rows[0] - margin, 0), rows[-1] + 1 + margin),
        slice(max(columns[0] - margin, 0), columns[-1] + 1 + margin),
    )
    seen, sure, wanted = np.sqrt(picture[box].clip(0, 1)), known[box] & ~hole[box], hole[box]
    filled, source = seen, None
    for level, rounds in zip(_LEVELS, _ROUNDS, strict=True):
        scale = min(level / height, 1.0)
        size = max(8, round(seen.shape[1] * scale)), max(8, round(seen.shape[0] * scale))
        small = cv2.resize(filled, size, interpolation=cv2.INTER_AREA)
        some = cv2.resize(sure.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.99
        open_ = cv2.resize(wanted.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.01
        found = _filled(small, some & ~open_, open_, rounds, level)
        if found is None:
            continue
        small, source = found
        grown = cv2.resize(small, seen.shape[1::-1], interpolation=cv2.INTER_LINEAR)
        filled = np.where(wanted[..., None], grown, seen)
        if scale == 1.0:
            break
    if source is None:
        return picture
    out = picture.copy()
    inside = out[box]
    inside[wanted] = _copied(seen, sure, wanted, filled, source) ** 2
    return out


def _filled(small: Picture, known: Mask, hole: Mask, rounds: int, height: float) -> tuple[Picture, Ints] | None:
    """The hole of one level filled, and [h, w, 2] row and column that each of its pixels is from, -1 elsewhere."""
    side = 2 * _HALF + 1
    square = np.ones((side, side), np.uint8)
    whole = cv2.erode(known.astype(np.uint8), square, borderValue=0) > 0
    whole[:_HALF], whole[-_HALF:], whole[:, :_HALF], whole[:, -_HALF:] = False, False, False, False
    rows, columns = np.nonzero(whole)
    if len(rows) < _FEWEST or not hole.any():
        return None
    step = -(-len(rows) // _MOST)
    rows, columns = rows[::step], columns[::step]
    at = np.stack([rows, columns], axis=1)
    touched = np.argwhere(cv2.dilate(hole.astype(np.uint8), square) > 0)
    padded = np.pad(small, ((_HALF, _HALF), (_HALF, _HALF), (0, 0)), mode="edge")
    offsets = np.argwhere(np.ones((side, side), bool))
    pieces = _pieces(padded, at, offsets).astype(np.float64)
    mean = pieces.mean(axis=0)
    basis = np.linalg.eigh(np.cov((pieces - mean).T))[1][:, : -_KEPT - 1 : -1]
    place = np.array([_UPRIGHT, _ASIDE]) / height * side
    tree = cKDTree(np.hstack([np.round((pieces - mean) @ basis, _DIGITS), at * place]))
    out, source, framed = small.copy(), np.full((*hole.shape, 2), -1, np.intp), padded.copy()
    for _ in range(rounds):
        padded[_HALF:-_HALF, _HALF:-_HALF] = out
        wanted = _pieces(padded, touched, offsets)
        _, nearest = tree.query(np.hstack([np.round((wanted - mean) @ basis, _DIGITS), touched * place]))
        source[touched[:, 0], touched[:, 1]] = at[nearest]
        away = _joined(source, wanted, touched, whole, framed, offsets)
        usual = max(float(np.median(away)) * _SHARP, 1e-4)
        taken = source[touched[:, 0], touched[:, 1]]
        weight = np.exp(-0.5 * (np.minimum(away / usual, 8.0)) ** 2).astype(np.float32) + np.float32(1e-6)
        total, sure = np.zeros_like(padded), np.zeros(padded.shape[:2], np.float32)
        for row, column in offsets:
            # each piece lies over its surroundings once, so no two of them add to one pixel here
            there = touched[:, 0] + row, touched[:, 1] + column
            from_ = taken + (row - _HALF, column - _HALF)
            total[there] += weight[:, None] * small[from_[:, 0], from_[:, 1]]
            sure[there] += weight
        total, sure = total[_HALF:-_HALF, _HALF:-_HALF], sure[_HALF:-_HALF, _HALF:-_HALF]
        out[hole] = total[hole] / np.maximum(sure[hole], 1e-9)[:, None]
    return out, source


def _joined(source: Ints, wanted: F32, touched: Ints, whole: Mask, framed: Picture, offsets: Ints) -> F32:
    """[K] how unlike what is ``wanted`` [K, S] the pieces are that ``source`` [h, w, 2] has for pixels ``touched``.

    Before, whoever is hardly worse off with what lies beside a neighbour's piece takes that, so that few seams remain.
    """
    own = source[touched[:, 0], touched[:, 1]]
    away = np.linalg.norm(_pieces(framed, own, offsets) - wanted, axis=1)
    for step in ((-1, 0), (0, -1), (1, 0), (0, 1)) * _PASSES:
        beside = touched + step
        inside = ((beside >= 0) & (beside < whole.shape)).all(axis=1)
        other = source[beside[:, 0].clip(0, whole.shape[0] - 1), beside[:, 1].clip(0, whole.shape[1] - 1)] - step
        inside &= ((other >= 0) & (other < whole.shape)).all(axis=1)
        other = other.clip(0, np.array(whole.shape) - 1)
        inside &= whole[other[:, 0], other[:, 1]]
        unlike = np.linalg.norm(_pieces(framed, other, offsets) - wanted, axis=1)
        better = inside & (unlike <= _LIKED * away)
        own, away = np.where(better[:, None], other, own), np.where(better, unlike, away)
        source[touched[:, 0], touched[:, 1]] = own
    return np.asarray(away, np.float32)


def _pieces(padded: Picture, at: Ints, offsets: Ints) -> F32:
    """[K, S] the pieces around pixels [K, 2], one after another."""
    return np.asarray(padded[at[:, None, 0] + offsets[:, 0], at[:, None, 1] + offsets[:, 1]].reshape(len(at), -1))


def _copied(seen: Picture, known: Mask, wanted: Mask, filled: Picture, source: Ints) -> Picture:
    """[K, 3] of the ``wanted`` pixels: what was ``filled``, with the fine detail of where each is from."""
    rows, columns = np.nonzero(wanted)
    down, right = np.array(source.shape[:2]) / np.array(seen.shape[:2])
    own = np.stack([(rows * down).astype(np.intp), (columns * right).astype(np.intp)], axis=1)
    shift = np.round((source[own[:, 0], own[:, 1]] - own) / (down, right)).astype(np.intp)
    there = np.stack([rows, columns], axis=1) + shift
    there = there.clip(0, np.array(seen.shape[:2]) - 1)
    blurred = cv2.resize(cv2.resize(seen, source.shape[1::-1], interpolation=cv2.INTER_AREA), seen.shape[1::-1])
    detail = seen[there[:, 0], there[:, 1]] - blurred[there[:, 0], there[:, 1]]
    detail[~known[there[:, 0], there[:, 1]] | (source[own[:, 0], own[:, 1], 0] < 0)] = 0
    # where neighbours are from elsewhere, their details do not fit each other
    at = source - np.indices(source.shape[:2]).transpose(1, 2, 0)
    torn = sum((np.abs(at - np.roll(at, 1, axis)).max(axis=2) > 0).astype(np.float32) for axis in (0, 1))
    whole = 1 - np.minimum(cv2.blur(np.asarray(torn, np.float32), (3, 3)), 1)
    return np.asarray((filled[wanted] + whole[own[:, 0], own[:, 1], None] * detail).clip(0, 1))
