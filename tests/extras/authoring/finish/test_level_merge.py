"""Merges of splats: moments, costs, rigs, pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from glsplat import reference
from glsplat.avatar import Avatar
from glsplat.errors import GlsplatError
from glsplat.extras.authoring.finish.level_measure import MeasureConfig
from glsplat.extras.authoring.finish.level_merge import Cover, area_of, covered, merged, merged_levels
from glsplat.extras.authoring.finish.levels import halves, with_levels
from glsplat.splats import Splats
from tests.scenes import cloud, limb


def discs(means: Sequence[Sequence[float]], rgb: Sequence[Sequence[float]], size: float = 0.5) -> Splats:
    """Flat splats whose normal is z."""
    n = len(means)
    return Splats.create(means, [[1.0, 0, 0, 0]] * n, [[size, size, 1e-3]] * n, [0.3] * n, rgb=rgb)


def test_moments_of_the_whole_are_kept() -> None:
    """Mean and covariance, weighted by opacity times area, of two splats, computed by hand."""
    two = Splats.create(
        [[-1.0, 0, 0], [1, 0, 0]], [[1.0, 0, 0, 0]] * 2, [[0.1, 0.2, 0.3]] * 2, [0.2, 0.2], rgb=[[1, 0, 0], [0, 0, 1]]
    )
    (one,) = merged_levels(two, [1])
    np.testing.assert_allclose(one.means, [[0, 0, 0]], atol=1e-6)
    shape = reference.rest(one).shapes[0]
    np.testing.assert_allclose(shape @ shape.T, np.diag([1.01, 0.04, 0.09]), atol=1e-5)
    before = area_of(np.array([[0.1, 0.2, 0.3]]))
    after = area_of(np.array([[np.sqrt(1.01), 0.2, 0.3]]))
    np.testing.assert_allclose(one.opacities, 2 * 0.2 * before / after, rtol=1e-4)
    np.testing.assert_allclose(one.sh, two.sh.mean(axis=0, keepdims=True), atol=1e-6)
    assert merged(two, 2) is two


def test_areas_of_known_ellipsoids() -> None:
    np.testing.assert_allclose(area_of(np.array([[2.0, 2, 2]])), 4, rtol=1e-6)
    np.testing.assert_allclose(area_of(np.array([[2.0, 2, 0]])), 2, rtol=0.01)  # a disc, half of it in the mean


def test_excess_opacity_enlarges_a_splat_in_its_plane() -> None:
    much = Splats.create([[0, 0, 0]], [[1, 0, 0, 0]], [[0.4, 0.3, 0.01]], [3.88], rgb=[[1, 1, 1]])
    done = covered(much, Cover(grow=1.0))
    np.testing.assert_allclose(done.opacities, [0.97])
    np.testing.assert_allclose(done.scales, [[0.8, 0.6, 0.01]], rtol=1e-6)
    little = covered(replace(much, opacities=np.float32([0.5])), Cover(gain=1.2))
    np.testing.assert_allclose(little.opacities, [0.6])
    np.testing.assert_allclose(little.scales, much.scales)


def test_equal_colours_are_merged_first() -> None:
    red, blue = [1, 0, 0], [0, 0, 1]
    few = merged(discs([[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]], [red, red, blue, blue]), 2)
    np.testing.assert_allclose(sorted(few.means[:, 0]), [0.5, 2.5], atol=1e-6)


def test_the_sides_of_a_thin_sheet_stay_apart() -> None:
    """Two layers nearer to each other than the splats of each."""
    layers = [[x, 0, z] for z in (0.0, 0.7) for x in (0.0, 1.0)]
    few = merged(discs(layers, [[1, 1, 1]] * 4), 2)
    np.testing.assert_allclose(sorted(few.means[:, 2]), [0, 0.7], atol=1e-6)


def test_an_avatar_keeps_its_rig_and_bad_splats_are_dropped() -> None:
    avatar = limb(600)
    means = avatar.splats.means.copy()
    means[0] = np.nan
    scene = replace(avatar, splats=replace(avatar.splats, means=means, antialias=True))
    few = merged(scene, 150)
    assert len(few.splats) == 150 and few.skeleton is avatar.skeleton and few.splats.antialias
    np.testing.assert_allclose(few.skin.weights.sum(axis=1), 1, atol=1e-5)
    assert few.splats.finite().all() and (few.splats.opacities <= 1).all()
    again = merged(scene, 150)
    np.testing.assert_array_equal(few.splats.means, again.splats.means)


def test_any_count_is_reached() -> None:
    scene = cloud(500, degree=1)
    levels = merged_levels(scene, [400, 77, 3, 1])
    assert [len(level) for level in levels] == [400, 77, 3, 1]
    assert all(level.sh.shape[1] == 4 for level in levels)
    heap = Splats.create([[0, 0, 0]] * 50, [[1, 0, 0, 0]] * 50, [[0.1] * 3] * 50, [0.5] * 50, rgb=[[1, 1, 1]] * 50)
    assert len(merged(heap, 7)) == 7  # all costs are equal


def test_errors() -> None:
    for counts in ([], [0], [5, 5], [5, 9]):
        with pytest.raises(GlsplatError, match="falling numbers"):
            merged_levels(cloud(20), counts)
    with pytest.raises(GlsplatError, match="at least one finite splat"):
        merged_levels(
            Splats.create([[np.nan] * 3] * 2, [[1, 0, 0, 0]] * 2, [[1] * 3] * 2, [1] * 2, rgb=[[1] * 3] * 2), [1]
        )


@pytest.mark.usefixtures("gl")
@pytest.mark.gl
def test_levels_are_measured_and_replace_old_ones() -> None:
    scene = replace(cloud(400, spread=0.2), antialias=True)
    config = MeasureConfig(psnr=24, directions=2, inside=0, size=96)
    stages: list[str] = []
    made = with_levels(scene, [200, 100], config=config, progress=lambda stage, done: stages.append(stage))
    assert made.levels and all(level.psnr is not None and level.psnr >= 24 for level in made.levels)
    assert {"merging splats", "matching the coverage of levels", "measuring levels"} == set(stages)
    again = with_levels(made, [200, 100], config=config)
    assert [level.density for level in again.levels] == [level.density for level in made.levels]
    with pytest.raises(GlsplatError, match="fewer and fewer splats below 400, not 400"):
        with_levels(scene, [400], config=config)


def test_halves() -> None:
    assert halves(40_000) == [20_000, 10_000, 5_000]
    assert halves(1_000_000)[-1] == 7812 and len(halves(1_000_000)) == 7
    assert halves(6000) == [3000] and halves(1) == []


def test_splats_of_two_joints_stay_apart() -> None:
    avatar = limb(40)
    rigid = np.zeros((40, avatar.skin.influences), np.float32)
    rigid[:, 0] = 1
    joints = np.zeros((40, avatar.skin.influences), np.uint16)
    joints[20:] = 1
    means = np.tile(np.linspace(0, 1, 20)[:, None] * [1, 0, 0], (2, 1)) + np.repeat([[0, 0.001, 0], [0, 0, 0]], 20, 0)
    skin = replace(avatar.skin, joints=joints, weights=rigid)
    base = Splats.create(means, [[1, 0, 0, 0]] * 40, [[0.02] * 3] * 40, [0.9] * 40, rgb=[[0.5] * 3] * 40)
    few = merged(Avatar(base, avatar.skeleton, skin), 26)
    assert (few.skin.weights.max(axis=1) > 0.999).all()
