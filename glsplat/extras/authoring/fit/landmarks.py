"""Place the 33 landmarks of a pose network on the body: an offset from a joint, and a typical error, for each."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property, lru_cache
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F64
from glsplat.extras.authoring.body.open_body import Body, Points
from glsplat.extras.authoring.networks.person import OPPOSITE
from glsplat.skinning.smplx import JOINT_NAMES

LANDMARK_COUNT = 33
"""Number of the network's landmarks."""


@dataclass(frozen=True, eq=False)
class Landmarks:
    """The landmarks in use. Offsets and errors are fractions of the stature."""

    numbers: NDArray[np.intp]  # [L] in the network's order
    joints: NDArray[np.intp]  # [L]
    offsets: F64  # [L, 3] from the joint, in its rest frame
    errors: F64  # [L] typical distance in the picture between the network's landmark and the true one

    @cached_property
    def mirror_rows(self) -> NDArray[np.intp]:
        """[L] row of the landmark on the other side, or of the nose itself."""
        rows = {int(number): row for row, number in enumerate(self.numbers)}
        return np.array([rows[OPPOSITE[number]] for number in self.numbers], np.intp)

    def points(self, body: Body) -> Points:
        """Return the landmarks as points of the body."""
        size, grows = body.stature
        rest = body.joints[self.joints] + self.offsets * size
        shape = body.shape_joints[self.joints] + self.offsets[..., None] * grows
        return Points(rest, shape, self.joints[:, None], np.ones((len(self.joints), 1)))


def read_table(name: str, key: str = "landmarks") -> list[dict[str, Any]]:
    """Return the rows of one of this package's JSON tables."""
    rows: list[dict[str, Any]] = json.loads(resources.files(__package__).joinpath(name).read_text("utf-8"))[key]
    return rows


@lru_cache(maxsize=1)
def landmarks() -> Landmarks:
    """Return the embedded table (landmark_offsets.json), measured on people whose joints and skin are known."""
    rows = read_table("landmark_offsets.json")
    return Landmarks(
        numbers=np.array([row["landmark"] for row in rows], np.intp),
        joints=np.array([JOINT_NAMES.index(row["joint"]) for row in rows], np.intp),
        offsets=np.array([row["offset"] for row in rows], np.float64),
        errors=np.array([row["stray"] for row in rows], np.float64),
    )
