"""Paint a dressed body that many pictures show from all around: each place from the pictures that see it best.

The mean of thirty pictures of a fit that is right to a few millimetres is blurred. So each vertex takes one or two
pictures: those that see it squarest, smoothed over the surface so that seams are few and run through wide bands.
Surface seen squarely always turns to the camera, so all places are seen in about the same light, although the lamp
stands still while the person turns.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.body.open_body import Body
from glsplat.extras.authoring.fit.offsets import face_vertices
from glsplat.extras.authoring.geometry.surface_points import SurfacePoints
from glsplat.extras.authoring.geometry.visibility import EYES
from glsplat.extras.authoring.networks.face import EyeLook
from glsplat.extras.authoring.paint.head import vertices_of
from glsplat.extras.authoring.paint.mouth_and_eyes import EyesAndMouth, eyes_and_mouth_of
from glsplat.extras.authoring.paint.painter import COLOUR_DIGITS, Paint
from glsplat.extras.authoring.paint.smooth import fill_smoothly
from glsplat.extras.authoring.paint.view_sample import FittedPicture
from glsplat.pictures import to_srgb

F64 = NDArray[np.float64]

_SMOOTHING_ROUNDS = 12  # of averaging scores with the neighbours'
_SCORE_SCALE = 0.02  # a score lower by this has its weight divided by e
_MIN_WEIGHT = 0.02  # of a picture in a vertex's colour
_FRONT_FACE_BONUS = 0.6  # added to the score of a face in the front picture


@dataclass(frozen=True, eq=False)
class Fusion:
    """Colours of any points of the body; ``fusion_of`` makes one."""

    body: Body
    shots: Sequence[FittedPicture]  # the front first
    inside: EyesAndMouth
    shares: F64  # [V, N] weight of each picture in a vertex's colour; the rows sum to ``visibility``
    visibility: F64  # [V] from 0, seen in no picture, to 1
    filled: F64  # [V, 3] linear colours, smooth where no picture looks

    def paint(self, points: SurfacePoints) -> Paint:
        """Return the known and guessed colours of the points."""
        count = len(points.corners)
        share = points.at(self.shares)
        total, linear, detail = np.zeros(count), np.zeros((count, 3)), np.zeros(count)
        for index, shot in enumerate(self.shots):
            mine = np.flatnonzero(share[:, index] > _MIN_WEIGHT)
            if not len(mine):
                continue
            some = points.take(mine)
            pixels = shot.project(some.at(shot.view.vertices))
            weight = share[mine, index]
            total[mine] += weight
            linear[mine] += weight[:, None] * shot.sample(pixels)
            detail[mine] += weight * shot.detail(pixels)
        visibility = points.at(self.visibility[:, None])[:, 0]
        known = np.maximum(total, 1e-9)
        guess = points.at(self.filled)
        rgb = to_srgb(guess + (visibility * (total > 0))[:, None] * (linear / known[:, None] - guess))
        rgb = self.inside.over(rgb, points)
        return Paint(np.round(rgb, COLOUR_DIGITS), visibility, np.round(detail / known, COLOUR_DIGITS), np.zeros(count))

    def colours(self, points: SurfacePoints) -> F64:
        """Return [M, 3] ``paint(points).rgb``."""
        return self.paint(points).rgb


def fusion_of(
    body: Body,
    shots: Sequence[FittedPicture],
    looks: Mapping[str, EyeLook] | None = None,
    penalties: Sequence[float] = (),
) -> Fusion:
    """Return the fusion of ``shots``, the front first; ``penalties`` are subtracted from each shot's score.

    A score is the cosine between the surface's normal and the line of sight.
    """
    near = body.neighbours
    degree = np.maximum(np.asarray(near.sum(axis=1)).ravel(), 1)
    outside = body.skin | vertices_of(body, *EYES)
    visible = np.stack([shot.visibility for shot in shots], axis=1) * outside[:, None]  # [V, N]
    squareness = np.stack([shot.squareness for shot in shots], axis=1)
    # neighbours of hidden vertices are nearly hidden
    hidden = near @ (visible <= 0).astype(float) / degree[:, None]
    clear = visible * (1 - hidden)
    score = squareness.clip(0, 1) * (clear > 0)
    if len(penalties):
        score = score - np.asarray(penalties, float)
    score[face_vertices(body), 0] += _FRONT_FACE_BONUS
    for _ in range(_SMOOTHING_ROUNDS):
        score = 0.5 * score + 0.5 * (near @ score) / degree[:, None]
    best = np.where(clear > 0, score, -np.inf).max(axis=1, keepdims=True)
    weight = np.where(clear > 0, np.exp((score - np.where(np.isfinite(best), best, 0)) / _SCORE_SCALE), 0.0) * clear
    visibility = np.max(clear, axis=1)
    total = weight.sum(axis=1)
    shares = weight * (visibility / np.maximum(total, 1e-12))[:, None]
    inside, filled = eyes_and_mouth_of(body, shots[0], looks or {}), _fill_unseen(body, shots, shares, visibility)
    return Fusion(body, shots, inside, shares, visibility, filled)


def _fill_unseen(body: Body, shots: Sequence[FittedPicture], shares: F64, visibility: F64) -> F64:
    """Return [V, 3] linear colours as seen at the vertices, smooth between."""
    target = np.zeros((len(visibility), 3))
    for index, shot in enumerate(shots):
        mine = np.flatnonzero(shares[:, index] > _MIN_WEIGHT)
        if not len(mine):
            continue
        target[mine] += shares[mine, index, None] * shot.sample(shot.view.pixels[mine])
    return fill_smoothly(body, visibility, target)
