"""Shapes: moves and bends of splats by the named expressions of a face, as the sparse list that the GPU reads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glsplat.arrays import F64, Value, frozen, own, own_whole, plain
from glsplat.errors import FormatError
from glsplat.skinning.expression import MOST_NAMES

BEND = 3.0 / 127
"""A unit of ``Shapes.bends``: of an axis of length one."""

LIMITS = (0.0, 1.0)
"""Default least and largest weight of a shape."""

_MAX_ENTRIES = 1 << 24  # rows of a texture
_STEPS = 32767
_MAX_MOVE_M = 100.0  # more is a mistake of units


@dataclass(frozen=True, slots=True, eq=False, init=False, repr=False)
class Shapes(Value):
    """T named shapes of N splats: E entries, those of splat i from ``starts[i]`` to ``starts[i + 1]``.

    Entry e at weight w moves its splat by w ``sizes[t] moves[e]`` metres, t = ``targets[e]``, and its two long axes
    (``long_axes``), unit vectors, by w BEND ``bends[e]``; the shapes of a splat add up. The third axis is the
    normal of the two and keeps its scale. Numbers are as the GPU reads them, nothing is rounded later.

    Arrays are read-only copies. Raises FormatError. ``create`` takes metres.

    >>> shapes = glsplat.Shapes.create(["jawOpen"], 2, splats=[1], targets=[0], moves=[[0, -0.02, 0]])
    >>> shapes
    Shapes(1 shapes, 1 entries of 2 splats)
    >>> shapes.weights({"jawOpen": 2, "cheekPuff": 1}).tolist()
    [1.0]
    """

    names: tuple[str, ...]
    starts: NDArray[np.int64]  # [N + 1]
    targets: NDArray[np.uint8]  # [E] rising within a splat
    moves: NDArray[np.int16]  # [E, 3]
    bends: NDArray[np.int8]  # [E, 2, 3]
    sizes: NDArray[np.float32]  # [T] metres a unit of ``moves``
    limits: NDArray[np.float32]  # [T, 2] least and largest weight

    def __init__(
        self,
        names: Sequence[str],
        starts: ArrayLike,  # [N + 1]
        targets: ArrayLike,  # [E]
        moves: ArrayLike,  # [E, 3]
        bends: ArrayLike,  # [E, 2, 3]
        sizes: ArrayLike,  # [T]
        limits: ArrayLike | None = None,  # [T, 2]; None: LIMITS
    ) -> None:
        listed = isinstance(names, Sequence) and not isinstance(names, str)
        if not listed or not all(isinstance(name, str) and 0 < len(name) <= 64 for name in names):
            raise FormatError("shapes need names of 1 to 64 characters as a sequence of text")
        names, count = tuple(names), len(names)
        if not 1 <= count <= MOST_NAMES or len(set(names)) != count:
            raise FormatError(f"shapes need 1 to {MOST_NAMES} distinct names, found {len(set(names))} of {count}")
        first, of = own_whole(starts, np.int64, "starts"), own_whole(targets, np.uint8, "targets")
        moved, bent = own_whole(moves, np.int16, "moves"), own_whole(bends, np.int8, "bends")
        if first.ndim != 1 or not len(first) or of.ndim != 1:
            raise FormatError(f"shapes need starts (N + 1,) and targets (E,), not {first.shape} and {of.shape}")
        if moved.shape != (len(of), 3) or bent.shape != (len(of), 2, 3):
            raise FormatError(f"{len(of)} entries need as many moves and bends, not {moved.shape} and {bent.shape}")
        if len(of) > _MAX_ENTRIES:
            raise FormatError(f"shapes have at most {_MAX_ENTRIES} entries, not {len(of)}")
        if first[0] != 0 or first[-1] != len(of) or (np.diff(first) < 0).any():
            raise FormatError(f"starts need to rise from 0 to the number of entries, {len(of)}")
        splats = np.repeat(np.arange(len(first) - 1), np.diff(first))
        if of.max(initial=0) >= count or (np.diff(splats * MOST_NAMES + of) <= 0).any():
            raise FormatError(f"targets need to rise within each splat, and name shapes below {count}")
        size = own(sizes, np.float32, "sizes")
        wide = own(np.tile(LIMITS, (count, 1)) if limits is None else limits, np.float32, "limits")
        if size.shape != (count,) or not ((size >= 0) & (size <= _MAX_MOVE_M / _STEPS)).all():
            raise FormatError(f"shapes need {count} sizes in metres a unit, from 0 to {_MAX_MOVE_M / _STEPS:.3g}")
        if wide.shape != (count, 2) or not (np.isfinite(wide).all() and (np.abs(wide) <= 1e3).all()):
            raise FormatError(f"shapes need limits ({count}, 2) of finite weights below 1000, not {wide.shape}")
        if not ((wide[:, 0] <= 0) & (wide[:, 1] >= 0)).all():
            raise FormatError("the limits of a shape's weight need to hold 0 between them")
        self._keep(names=names, starts=first, targets=of, moves=moved, bends=bent, sizes=size, limits=wide)

    def __repr__(self) -> str:
        return f"Shapes({len(self)} shapes, {len(self.targets)} entries of {self.splats} splats)"

    def __len__(self) -> int:
        return len(self.names)

    @classmethod
    def create(
        cls,
        names: Sequence[str],
        count: int,  # splats
        *,
        splats: ArrayLike,  # [E] which splat an entry is of, in any order
        targets: ArrayLike,  # [E] of which shape, in any order; no pair twice
        moves: ArrayLike,  # [E, 3] metres at weight 1
        bends: ArrayLike | None = None,  # [E, 2, 3] change of the two long axes, units, at weight 1; None: none
        sizes: ArrayLike | None = None,  # [T] metres a unit, where moves are such units already
        limits: ArrayLike | None = None,
    ) -> Shapes:
        """Return shapes of metres, rounded to 16 bits of each shape's largest move; axes to 8 bits within three units.

        Entries that round to zero are left out. Raises FormatError for numbers that are not finite or out of range.
        """
        rows, of = plain(splats, "splats").astype(np.int64).reshape(-1), plain(targets, "targets").reshape(-1)
        of, metres = of.astype(np.int64), plain(moves, "moves").astype(np.float64).reshape(-1, 3)
        axes = np.zeros((len(rows), 2, 3)) if bends is None else plain(bends, "bends").astype(np.float64)
        if not (len(rows) == len(of) == len(metres)) or axes.shape != (len(rows), 2, 3):
            raise FormatError(f"{len(rows)} entries need as many targets, moves (E, 3) and bends (E, 2, 3)")
        if not (np.isfinite(metres).all() and np.isfinite(axes).all()) or np.abs(metres).max(initial=0) > _MAX_MOVE_M:
            raise FormatError(f"shapes need finite moves below {_MAX_MOVE_M:g} m and finite bends")
        if len(rows) and not (0 <= rows.min() and rows.max() < count and 0 <= of.min() and of.max() < len(names)):
            raise FormatError(f"entries need splats below {count} and targets below {len(names)}")
        if sizes is None:
            most = np.zeros(len(names))
            np.maximum.at(most, of, np.abs(metres).max(axis=1, initial=0))
            unit = (most / _STEPS).astype(np.float32)
        else:
            unit = own(sizes, np.float32, "sizes")
        steps = np.rint(metres / np.maximum(unit, np.float32(1e-30))[of, None]).clip(-_STEPS, _STEPS)
        steps = np.where(unit[of, None] > 0, steps, 0).astype(np.int16)
        bent = np.rint(axes / BEND).clip(-127, 127).astype(np.int8)
        something = steps[:, 0] | steps[:, 1] | steps[:, 2]  # column by column: reductions of few take longer
        for column in bent.reshape(-1, 6).T:
            something |= column
        kept = np.flatnonzero(something)
        order = kept[np.lexsort((of[kept], rows[kept]))]
        rows, of, steps, bent = rows[order], of[order], steps[order], bent[order]
        starts = np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=count))])
        return cls(names, frozen(starts.astype(np.int64)), frozen(of.astype(np.uint8)), steps, bent, unit, limits)

    @property
    def splats(self) -> int:
        """Number of splats, N."""
        return len(self.starts) - 1

    @property
    def nbytes(self) -> int:
        """Bytes of the arrays."""
        arrays = (self.starts, self.targets, self.moves, self.bends, self.sizes, self.limits)
        return sum(array.nbytes for array in arrays)

    @property
    def rows(self) -> NDArray[np.int64]:
        """The splat of each entry, [E]."""
        return np.repeat(np.arange(self.splats), np.diff(self.starts))

    @property
    def metres(self) -> NDArray[np.float32]:
        """The moves [E, 3] in metres at weight 1."""
        return self.moves * self.sizes[self.targets, None]

    def weights(self, expression: Mapping[str, float]) -> F64 | None:
        """Return the weights [T] within the shapes' limits; None where all are 0. Other names are ignored.

        Weights have to be finite (``Pose`` checks that).
        """
        if not expression:
            return None
        wanted = np.array([expression.get(name, 0.0) for name in self.names], np.float64)
        found: F64 = np.clip(wanted, self.limits[:, 0], self.limits[:, 1]).astype(np.float64)
        return found if found.any() else None

    def farthest(self, weights: F64) -> float:
        """Return an upper bound of the moves of splats under ``weights`` [T], metres."""
        most = np.zeros(len(self))
        np.maximum.at(most, self.targets, np.linalg.norm(self.metres, axis=1))
        return float(np.abs(weights) @ most)

    def take(self, index: NDArray[np.bool_] | NDArray[np.integer]) -> Shapes:
        """Return the shapes of the splats at ``index``."""
        chosen = np.flatnonzero(index) if index.dtype == bool else np.asarray(index)
        each = np.diff(self.starts)[chosen]
        starts = np.concatenate([[0], np.cumsum(each)]).astype(np.int64)
        at = np.repeat(self.starts[:-1][chosen] - starts[:-1], each) + np.arange(starts[-1])
        targets, moves, bends = (frozen(array[at]) for array in (self.targets, self.moves, self.bends))
        return replace(self, starts=frozen(starts), targets=targets, moves=moves, bends=bends)

    def turned(self, linear: F64, axes: F64 | None = None) -> Shapes:
        """Return the shapes of splats moved by ``linear`` [3, 3] or [N, 3, 3]; ``axes``: the turn of their axes."""
        turns = linear if axes is None else axes
        if linear.ndim == 3:
            linear = linear[self.rows]
        if turns.ndim == 3:
            turns = turns[self.rows, None]
        moved = np.einsum("...ij,...j->...i", linear, self.metres.astype(np.float64))
        bent = np.einsum("...ij,...j->...i", turns, self.bends * BEND)
        limits, rows, targets = self.limits, self.rows, self.targets
        return Shapes.create(
            self.names, self.splats, splats=rows, targets=targets, moves=moved, bends=bent, limits=limits
        )

    def texels(self) -> NDArray[np.uint32]:
        """Return the entries [E, 4] as shapes.glsl reads them."""
        bytes_ = np.zeros((len(self.targets), 16), np.uint8)
        bytes_[:, :6] = np.ascontiguousarray(self.moves, "<i2").view(np.uint8).reshape(-1, 6)
        bytes_[:, 6:12] = self.bends.reshape(-1, 6).view(np.uint8)
        bytes_[:, 12] = self.targets
        return bytes_.view("<u4").astype(np.uint32)

    def amounts(self, weights: F64) -> NDArray[np.float32]:
        """Return [T, 2] metres a unit of ``moves`` and of axis a unit of ``bends``, at ``weights`` [T]."""
        return np.stack([weights * self.sizes, weights * BEND], axis=1).astype(np.float32)


def long_axes(scales: NDArray[np.float32]) -> NDArray[np.intp]:
    """Return the indices [N, 3] of a splat's two long axes, in cyclic order, and its thin one, the first of equals."""
    thin = np.abs(scales).argmin(axis=1)
    return np.stack([(thin + 1) % 3, (thin + 2) % 3, thin], axis=1)
