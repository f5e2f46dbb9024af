"""Skins of whatever numbers a program has: they bend as they should, or are refused in one line."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import glsplat
from glsplat import Avatar, Camera, Pose, Skin, Splats
from tests.api.test_values import QUAT, VIEW, K, one_splat, refused, two_bones

# --------------------------------------------------------------------------------------------------------- skins


def test_a_skin_of_numpys_default_types_bends_like_the_same_in_the_renderers(renderer_of: Any) -> None:
    rng = np.random.default_rng(3)
    n, camera = 200, Camera(glsplat.look_at((0, 0.7, 4), (0, 0.7, 0)), K, 64, 64)
    splats = Splats.create(
        rng.uniform((-0.3, 0, -0.3), (0.3, 1.5, 0.3), (n, 3)), np.tile(QUAT, (n, 1)), np.full((n, 3), 0.05), np.ones(n),
        rgb=rng.random((n, 3)),
    )  # fmt: skip
    ids = rng.integers(0, 2, (n, 4))
    weights = rng.random((n, 4))
    pose = Pose([[0, 0, 0.4], [0.3, 0, -0.9]])
    total = weights / weights.sum(axis=1, keepdims=True)
    exact = Skin(ids.astype(np.uint16), total.astype(np.float32))
    expected = renderer_of(Avatar(splats, two_bones(), exact)).render([camera], pose)
    for skin in (Skin(ids, weights), Skin(ids.tolist(), weights.tolist()), Skin(ids.astype(np.int32), 7 * weights)):
        assert renderer_of(Avatar(splats, two_bones(), skin)).render([camera], pose) == pytest.approx(
            expected, abs=2e-5
        )
    assert not np.allclose(renderer_of(Avatar(splats, two_bones(), exact)).render([camera]), expected)


@pytest.mark.parametrize(("given", "slots"), [(1, 1), (2, 2), (3, 4), (4, 4), (5, 8), (7, 8), (8, 8)])
def test_any_number_of_influences_up_to_eight(renderer_of: Any, given: int, slots: int) -> None:
    rng = np.random.default_rng(given)
    ids, weights = rng.integers(0, 2, (5, given)), rng.random((5, given))
    skin = Skin(ids, weights)
    assert skin.influences == slots
    wanted = np.zeros((5, 2))
    np.add.at(wanted, (np.arange(5)[:, None], ids), weights / weights.sum(axis=1, keepdims=True))
    assert skin.dense(2) == pytest.approx(wanted, abs=1e-6)
    splats = Splats.create(
        np.zeros((5, 3)), np.tile(QUAT, (5, 1)), np.full((5, 3), 0.1), np.ones(5), rgb=np.ones((5, 3))
    )
    assert renderer_of(Avatar(splats, two_bones(), skin)).render([Camera(VIEW, K, 64, 64)]).any()


def test_skins_that_mean_nothing_are_refused() -> None:
    refused(lambda: Skin([[70000]], [[1.0]]), "65535", "70000")
    refused(lambda: Skin([[-1]], [[1.0]]), "65535")
    refused(lambda: Skin([[0.5]], [[1.0]]), "whole numbers")
    refused(lambda: Skin.create([[0.5]], [[1.0]], 2), "whole numbers")
    for weight in (np.nan, np.inf, -0.25):
        refused(lambda weight=weight: Skin([[0, 1]], [[0.5, weight]]), "Skin.create")  # type: ignore[misc]
    refused(lambda: Skin([[0, 1], [0, 1]], [[1, 0], [0, 0]]), "splat 1 has no weight")
    refused(lambda: Skin(np.zeros((1, 9), int), np.ones((1, 9))), "influences=8")
    refused(lambda: Skin([[0, 1]], [[1.0]]), "one shape")
    assert Skin([[1, 65535]], [[1.0, 0.0]]).joints.tolist() == [[1, 1]]  # binds nothing, so it names nothing


def test_a_skin_that_is_right_already_keeps_its_bits() -> None:
    skin = glsplat.default_avatar().skin
    again = Skin(skin.joints.copy(), skin.weights.copy())
    assert np.array_equal(again.joints, skin.joints) and again.weights.tobytes() == skin.weights.tobytes()


def test_an_avatar_of_other_things_is_refused() -> None:
    splats, skeleton, skin = one_splat(), two_bones(), Skin([[0]], [[1.0]])
    refused(lambda: Avatar(skin, skeleton, splats), "splats needs Splats")  # type: ignore[arg-type]
    refused(lambda: Avatar(splats, None, skin), "skeleton needs Skeleton")  # type: ignore[arg-type]
    refused(lambda: Avatar(splats, skeleton, skin, "me"), "meta needs Mapping")  # type: ignore[arg-type]
    note = {"source": "a"}
    avatar = Avatar(splats, skeleton, skin, note)
    note["source"] = "b"
    assert avatar.meta["source"] == "a"
