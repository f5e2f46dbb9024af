"""What a first fit did not see of a body is closed, and its head stays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from glsplat import reference
from glsplat.authoring.optimize.pictures import ViewConfig
from glsplat.skinning.skin import strongest_joint
from tests.authoring.optimize.figures import camera_at, mesh, start
from tools.data.around import fitted_around

VIEWS = ViewConfig(body=10, poses=0, size=96, up=(-75, 0, 75))


@pytest.mark.check
@pytest.mark.parametrize("head", [False, True])
def test_a_gap_that_shows_from_above_alone_closes_but_in_a_head(head: bool) -> None:
    figure, avatar = mesh(), start()
    if head:  # the joint that moves the upper half
        names = (figure.skeleton.names[0], "head")
        figure = replace(figure, skeleton=replace(figure.skeleton, names=names))
        avatar = replace(avatar, skeleton=figure.skeleton)
    upper = strongest_joint(avatar.skin.joints, avatar.skin.weights) == 1
    thin = np.array(avatar.splats.opacities)
    thin[upper] = 0.05
    before = replace(avatar, splats=replace(avatar.splats, opacities=thin))
    after = fitted_around(before, figure, views=VIEWS, steps=120)
    above = camera_at((0.2, 2.4, 0.1))
    alpha = [reference.render(one.splats.take(upper), [above])[0][36:44, 36:44, 3] for one in (before, after)]
    assert alpha[0].mean() < 0.3
    assert alpha[1].mean() == alpha[0].mean() if head else alpha[1].min() > 0.5  # in 120 steps
    same = (after.splats.means == before.splats.means).all(axis=1) & (after.splats.opacities == thin)
    assert same[upper].all() == head and not same[~upper].any()
    assert len(after.splats) == len(before.splats) and after.splats.cones is None
