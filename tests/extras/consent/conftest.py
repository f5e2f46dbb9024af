"""A small avatar in a file, a key, and a record of it."""

from __future__ import annotations

from datetime import date
from pathlib import Path

import numpy as np
import pytest

import glsplat
from glsplat.extras.consent.file import sign_data
from glsplat.extras.consent.keys import PrivateKey, new_key

FIELDS = {
    "subject": "Ann Example",
    "given_by": "Ann Example",
    "purpose": "a study of May",
    "start": date(2026, 5, 1),
    "until": date(2026, 5, 31),
    "drivers": ["ann"],
}
DURING = 1_778_800_000.0  # the 14th of May 2026


def person(seed: int = 0, count: int = 30) -> glsplat.Avatar:
    rng = np.random.default_rng(seed)
    splats = glsplat.Splats.create(
        rng.normal(size=(count, 3)),
        rng.normal(size=(count, 4)),
        rng.uniform(0.01, 0.1, (count, 3)),
        rng.uniform(0.1, 0.9, count),
        rgb=rng.uniform(size=(count, 3)),
    )
    skeleton = glsplat.Skeleton.from_joints(["hip", "knee"], [-1, 0], [[0, 1, 0], [0, 0.5, 0]])
    weights = rng.uniform(0.2, 0.8, (count, 1))
    skin = glsplat.Skin.create(np.tile([0, 1], (count, 1)), np.hstack([weights, 1 - weights]), 2, 2)
    return glsplat.Avatar(splats, skeleton, skin, {"source": "made up"})


@pytest.fixture(scope="session")
def key(tmp_path_factory) -> PrivateKey:
    return new_key(tmp_path_factory.mktemp("keys") / "key")


@pytest.fixture
def file(tmp_path) -> Path:
    """Without a record."""
    path = tmp_path / "ann.glb"
    glsplat.save(person(), path)
    return path


@pytest.fixture
def signed(file, key) -> Path:
    file.write_bytes(sign_data(file.read_bytes(), key, **FIELDS))
    return file
