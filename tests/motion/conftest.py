"""The default avatar's skeleton."""

from __future__ import annotations

import pytest

from glsplat.data import default_avatar
from glsplat.skinning.skeleton import Skeleton


@pytest.fixture(scope="session")
def skeleton() -> Skeleton:
    return default_avatar().skeleton
