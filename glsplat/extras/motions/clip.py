"""Clip: a motion on its own skeleton, the result of the readers of motions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F64
from glsplat.errors import PoseError

_MOST = 1 << 22  # joints times frames; 96 bytes each
_FARTHEST = 1e12  # in any unit


@dataclass(frozen=True, slots=True, eq=False)
class Clip:
    """T frames of S joints, in the file's own world (any axes) and unit."""

    names: tuple[str, ...]
    parents: NDArray[np.int32]  # [S] parents come first, -1 for the root
    rest: F64  # [S, 3] rest positions of the joints
    turns: F64  # [T, S, 3, 3] their rotations from the rest pose, in the world
    places: F64  # [T, S, 3] their positions
    fps: float
    given: Mapping[str, int | None] = field(default_factory=dict)
    """SMPL-X joint -> index, from the file itself (VRM)."""
    y_up: bool = False  # whether the format states that the world's y is up
    label: str = ""  # which of several in a file: "#Walk"
    note: str = ""  # names of the others

    def __post_init__(self) -> None:
        for values in (self.rest, self.turns, self.places):
            if not np.abs(values).max(initial=0) < _FARTHEST:  # NaN is not less either
                raise PoseError("a motion needs finite numbers, found NaN, infinity or far too large ones")

    def __len__(self) -> int:
        return len(self.turns)


def check_size(frames: int, joints: int) -> None:
    """Raise PoseError above the size limit; call this before any allocation."""
    if frames * joints > _MOST:
        raise PoseError(f"a motion has at most {_MOST} joints times frames, not {frames} frames of {joints}; cut it")


def chained(
    names: Sequence[str],
    parents: NDArray[np.int32],  # [S] parents come first
    offsets: F64,  # [S, 3] rest position in the parent's frame
    rotations: F64,  # [T, S, 3, 3] local; overwritten
    moved: Mapping[int, F64],  # joint -> [T, 3] position in the parent's frame, instead of the offset
    fps: float,
) -> Clip:
    """Return a clip with an unrotated rest pose, by forward kinematics: G_j = G_p R_j, p_j = p_p + G_p o_j."""
    rest, turns = np.zeros_like(offsets), rotations
    places = np.empty((len(rotations), len(names), 3))
    for i, parent in enumerate(parents):
        local = moved.get(i, offsets[i])
        if parent < 0:
            places[:, i] = local
            continue
        rest[i] = rest[parent] + offsets[i]
        places[:, i] = places[:, parent] + np.einsum(
            "tij,...j->ti" if local.ndim == 1 else "tij,tj->ti", turns[:, parent], local
        )
        turns[:, i] = turns[:, parent] @ turns[:, i]
    return Clip(tuple(names), parents, rest, turns, places, fps)
