"""A shirt's flank behind an arm is as wide as below it; a bare one, and one that is seen at the hips alone, is not."""

from __future__ import annotations

import numpy as np
import pytest

from glsplat.authoring.fit.body import open_body
from glsplat.authoring.fit.hanging import hung
from glsplat.authoring.fit.offsets import outward
from glsplat.authoring.paint.layers.segments import trunk_of
from glsplat.skinning.smplx import JOINT_NAMES

BODY = open_body()
ASIDE = 0.7


def flanks(seen_up_to: float, worn: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Vertices, their offsets, the offsets before, and the height up to which flanks are seen: metres over the navel."""
    bare, joints = BODY.shaped(np.zeros(10))
    directions = outward(BODY, bare)
    edge = joints[JOINT_NAMES.index("spine1"), 1] + seen_up_to
    sides = trunk_of(BODY) & (np.abs(directions[:, 0]) > ASIDE)
    offsets = np.full(len(bare), worn)
    rim, hidden = (np.flatnonzero(sides & some) for some in (bare[:, 1] < edge, bare[:, 1] >= edge))
    found, wanted = hung(BODY, bare, joints, directions, offsets, rim, hidden)
    return found, wanted, offsets, edge


def test_a_shirt_is_as_wide_behind_an_arm_as_below_it() -> None:
    bare, _ = BODY.shaped(np.zeros(10))
    found, wanted, offsets, edge = flanks(0.02, 0.02)
    assert len(found) > 10
    assert (bare[found, 1] >= edge - 0.02).all()  # what is seen stays as it is
    assert (wanted > offsets[found]).all()
    dressed = bare[found] + wanted[:, None] * outward(BODY, bare)[found]
    below = np.abs(bare[:, 1] - edge + 0.015) < 0.01
    for side in (1.0, -1.0):
        seen = (side * (bare + 0.02 * outward(BODY, bare)))[trunk_of(BODY) & below, 0].max()
        mine = dressed[side * dressed[:, 0] > 0]
        assert len(mine) and np.abs(side * mine[:, 0] - seen).max() < 0.015


@pytest.mark.parametrize(("seen_up_to", "worn"), [(0.02, 0.0), (0.02, 0.004), (-0.2, 0.02), (1.0, 0.02)])
def test_nothing_hangs(seen_up_to: float, worn: float) -> None:
    """From bare flanks, from hips, and where no arm hides any."""
    found, wanted, offsets, _ = flanks(seen_up_to, worn)
    assert len(found) == len(wanted)
    assert np.allclose(wanted, offsets[found])
