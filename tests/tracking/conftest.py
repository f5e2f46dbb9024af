"""The embedded avatar's skeleton, a made-up user, and a tracker that checks its promises."""

from __future__ import annotations

import pytest

from glsplat.data import default_avatar
from glsplat.skinning.skeleton import Skeleton
from glsplat.tracking.solve.body import Body
from tests.tracking.moves import Stage, Track, run


@pytest.fixture(scope="session")
def skeleton() -> Skeleton:
    return default_avatar().skeleton


@pytest.fixture(scope="session")
def body(skeleton: Skeleton) -> Body:
    return Body.of(skeleton)


@pytest.fixture(scope="session")
def stage(body: Body) -> Stage:
    return Stage(body)


@pytest.fixture(scope="session")
def track(skeleton: Skeleton) -> Track:
    return lambda samples, **options: run(skeleton, samples, **options)
