"""Skin: the joints that move each splat, and their weights."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, SupportsFloat, SupportsIndex, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glsplat.arrays import Value, count, frozen, number, own, own_whole, plain, rows
from glsplat.errors import FormatError

IntT = TypeVar("IntT", bound=np.integer[Any])

INFLUENCES = (1, 2, 4, 8)
"""Joints a splat that have a shader variant."""


@dataclass(frozen=True, slots=True, eq=False, init=False, repr=False)
class Skin(Value):
    """N splats times K influences, strongest first, weights that sum to exactly one (float32 rounding apart).

    In an Avatar the first slot holds the splat's anchor instead (``anchored``); the two differ in a few per cent.

    Takes any integer joints and any weights that are finite, not negative and not all zero for a splat; weights of
    another sum are divided by it, and 3 or 5 to 7 influences get slots without weight up to 4 or 8. The arrays are
    read-only copies. Raises FormatError; ``Skin.create`` repairs and reduces instead.

    >>> skin = glsplat.Skin([[0, 1, 2]], [[2, 1, 1]])
    >>> skin.weights.tolist()
    [[0.5, 0.25, 0.25, 0.0]]
    """

    joints: NDArray[np.uint16]  # [N, K], K in INFLUENCES
    weights: NDArray[np.float32]  # [N, K] >= 0
    lost: float = 0.0  # mean weight cut off when the influences were reduced to K
    repaired: int = 0  # splats whose weights were negative, not finite or all zero

    def __init__(
        self,
        joints: ArrayLike,  # [N, K] of whole numbers, K 1 to 8
        weights: ArrayLike,  # [N, K]
        lost: SupportsFloat = 0.0,
        repaired: SupportsIndex = 0,
    ) -> None:
        ids, w = own_whole(joints, np.uint16, "joints"), own(weights, np.float32, "weights")
        if ids.ndim != 2 or ids.shape != w.shape or ids.shape[1] < 1:
            raise FormatError(f"joints and weights need one shape (N, K), not {ids.shape} and {w.shape}")
        slots = next((k for k in INFLUENCES if k >= ids.shape[1]), None)
        if slots is None:
            raise FormatError(
                f"a skin has at most {INFLUENCES[-1]} joints a splat, not {ids.shape[1]}; "
                "Skin.create(joints, weights, joint_count, influences=8) keeps the strongest"
            )
        low, high = float(w.min(initial=0)), float(w.max(initial=0))  # NaN if there is one
        if not (low >= 0 and high < np.inf):
            raise FormatError(
                f"weights need finite numbers of 0 and above, found {high if low >= 0 else low:g}; "
                "Skin.create(joints, weights, joint_count) repairs them"
            )
        total = w.sum(axis=1, dtype=np.float64)
        if len(w) and not total.min() > 0:
            row = int(total.argmin())
            raise FormatError(f"splat {row} has no weight; Skin.create(joints, weights, joint_count) repairs it")
        if len(w) and np.abs(total - 1).max() > 8 * 2**-24:
            w = frozen((w / total[:, None]).astype(np.float32))
        if slots > ids.shape[1]:
            pad = ((0, 0), (0, slots - ids.shape[1]))
            ids, w = frozen(np.pad(ids, pad)), frozen(np.pad(w, pad))
        if not w.all():
            strongest = strongest_joint(ids, w)[
                :, None
            ]  # for slots without weight: its bone is fetched anyway, and exists
            stray = (w == 0) & (ids != strongest)
            ids = frozen(np.where(stray, strongest, ids)) if stray.any() else ids
        self._keep(joints=ids, weights=w, lost=number(lost, "lost"), repaired=count(repaired, "repaired"))

    def __repr__(self) -> str:
        return f"Skin({len(self)} splats, {self.influences} joints each)"

    @classmethod
    def create(cls, joints: ArrayLike, weights: ArrayLike, joint_count: int, influences: int = 4) -> Skin:
        """Sanitise weights, keep the ``influences`` strongest joints of each splat and renormalise.

        ``joints`` and ``weights`` are [N, M] for any M. Negative and non-finite weights count as zero; a splat with
        no weight left rides joint ``joints[i, 0]``; both are counted in ``repaired``. A joint outside
        0..joint_count-1 with a weight above zero is a FormatError: it cannot be guessed.
        """
        ids, w = plain(joints, "joints"), plain(weights, "weights").astype(np.float64)
        if ids.dtype.kind == "f" and not (np.isfinite(ids) & (ids == np.rint(ids))).all():
            raise FormatError("joints needs whole numbers, found fractions, NaN or infinity")
        if not 1 <= count(joint_count, "joint_count") <= 65536:
            raise FormatError(f"joint_count needs 1 to 65536, not {joint_count}")
        if ids.ndim != 2 or ids.shape != w.shape or ids.shape[1] < 1:
            raise FormatError(f"joints and weights need one shape (N, K), not {ids.shape} and {w.shape}")
        if count(influences, "influences") not in INFLUENCES:
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
        return cls(frozen(kept_ids.astype(np.uint16)), frozen(kept.astype(np.float32)), max(lost, 0.0), repaired)

    def __len__(self) -> int:
        return len(self.joints)

    @property
    def influences(self) -> int:
        """Joints a splat, K."""
        return self.joints.shape[1]

    def take(self, index: ArrayLike) -> Skin:
        """Return the rows at ``index`` (an integer or boolean array). Raises FormatError for rows outside."""
        index = rows(index, len(self))
        return replace(self, joints=frozen(self.joints[index]), weights=frozen(self.weights[index]))

    def reduced(self, influences: int) -> Skin:
        """Return the skin with at most ``influences`` joints a splat."""
        if count(influences, "influences", least=1) >= self.influences:
            return self
        return Skin.create(self.joints, self.weights, int(self.joints.max(initial=0)) + 1, influences)

    def anchored(self, parents: NDArray[np.integer]) -> Skin:
        """Return the skin with the anchor of each splat in the first slot, the others strongest first.

        The anchor is the weighted median of the splat's joints in the tree ``parents`` [J]: whichever joint turns, at
        least half of the weight moves with the anchor (where the median is among the splat's joints). A blend that
        collapses takes the anchor's rotation (reference.blended_rotations); with the strongest joint's, the splat would
        spin where two weaker ones outweigh it. Raises FormatError for parents that are no tree.
        """
        parents = own_whole(parents, np.int32, "parents")
        joints = int(self.joints.max(initial=0)) + bool(self.joints.size)
        if parents.ndim != 1 or len(parents) < joints or (parents >= len(parents)).any():
            raise FormatError(f"parents needs the index of its parent, or -1, for each of {joints} joints or more")
        outvoted = np.flatnonzero(self.weights[:, 0] < 0.5)  # with half of the weight the strongest is the median
        if not len(outvoted):
            return self
        below = np.eye(len(parents), dtype=np.float32)  # [a, b]: b is a or hangs from it
        above = parents
        for _ in range(len(parents) + 1):
            if not (above >= 0).any():
                break
            below[above[above >= 0], np.flatnonzero(above >= 0)] = 1
            above = np.where(above >= 0, parents[above], -1)
        else:
            raise FormatError("parents has a cycle")
        depth = below.sum(axis=0)
        hops = depth[:, None] + depth - 2 * (below.T @ below)
        ids, weights = self.joints[outvoted], self.weights[outvoted]
        cost = np.einsum("nck,nk->nc", hops[ids[:, :, None], ids[:, None, :]], weights)
        first = cost.argmin(axis=1)
        order = np.argsort(np.arange(self.influences) != first[:, None], axis=1, kind="stable")
        ids, weights = np.take_along_axis(ids, order, axis=1), np.take_along_axis(weights, order, axis=1)
        all_ids, all_weights = self.joints.copy(), self.weights.copy()
        all_ids[outvoted] = np.where(weights > 0, ids, ids[:, :1])
        all_weights[outvoted] = weights
        return replace(self, joints=frozen(all_ids), weights=frozen(all_weights))

    def dense(self, joint_count: int) -> NDArray[np.float64]:
        """Return the weights as [N, J], for comparisons."""
        least = int(self.joints.max(initial=0)) + 1
        out = np.zeros((len(self), count(joint_count, "joint_count", least=least)))
        np.add.at(out, (np.arange(len(self))[:, None], self.joints), self.weights)
        return out


def strongest_joint(joints: NDArray[IntT], weights: NDArray[Any]) -> NDArray[IntT]:
    """Return [N] the joint of the largest weight in each row of ``joints`` and ``weights`` [N, K]."""
    return np.take_along_axis(joints, weights.argmax(axis=1)[:, None], axis=1)[:, 0]
