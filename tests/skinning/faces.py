"""Avatars with shapes made in code, for tests of what moves a face."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from glsplat.avatar import Avatar
from glsplat.skinning.shapes import Shapes
from tests.scenes import limb

NAMES = ("jawOpen", "eyeBlinkLeft", "mouthSmileRight", "browInnerUp")


def random_shapes(count: int, names: Sequence[str] = NAMES, share: float = 0.3, seed: int = 4) -> Shapes:
    """Shapes that move and bend ``share`` of ``count`` splats each, by centimetres and halves of an axis."""
    rng = np.random.default_rng(seed)
    splats, targets = np.nonzero(rng.random((count, len(names))) < share)
    moves, bends = rng.normal(0, 0.03, (len(splats), 3)), rng.normal(0, 0.4, (len(splats), 2, 3))
    return Shapes.create(names, count, splats=splats, targets=targets, moves=moves, bends=bends)


def expressive(count: int = 600, influences: int = 4, degree: int = 0) -> Avatar:
    """A limb (tests.scenes) with shapes; of its last quarter of splats none moves."""
    avatar = limb(count, influences=influences, degree=degree)
    few = random_shapes(3 * count // 4)
    starts = np.concatenate([few.starts, np.full(count - few.splats, few.starts[-1])])
    return replace(avatar, shapes=replace(few, starts=starts))
