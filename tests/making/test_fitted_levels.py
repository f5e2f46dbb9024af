"""Levels fitted to pictures of the finest: closer to it than merging alone, the same for the same seed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from glsplat import reference
from glsplat.avatar import Avatar
from glsplat.camera import Camera, look_at, pinhole
from glsplat.errors import GlsplatError
from glsplat.making.detail.fitted import FittedConfig, fitted_levels
from glsplat.making.detail.merge import merged
from glsplat.making.surface import SamplerConfig, make_avatar
from glsplat.meshes import RiggedMesh
from glsplat.skinning.pose import Pose
from tests.making.test_surface import ball, rigged

QUICK = FittedConfig(steps=24, pictures=8)


@pytest.fixture(scope="module")
def mesh() -> RiggedMesh:
    return rigged(ball())


@pytest.fixture(scope="module")
def finest(mesh: RiggedMesh) -> Avatar:
    return make_avatar(mesh, 900, 3, SamplerConfig(probe=128))


def apart(avatar: Avatar, other: Avatar) -> float:
    """Mean square over pictures of views that no fit draws, at the size of one."""
    total = 0.0
    for eye in ((0, 1, 1.5), (1.3, 1.5, -0.4), (-0.6, 0.4, 1.0)):
        camera = Camera(look_at(eye, (0, 1, 0)), pinhole(56, 56, 30), 56, 56)
        pictures = [reference.render(one.splats, [camera])[0] for one in (avatar, other)]
        total += float(((pictures[0] - pictures[1]) ** 2).mean())
    return total


def test_a_fitted_level_is_closer_to_the_finest_than_a_merged_one(finest: Avatar) -> None:
    (level,) = fitted_levels(finest, [120], config=replace(QUICK, steps=60, pictures=10))
    assert len(level.splats) == 120 and level.splats.antialias and level.skeleton is finest.skeleton
    assert apart(level, finest) < 0.8 * apart(merged(finest, 120), finest)


def test_the_mesh_draws_a_level_towards_itself(mesh: RiggedMesh, finest: Avatar) -> None:
    """The finest is too dark by half; with the mesh at hand its level is less so."""
    dark = replace(finest, splats=replace(finest.splats, sh=finest.splats.sh - 0.5))
    (alone,) = fitted_levels(dark, [250], config=QUICK)
    (level,) = fitted_levels(dark, [250], mesh, config=replace(QUICK, mesh_share=0.8))
    assert apart(level, finest) < 0.6 * apart(alone, finest)


def test_same_seed_same_bytes(mesh: RiggedMesh, finest: Avatar) -> None:
    quick = replace(QUICK, steps=3, pictures=2)
    once, again = (fitted_levels(finest, [300, 120], mesh, 5, quick) for _ in range(2))
    for a, b in zip(once, again, strict=True):
        assert a.splats.means.tobytes() == b.splats.means.tobytes() and a.splats.sh.tobytes() == b.splats.sh.tobytes()
    (other,) = fitted_levels(finest, [300], mesh, 6, quick)
    assert other.splats.means.tobytes() != once[0].splats.means.tobytes()
    (alone,) = fitted_levels(finest, [120], mesh, 5, quick)  # a level does not hang on those beside it
    assert alone.splats.means.tobytes() == once[1].splats.means.tobytes()


def test_levels_grow_fewer(finest: Avatar) -> None:
    for counts in ([900], [300, 300], [120, 300], [0]):
        with pytest.raises(GlsplatError, match="fewer and fewer splats below 900"):
            fitted_levels(finest, counts, config=QUICK)
    assert fitted_levels(finest, [], config=QUICK) == ()


def test_a_level_moves_as_the_finest_does(finest: Avatar) -> None:
    (level,) = fitted_levels(finest, [250], config=replace(QUICK, steps=4, pictures=4))
    assert np.allclose(level.skin.weights.sum(axis=1), 1, atol=1e-6)
    bones = Pose(np.array([[0.0, 0, 0], [0, 0, 0.7]])).bones(finest.skeleton)
    middles = [reference.skin(one.splats, one.skin, bones).means.mean(axis=0) for one in (finest, level)]
    assert np.linalg.norm(middles[0] - middles[1]) < 0.01
