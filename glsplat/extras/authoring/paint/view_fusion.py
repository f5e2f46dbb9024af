"""The colours of a dressed body that many pictures show from all around: each place from the picture that sees it best.

The mean of thirty pictures of a fit that is right to a few millimetres is a blur. So every vertex gets a picture or
two: those that see it squarest, evened out over the surface so that seams are few and run through wide bands. And since
what is seen squarely always turns to the camera, all places are seen in about the same light, though the lamp stands
still while the person turns.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.body.open_body import Body
from glsplat.extras.authoring.fit.eyes import EyeLook
from glsplat.extras.authoring.fit.offsets import face_vertices
from glsplat.extras.authoring.geometry.surface_points import SurfacePoints
from glsplat.extras.authoring.paint.mouth_and_eyes import Inside, inside_of
from glsplat.extras.authoring.paint.painter import Paint
from glsplat.extras.authoring.paint.smooth import smoothest
from glsplat.extras.authoring.paint.view_sample import FittedPicture
from glsplat.pictures import to_srgb
from glsplat.skinning.smplx import JOINT_NAMES

__all__ = ["Fusion", "fusion_of"]

F64 = NDArray[np.float64]

_EVENED = 12  # times that scores are averaged with the neighbours'
_SOFT = 0.02  # of the score: what is worse by this much counts a third
_FEW = 0.02  # of the weight; less is left out
_FACE_FIRST = 0.6  # that a face's score is better in the front than elsewhere
_DIGITS = 6


@dataclass(frozen=True, eq=False)
class Fusion:
    """Gives the colours of any points of the body; ``fusion_of`` makes one."""

    body: Body
    shots: Sequence[FittedPicture]  # the front first
    inside: Inside
    shares: F64  # [V, N] of each picture in a vertex's colour; the rows sum to ``seen``
    seen: F64  # [V] from 0, nobody looks, to 1
    filled: F64  # [V, 3] linear colours, smooth, where nobody looks

    def paint(self, points: SurfacePoints) -> Paint:
        """What is known and guessed of the points."""
        count = len(points.corners)
        share = points.at(self.shares)
        total, linear, busy = np.zeros(count), np.zeros((count, 3)), np.zeros(count)
        for index, shot in enumerate(self.shots):
            mine = np.flatnonzero(share[:, index] > _FEW)
            if not len(mine):
                continue
            some = points.take(mine)
            pixels = shot.project(some.at(shot.view.vertices))
            weight = share[mine, index]
            total[mine] += weight
            linear[mine] += weight[:, None] * shot.sample(pixels)
            busy[mine] += weight * shot.detail(pixels)
        seen = points.at(self.seen[:, None])[:, 0]
        known = np.maximum(total, 1e-9)
        guess = points.at(self.filled)
        rgb = to_srgb(guess + (seen * (total > 0))[:, None] * (linear / known[:, None] - guess))
        rgb = self.inside.over(rgb, points)
        return Paint(np.round(rgb, _DIGITS), seen, np.round(busy / known, _DIGITS))

    def colours(self, points: SurfacePoints) -> F64:
        """[M, 3] ``paint(points).rgb``."""
        return self.paint(points).rgb


def fusion_of(
    body: Body, shots: Sequence[FittedPicture], looks: Mapping[str, EyeLook] | None = None, doubts: Sequence[float] = ()
) -> Fusion:
    """Which of the ``shots``, the front first, shows what best; ``doubts`` are what each one's score is worse by.

    A score is the cosine between the surface and the line of sight.
    """
    near = body.neighbours
    degree = np.maximum(np.asarray(near.sum(axis=1)).ravel(), 1)
    trust = np.stack([shot.trust for shot in shots], axis=1) * (body.skin | _eyes(body))[:, None]  # [V, N]
    square = np.stack([shot.squareness for shot in shots], axis=1)
    # what touches something hidden is nearly hidden
    hidden = near @ (trust <= 0).astype(float) / degree[:, None]
    clear = trust * (1 - hidden)
    score = square.clip(0, 1) * (clear > 0)
    if len(doubts):
        score = score - np.asarray(doubts, float)
    score[face_vertices(body), 0] += _FACE_FIRST
    for _ in range(_EVENED):
        score = 0.5 * score + 0.5 * (near @ score) / degree[:, None]
    best = np.where(clear > 0, score, -np.inf).max(axis=1, keepdims=True)
    weight = np.where(clear > 0, np.exp((score - np.where(np.isfinite(best), best, 0)) / _SOFT), 0.0) * clear
    seen = np.max(clear, axis=1)
    total = weight.sum(axis=1)
    shares = weight * (seen / np.maximum(total, 1e-12))[:, None]
    return Fusion(body, shots, inside_of(body, shots[0], looks or {}), shares, seen, _filled(body, shots, shares, seen))


def _filled(body: Body, shots: Sequence[FittedPicture], shares: F64, seen: F64) -> F64:
    """[V, 3] linear colours as seen at the vertices, the smoothest between."""
    target = np.zeros((len(seen), 3))
    for index, shot in enumerate(shots):
        mine = np.flatnonzero(shares[:, index] > _FEW)
        if not len(mine):
            continue
        target[mine] += shares[mine, index, None] * shot.sample(shot.view.pixels[mine])
    return smoothest(body, seen, target)


def _eyes(body: Body) -> NDArray[np.bool_]:
    return np.isin(body.part, [JOINT_NAMES.index(f"{side}_eye_smplhf") for side in ("left", "right")])
