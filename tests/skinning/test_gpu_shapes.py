"""Expressions in the skin pass: against the float64 reference, and nothing at all where no weight is set."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from glsplat import reference
from glsplat.config import RenderConfig
from glsplat.errors import ContextError
from glsplat.gl.context import Context
from glsplat.renderer import Renderer, stage
from glsplat.skinning.pose import Pose
from glsplat.skinning.shapes import Shapes
from glsplat.splats import Level
from tests.compare import assert_contract
from tests.scenes import camera, limb
from tests.skinning.avatars import VIEW, covariances
from tests.skinning.faces import NAMES, expressive

pytestmark = pytest.mark.gl

Make = Callable[..., Renderer]
FACE = {"jawOpen": 0.7, "eyeBlinkLeft": 1.0, "browInnerUp": 0.1}
EXACT = RenderConfig(target="32f", output="float32")


def turned(expression: dict[str, float] | None = None) -> Pose:
    return Pose(np.full((4, 3), 0.2), (0.1, 0, 0), expression=expression)


@pytest.mark.parametrize("influences", [1, 2, 4, 8])
@pytest.mark.parametrize("rotation", ["polar", "raw"])
def test_splats_are_where_the_reference_has_them(renderer_of: Make, influences: int, rotation: str) -> None:
    avatar, pose = expressive(5000, influences), turned(FACE)
    renderer = renderer_of(avatar, (1, 1), rotation=rotation)
    renderer.render([VIEW], pose)
    means, shapes = renderer.posed()
    bones, weights = pose.bones(avatar.skeleton), avatar.weights(pose)
    wanted = reference.skin(avatar.splats, avatar.skin, bones, rotation, avatar.shapes, weights)
    still = reference.skin(avatar.splats, avatar.skin, bones, rotation)
    assert np.abs(means - wanted.means).max() < 1e-6
    assert np.abs(wanted.means - still.means).max() > 0.02  # it moves something
    expected = covariances(wanted.shapes)
    scale = np.linalg.norm(expected, axis=(1, 2))
    assert (np.linalg.norm(covariances(shapes) - expected, axis=(1, 2)) / scale).max() < 1e-5


@pytest.mark.parametrize("degree", [0, 2])
def test_pictures_are_those_of_the_reference(renderer_of: Make, degree: int) -> None:
    avatar, pose, view = expressive(400, degree=degree), turned(FACE), camera(96, 2.5)
    image = renderer_of(avatar, (96, 96)).render([view], pose)
    weights = avatar.weights(pose)
    bones = pose.bones(avatar.skeleton)
    wanted = reference.render(
        avatar.splats, [view], avatar.skin, bones, EXACT, shapes=avatar.shapes, expression=weights
    )
    assert_contract(image, wanted)
    error = 10 * np.log10(1 / ((image - wanted)[..., :3] ** 2).mean())
    assert error >= 100, error


@pytest.mark.parametrize("weights", [{}, dict.fromkeys(NAMES, 0.0), {"jawOpen": -1.0}, {"another": 1.0}])
def test_no_weight_is_the_same_bytes(renderer_of: Make, weights: dict[str, float]) -> None:
    avatar, view = expressive(), camera(96, 2.5)
    renderer = renderer_of(avatar, (96, 96))
    still = renderer_of(replace(avatar, shapes=None), (96, 96)).render([view], turned()).copy()
    moved = renderer.render([view], turned(FACE)).copy()
    assert not np.array_equal(moved, still)
    assert np.array_equal(renderer.render([view], turned(weights)), still)  # also after a frame with an expression
    assert np.array_equal(renderer.render([view], turned(FACE)), moved)


def test_a_still_face_compiles_and_binds_nothing(renderer_of: Make) -> None:
    renderer = renderer_of(expressive(), (32, 32))
    renderer.render([camera(32)], turned())
    programs = len(renderer._programs)
    renderer.render([camera(32)], turned({"jawOpen": 0.0}))
    assert len(renderer._programs) == programs
    renderer.render([camera(32)], turned(FACE))
    assert len(renderer._programs) == programs + 1


def test_a_new_expression_poses_anew_and_the_same_does_not(renderer_of: Make) -> None:
    renderer, view = renderer_of(expressive(), (32, 32)), camera(32)
    runs = []
    for face in (FACE, FACE, {}, FACE):
        renderer.render([view], turned(face))
        runs.append(renderer.stats.posed)
    assert runs == [1, 0, 1, 1]


def test_splats_that_are_never_drawn_take_their_entries_along(renderer_of: Make) -> None:
    avatar, pose = expressive(800), turned(FACE)
    means = avatar.splats.means.copy()
    means[::7] = np.nan
    broken = replace(avatar, splats=replace(avatar.splats, means=means))
    renderer = renderer_of(broken, (1, 1))
    renderer.render([VIEW], pose)
    found, _ = renderer.posed()
    bones, weights = pose.bones(avatar.skeleton), avatar.weights(pose)
    wanted = reference.skin(avatar.splats, avatar.skin, bones, "polar", avatar.shapes, weights)
    assert np.abs(found - np.delete(wanted.means, np.s_[::7], axis=0)).max() < 1e-6


def test_levels_move_with_the_face_or_keep_still(renderer_of: Make) -> None:
    avatar = expressive(600)
    coarse = expressive(200)
    coarse = replace(coarse, skeleton=avatar.skeleton)
    view = camera(64, 2.5)
    for content in (coarse, replace(coarse, shapes=None)):
        whole = replace(avatar, levels=(Level(content, 50.0),))
        renderer = renderer_of(whole, (64, 64), level=1)
        alone = renderer_of(content, (64, 64))
        for face in (FACE, None):
            assert np.array_equal(renderer.render([view], turned(face)).copy(), alone.render([view], turned(face)))


def test_more_entries_than_a_texture_holds(
    renderer_of: Make, context: Context, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stage, "_ENTRIES_PER_ROW", 1)
    count = context.ctx.info["GL_MAX_TEXTURE_SIZE"] + 1
    shapes = Shapes.create(
        ["grin"], count, splats=np.arange(count), targets=np.zeros(count, int), moves=np.ones((count, 3))
    )
    with pytest.raises(ContextError, match=f"{count} entries of shapes, but this driver's textures hold {count - 1}"):
        renderer_of(replace(limb(count), shapes=shapes), (1, 1))
