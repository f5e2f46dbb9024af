"""Skins and skeletons refuse numbers that do not fit, in one line."""

from __future__ import annotations

import numpy as np
import pytest

from glsplat.errors import FormatError, PoseError
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.skin import Skin


@pytest.mark.parametrize("influences", [0, 3, 16])
def test_a_number_of_influences_without_a_shader(influences: int) -> None:
    with pytest.raises(FormatError, match=rf"influences needs one of \(1, 2, 4, 8\), not {influences}"):
        Skin.create(np.zeros((2, 4), int), np.ones((2, 4)), 1, influences)


@pytest.mark.parametrize("trans", [1.0, [1.0], [[1.0, 2.0, 3.0]]])
def test_a_translation_that_only_numpy_can_add(trans: object) -> None:
    skeleton = Skeleton.from_joints(["hip", "knee"], [-1, 0], [[0, 1, 0], [0, 0.5, 0]])
    with pytest.raises(PoseError, match=r"trans needs shape \(3,\)"):
        skeleton.forward(np.zeros((2, 3)), trans)  # type: ignore[arg-type]
