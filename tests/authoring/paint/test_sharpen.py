"""Splats: as many as asked for, and in the colours that give back the picture."""

from __future__ import annotations

import numpy as np
import pytest

from glsplat.authoring.paint.paint import paint
from glsplat.authoring.paint.scatter import scatter
from glsplat.authoring.paint.sharpen import _equations, sharpened
from glsplat.splats import SH_C0
from tests.authoring.paint.scene import photographed


@pytest.mark.check
@pytest.mark.check
def test_the_picture_comes_back() -> None:
    scene = photographed("front")
    rng = np.random.default_rng(0)
    strewn = scatter(scene.mesh, 3000, rng)
    painted = paint(scene.body, scene.shots, strewn.points)
    avatar = strewn.avatar(scene.mesh, painted.rgb, painted.busy, rng)
    assert 0.99 * 3000 < len(avatar.splats) <= 3000
    assert np.isfinite(avatar.splats.means).all() and np.isfinite(avatar.splats.scales).all()
    matrix, target = _equations(avatar, scene.shots[0])

    def miss(colours: np.ndarray) -> float:
        return float(np.sqrt(((matrix @ (colours[:, 0] * SH_C0 + 0.5) - target) ** 2).mean()))

    sharp = sharpened(avatar, scene.shots, 8)
    assert miss(sharp.splats.sh) < 0.6 * miss(avatar.splats.sh)
    hidden = np.asarray(matrix.sum(axis=0)).ravel() < 0.1  # pixels
    change = np.abs(sharp.splats.sh - avatar.splats.sh)[:, 0].max(axis=1) * SH_C0
    assert hidden.mean() > 0.1
    assert change[hidden].max() < 0.1 and change[~hidden].max() > 0.15
    np.testing.assert_array_equal(sharp.splats.means, avatar.splats.means)
