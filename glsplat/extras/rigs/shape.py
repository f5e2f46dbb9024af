"""Identify joints by their positions: two legs below, two arms above, a head between them.

Automatic rigs call their joints bone_0, bone_1, ... A standing, upright and nearly symmetric person is recognised by
the joints' positions. The toes, if any, show whether the person faces +z, as glTF requires.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glsplat.arrays import F64
from glsplat.extras.rigs.match import spine_of

Limb = tuple[int, int, int]

_LONGEST = 24  # joints a limb
_EVEN = 0.55  # of two bones of a limb: the shorter by the longer
_PASSED = 0.9  # factor for each skipped joint, such as a twist
_MIRRORED = 0.1  # of the height: largest distance of a limb from the other's mirror image
_LEGS, _ARMS = (0.3, 0.75), (0.15, 0.75)  # of the height: range of their lengths


def match_shape(parents: ArrayLike, positions: ArrayLike, joints: ArrayLike) -> dict[str, int]:
    """Return SMPL-X joint -> index for nodes that stand like a person, y up; empty for anything else.

    Of N nodes, ``parents`` [N], ``positions`` [N, 3], ``joints`` [N] whether a node may be one.
    """
    return _Shape(np.asarray(parents, np.intp), np.asarray(positions, np.float64), np.asarray(joints, bool)).person()


class _Shape:
    def __init__(self, parents: NDArray[np.intp], points: F64, may: NDArray[np.bool_]) -> None:
        self.points = points
        self.nodes = [int(i) for i in np.flatnonzero(may)]
        self.parent: dict[int, int] = {}
        self.children: dict[int, list[int]] = {node: [] for node in self.nodes}
        for node in self.nodes:
            at, steps = int(parents[node]), 0
            while at >= 0 and not may[at] and steps <= len(parents):
                at, steps = int(parents[at]), steps + 1
            self.parent[node] = at
            if at >= 0:
                self.children[at].append(node)
        self.height = float(np.ptp(points[self.nodes, 1])) if self.nodes else 0.0

    def person(self) -> dict[str, int]:
        if not 8 <= len(self.nodes) <= 1024 or not np.isfinite(self.points[self.nodes]).all() or self.height <= 0:
            return {}
        legs = max((found for node in self.nodes if (found := self._pair(node, -1.0, _LEGS))), default=None)
        if legs is None:
            return {}
        arms = max(
            (f for n in self.nodes if (f := self._pair(n, 1.0, _ARMS)) and self._above(n, legs[1])), default=None
        )
        if arms is None:
            return {}
        (_, pelvis, *thighs), (_, chest, *upper) = legs, arms
        out = {"pelvis": pelvis}
        for pair, parts in ((thighs, ("hip", "knee", "ankle")), (upper, ("shoulder", "elbow", "wrist"))):
            for side, limb in zip(("left", "right"), pair, strict=True):
                out |= {f"{side}_{part}": node for part, node in zip(parts, limb, strict=True)}
        for side in ("left", "right"):
            toes = self.children[out[f"{side}_ankle"]]
            if toes:
                out[f"{side}_foot"] = max(
                    toes, key=lambda n: abs(float((self.points[n] - self.points[self.parent[n]])[2]))
                )
            if (collar := self.parent[out[f"{side}_shoulder"]]) != chest:
                out[f"{side}_collar"] = collar
        head = self._head(chest, set(out.values()))
        if not head:
            return {}
        out |= {"head": head[-1]} | ({"neck": head[0]} if len(head) > 1 else {})
        return out | spine_of(self._between(pelvis, chest))

    def _pair(self, node: int, way: float, size: tuple[float, float]) -> tuple[float, int, Limb, Limb] | None:
        """Return (length, node, left, right) of the longest mirrored limbs of three joints; ``way`` < 0: down."""
        limbs = [limb for child in self.children[node] if (limb := self._limb(child))]
        best = None
        for a, b in combinations(limbs, 2):
            left, right = (a, b) if self.points[a[2], 0] > self.points[b[2], 0] else (b, a)
            ours, theirs = self.points[list(left)], self.points[list(right)]
            middle = (ours[0, 0] + theirs[0, 0]) / 2
            mirrored = (theirs - (middle, 0, 0)) * (-1, 1, 1) + (middle, 0, 0)
            length = float(np.linalg.norm(np.diff(ours, axis=0), axis=1).sum())
            down = float(ours[0, 1] - ours[2, 1])
            if (
                np.abs(mirrored - ours).max() > _MIRRORED * self.height
                or ours[0, 0] - theirs[0, 0] < 0.02 * self.height
            ):
                continue
            if not size[0] * self.height < length < size[1] * self.height or (way < 0 and down < 0.8 * length):
                continue
            if best is None or length > best[0]:
                best = (length, node, left, right)
        return best

    def _limb(self, first: int) -> Limb | None:
        """Return the three joints of a chain with the longest bones of about equal length."""
        chain = self._chain(first)
        fingers = [sum(bool(self.children[child]) for child in self.children[n]) for n in chain]
        hand = next((k for k, count in enumerate(fingers) if k > 1 and count > 2), len(chain))
        chain = chain[: hand + 1]  # without fingers
        best, score = None, 0.0
        for triple in combinations(chain, 3):
            a, b = np.linalg.norm(np.diff(self.points[list(triple)], axis=0), axis=1)
            even = float(min(a, b) / max(a, b, 1e-12))
            between = chain.index(triple[2]) - chain.index(triple[0]) - 2
            if even > _EVEN and (value := even * float(a + b) ** 0.5 * _PASSED**between) > score:
                best, score = triple, value
        return best

    def _chain(self, first: int) -> list[int]:
        """Return the chain from a joint outwards, always towards the farthest descendant."""
        out = [first]
        while self.children[out[-1]] and len(out) < _LONGEST:
            at = self.points[out[-1]]
            out.append(max(self.children[out[-1]], key=lambda n: (self._reach(n, at), -n)))
        return out

    def _reach(self, node: int, start: F64) -> float:
        far, pending, steps = 0.0, [node], 0
        while pending and steps < 1024:
            at = pending.pop()
            far, steps = max(far, float(np.linalg.norm(self.points[at] - start))), steps + 1
            pending += self.children[at]
        return far

    def _above(self, node: int, pelvis: int) -> bool:
        """Return whether a joint is above the pelvis."""
        up = float(self.points[node, 1] - self.points[pelvis, 1])
        return node != pelvis and up > 0.05 * self.height

    def _head(self, chest: int, taken: set[int]) -> list[int]:
        """Return neck and head: up to the joint of eyes or hair, or all but the tip."""
        middle = self.points[chest]
        best: list[int] = []
        for child in self.children[chest]:
            chain = self._chain(child)
            rise = self.points[chain[-1]] - middle
            if taken & set(chain) or rise[1] <= 0 or abs(float(rise[0])) > _MIRRORED * self.height:
                continue
            if not best or float(self.points[chain[-1], 1]) > float(self.points[best[-1], 1]):
                best = chain
        end = next((k for k, n in enumerate(best) if len(self.children[n]) > 1), None)
        if end is not None:
            return best[: end + 1]
        return best[:-1] if len(best) > 2 else best

    def _between(self, pelvis: int, chest: int) -> Sequence[int]:
        """Return the joints above the pelvis up to the chest, from below."""
        out: list[int] = []
        at = chest
        while at >= 0 and at != pelvis and len(out) < _LONGEST and self.points[at, 1] > self.points[pelvis, 1]:
            out.append(at)
            at = self.parent[at]
        return out[::-1]
