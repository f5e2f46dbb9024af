"""Each splat's share of a picture is the same compiled and in numpy; useless cones are dropped."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from glsplat.extras.authoring.finish.cones import (
    ConeConfig,
    _far_camera,
    _weigher,
    with_cones,
    without_useless_cones,
)
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.skin import strongest_joint
from glsplat.splats import Splats
from tests.extras.authoring.optimize.figures import start
from tests.extras.authoring.optimize.without import without_numba
from tests.scenes import cloud, limb


@pytest.fixture
def scene() -> Splats:
    """Return unordered splats of all opacities, some with negative scales."""
    splats = cloud(1500, spread=0.3)
    sign = np.random.default_rng(4).choice([-1, 1], (1500, 3))
    return replace(splats, scales=splats.scales * sign, antialias=True)  # cones are made without


def test_weights_equal_numpy(scene: Splats, monkeypatch: pytest.MonkeyPatch) -> None:
    compiled = _weigher(len(scene))
    without_numba(monkeypatch)
    computed = _weigher(len(scene))
    for direction in ((0.0, 0, 1), (0.6, 0, -0.8), (0, 0.8, 0.6)):
        camera = _far_camera(scene, np.array(direction), 160)
        found, expected = compiled(scene, camera), computed(scene, camera)
        seen = expected > 1  # pixel; what passes less than a ten thousandth is not drawn
        assert 0.3 < seen.mean() < 1 and np.abs(found - expected)[~seen].max() < 2e-3
        np.testing.assert_allclose(found[seen], expected[seen], rtol=1e-3)


@pytest.mark.parametrize("hiding", [0.0, 0.01, 0.5])
def test_cones_that_hide_hardly_any_splat_are_dropped(hiding: float) -> None:
    avatar = start()
    cones = np.tile(np.array([0, 0, 127, -127], np.int8), (len(avatar.splats), 1))
    cones[: round(hiding * len(cones)), 3] = 0
    kept = without_useless_cones(replace(avatar, splats=replace(avatar.splats, cones=cones, cones_psnr=50.0))).splats
    assert (kept.cones is None, kept.cones_psnr) == ((False, 50.0) if hiding > 0.1 else (True, None))


def test_heads_are_always_drawn() -> None:
    avatar = limb(2000)
    bones = avatar.skeleton
    avatar = replace(avatar, skeleton=Skeleton.from_joints((*bones.names[:-1], "head"), bones.parents, bones.joints))
    few = ConeConfig(directions=16, poses=2, size=64, choosing=2, tests=2, rounds=1, test_size=64, psnr=25.0)
    made = with_cones(avatar, few).splats
    assert made.cones is not None
    everywhere = made.cones[:, 3] == -127
    head = avatar.skeleton.under("head")[strongest_joint(avatar.skin.joints, avatar.skin.weights)]
    assert head.any() and everywhere[head].all() and not everywhere[~head].all()
