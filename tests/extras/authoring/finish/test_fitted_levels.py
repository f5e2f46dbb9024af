"""Fits of fewer splats to pictures of more: better than merging alone, deterministic."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from glsplat import reference
from glsplat.avatar import Avatar
from glsplat.camera import Camera, look_at, pinhole
from glsplat.errors import GlsplatError
from glsplat.extras.authoring.finish.level_merge import merged
from glsplat.extras.authoring.finish.levels import FittedConfig, fitted_levels, reduced, with_levels
from glsplat.extras.authoring.optimize.target_pictures import TargetPicture, ViewConfig
from glsplat.extras.authoring.sample.surface import SamplerConfig, make_avatar
from glsplat.splats import Level
from tests.extras.authoring.sample.test_surface import ball, rigged

QUICK = FittedConfig(steps=8, size=200, poses=1)


@pytest.fixture(scope="module")
def finest() -> Avatar:
    return make_avatar(rigged(ball()), 900, 3, SamplerConfig(probe=128))


def apart(avatar: Avatar, other: Avatar) -> float:
    """Return the mean squared error over views that no fit draws, at the size of the fit."""
    total = 0.0
    for eye in ((0, 1, 1.5), (1.3, 1.5, -0.4), (-0.6, 0.4, 1.0)):
        camera = Camera(look_at(eye, (0, 1, 0)), pinhole(56, 56, 30), 56, 56)
        pictures = [reference.render(one.splats, [camera])[0] for one in (avatar, other)]
        total += float(((pictures[0] - pictures[1]) ** 2).mean())
    return total


def test_a_fitted_level_is_closer_to_the_finest_than_a_merged_one(finest: Avatar) -> None:
    (level,) = fitted_levels(finest, [120], config=replace(QUICK, steps=80))
    assert len(level.splats) == 120 and level.splats.antialias and level.skeleton is finest.skeleton
    assert apart(level, finest) < 0.5 * apart(merged(finest, 120), finest)


def test_levels_grow_fewer(finest: Avatar) -> None:
    for counts in ([900], [300, 300], [120, 300], [0], []):
        with pytest.raises(GlsplatError, match="fewer and fewer splats below 900"):
            with_levels(finest, counts)


def test_levels_and_cones_are_dropped(finest: Avatar) -> None:
    coarse = Level(merged(finest, 100), 50.0)
    coned = replace(finest.splats, cones=np.full((900, 4), 127, np.int8), cones_psnr=45.0)
    small = reduced(replace(finest, splats=coned, levels=(coarse,)), 250, config=QUICK)
    assert len(small.splats) == 250 and small.levels == () and small.splats.cones is None
    assert small.splats.means.tobytes() == reduced(finest, 250, config=QUICK).splats.means.tobytes()


def test_without_steps_it_is_merged(finest: Avatar) -> None:
    small, plain = reduced(finest, 250, config=replace(QUICK, steps=0)), merged(finest, 250)
    np.testing.assert_allclose(small.splats.means, plain.splats.means, atol=1e-6)
    np.testing.assert_allclose(small.splats.scales, plain.splats.scales, rtol=1e-5)


def test_fewer_splats_are_fitted_in_smaller_pictures(finest: Avatar, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[ViewConfig] = []

    def pictures_of_splats(avatar: Avatar, seed: int, views: ViewConfig, progress: object) -> list[TargetPicture]:
        seen.append(views)
        assert seed == 7
        return []

    monkeypatch.setattr("glsplat.extras.authoring.optimize.target_pictures.pictures_of_splats", pictures_of_splats)
    config = FittedConfig(steps=1, size=768, splats=500, power=0.7)
    for count in (890, 500, 250, 30):
        reduced(finest, count, 7, config)
    assert [views.size for views in seen] == [768, 768, 473, 160]
    assert [views.close for views in seen] == [384, 384, 236, 80]
