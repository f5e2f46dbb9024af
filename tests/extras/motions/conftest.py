"""Fixtures of the tracker's tests, and a made-up walk on the default avatar's skeleton."""

from __future__ import annotations

import pytest

from glsplat.motion.motion import Motion
from glsplat.skinning.skeleton import Skeleton
from tests.extras.motions.exports import walking
from tests.tracking.conftest import body, skeleton, stage, track

__all__ = ["body", "skeleton", "stage", "track"]


@pytest.fixture(scope="session")
def walk(skeleton: Skeleton) -> Motion:
    return walking(skeleton)
