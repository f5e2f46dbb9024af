"""The default avatar's skeleton, and a made-up walk on it."""

from __future__ import annotations

import pytest

from glsplat.data import default_avatar
from glsplat.motion.motion import Motion
from glsplat.skinning.skeleton import Skeleton
from tests.motion.exports import walking


@pytest.fixture(scope="session")
def skeleton() -> Skeleton:
    return default_avatar().skeleton


@pytest.fixture(scope="session")
def walk(skeleton: Skeleton) -> Motion:
    return walking(skeleton)
