"""Skin: which joints move a splat and by how much."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glsplat.errors import FormatError

__all__ = ["INFLUENCES", "Skin"]

INFLUENCES = (1, 2, 4, 8)
"""Joints a splat that have a shader variant."""


@dataclass(frozen=True, slots=True, eq=False)
class Skin:
    """N splats times K influences, strongest first, weights that sum to exactly one (float32 rounding apart)."""

    joints: NDArray[np.uint16]  # [N, K], K in INFLUENCES
    weights: NDArray[np.float32]  # [N, K] >= 0
    lost: float = 0.0  # mean weight cut off when the influences were reduced to K
    repaired: int = 0  # splats whose weights were negative, not finite or all zero

    @classmethod
    def create(cls, joints: ArrayLike, weights: ArrayLike, joint_count: int, influences: int = 4) -> Skin:
        """Sanitise, keep the ``influences`` strongest joints of each splat and renormalise.

        ``joints`` and ``weights`` are [N, M] for any M. Negative and non-finite weights count as zero; a splat with
        no weight left rides joint ``joints[i, 0]``; both are counted in ``repaired``. A joint outside
        0..joint_count-1 with a weight above zero is a FormatError: it cannot be guessed.
        """
        ids = np.asarray(joints)
        w = np.asarray(weights, np.float64)
        if ids.ndim != 2 or ids.shape != w.shape or ids.shape[1] < 1:
            raise FormatError(f"joints and weights need one shape (N, K), not {ids.shape} and {w.shape}")
        if influences not in INFLUENCES:
            raise FormatError(f"influences needs one of {INFLUENCES}, not {influences}")
        bad = ~np.isfinite(w) | (w < 0)
        w = np.where(bad, 0.0, w)
        outside = ((ids < 0) | (ids >= joint_count)) & (w > 0)
        if outside.any():
            row = int(np.flatnonzero(outside.any(axis=1))[0])
            raise FormatError(f"splat {row} is bound to joint {ids[row].max()}, but the skeleton has {joint_count}")
        ids = np.clip(ids, 0, joint_count - 1)
        total = w.sum(axis=1)
        empty = total <= 0
        w[empty, 0] = 1.0
        repaired = int((bad.any(axis=1) | empty).sum())
        w /= np.where(empty, 1.0, total)[:, None]

        order = np.argsort(-w, axis=1, kind="stable")[:, :influences]
        kept = np.take_along_axis(w, order, axis=1)
        kept_ids = np.take_along_axis(ids, order, axis=1)
        lost = float(1 - kept.sum(axis=1).mean()) if len(kept) else 0.0
        if kept.shape[1] < influences:
            pad = ((0, 0), (0, influences - kept.shape[1]))
            kept, kept_ids = np.pad(kept, pad), np.pad(kept_ids, pad)
        kept /= kept.sum(axis=1, keepdims=True)
        kept_ids = np.where(kept > 0, kept_ids, kept_ids[:, :1])  # unused slots fetch a bone that is fetched anyway
        return cls(kept_ids.astype(np.uint16), kept.astype(np.float32), max(lost, 0.0), repaired)

    def __len__(self) -> int:
        return len(self.joints)

    @property
    def influences(self) -> int:
        """Joints a splat, K."""
        return self.joints.shape[1]

    def reduced(self, influences: int) -> Skin:
        """The same skin with at most ``influences`` joints a splat."""
        if influences >= self.influences:
            return self
        return Skin.create(self.joints, self.weights, int(self.joints.max(initial=0)) + 1, influences)

    def dense(self, joint_count: int) -> NDArray[np.float64]:
        """[N, J] weights, for comparisons."""
        out = np.zeros((len(self), joint_count))
        np.add.at(out, (np.arange(len(self))[:, None], self.joints), self.weights)
        return out
