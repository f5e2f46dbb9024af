"""Surfaces go with their splats through everything that is done to those."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

from glsplat.errors import FormatError
from glsplat.extras.authoring.finish.level_merge import merged
from glsplat.extras.authoring.geometry.posed import posed_splats
from glsplat.formats.transform import transformed
from glsplat.light.surface import Surface, decoded_shades, encoded_shades
from glsplat.scene import similarity
from glsplat.skinning.pose import Pose
from tests.light.lit import random_surface, surfaced
from tests.scenes import cloud, limb


def test_bytes_stand_for_normals_occlusion_and_shades() -> None:
    rng = np.random.default_rng(1)
    normals = rng.normal(size=(500, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    occlusion, shade = rng.random(500), rng.uniform(0.03, 3.5, (500, 3))
    surface = Surface.of(normals, occlusion, shade)
    assert (surface.units * normals).sum(axis=1).min() > np.cos(np.radians(0.5))
    assert np.abs(surface.ao - occlusion).max() <= 0.5 / 255 + 1e-9
    assert np.abs(np.log2(surface.shades / shade)).max() <= 1 / 64 + 1e-9
    assert surface.nbytes == 7 * 500 and Surface.of(normals, occlusion).shades.tolist() == np.ones((500, 3)).tolist()


def test_shades_beyond_a_byte_are_the_nearest() -> None:
    found = decoded_shades(encoded_shades(np.array([0.0, 1.0, np.nan, np.inf, 100.0])))
    assert found[1] == found[2] == 1 and found[0] == pytest.approx(1 / 64) and found[4] == found[3] < 4


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        (([[0, 0, 1]], [255, 0]), r"occlusion needs shape \(1,\)"),
        (([[0, 0]], [255]), r"normals needs shape \(1, 3\)"),
        (([[0, 0, 1]], [255], [[1, 2]]), r"shade needs shape \(1, 3\)"),
        (([[0, 0, 300]], [255]), "normals"),
        (([[0, 0, 0.5]], [255]), "normals"),
    ],
)
def test_what_is_no_surface_is_refused(arrays: tuple[object, ...], words: str) -> None:
    with pytest.raises(FormatError, match=words):
        Surface(*arrays)  # type: ignore[arg-type]


def test_splats_need_one_row_each() -> None:
    with pytest.raises(FormatError, match="one row a splat, not 4 for 5"):
        replace(cloud(5), surface=random_surface(4))
    with pytest.raises(FormatError, match="surface needs a Surface"):
        replace(cloud(5), surface="smooth")  # type: ignore[arg-type]


def test_take_replace_and_pickle_keep_it() -> None:
    splats = surfaced(cloud(50))
    few = splats.take([7, 3])
    assert few.surface.normals.tolist() == splats.surface.normals[[7, 3]].tolist()
    assert few.surface.shade.tolist() == splats.surface.shade[[7, 3]].tolist()
    assert replace(splats, antialias=True).surface is splats.surface
    again = pickle.loads(pickle.dumps(splats)).surface
    assert np.array_equal(again.occlusion, splats.surface.occlusion) and not again.normals.flags.writeable
    assert "surface" in repr(splats) and splats.nbytes == cloud(50).nbytes + 350
    avatar = surfaced(limb(60))
    assert all(part.splats.surface is not None for part in (avatar.without("joint3"), avatar.only("joint3")))


def test_normals_turn_with_the_splats() -> None:
    splats, turn = surfaced(cloud(200)), similarity((1, 2, 3), (0.1, 0.4, -0.3, 0.8), 1.7)
    made = transformed(splats, turn).surface
    wanted = splats.surface.units @ (turn[:3, :3] / 1.7).T
    assert np.abs(made.units - wanted).max() < 0.01
    squeezed = transformed(splats, np.diag([3.0, 1, 1, 1])).surface  # a plane's normal leans away from what grows
    leaning = splats.surface.units / (3, 1, 1)
    leaning /= np.maximum(np.linalg.norm(leaning, axis=1, keepdims=True), 1e-9)
    assert np.abs(squeezed.units - leaning).max() < 0.01
    avatar = surfaced(limb(100))
    posed = posed_splats(avatar, Pose(np.array([[0, 0, np.pi / 2], [0, 0, 0], [0, 0, 0], [0, 0, 0]]))).surface
    x, y, z = avatar.splats.surface.units.T
    assert np.abs(posed.units - np.stack([-y, x, z], axis=1)).max() < 0.01


def test_fewer_splats_take_the_surface_of_those_they_stand_for() -> None:
    splats = cloud(400, seed=2)
    away = splats.means / np.linalg.norm(splats.means, axis=1, keepdims=True)
    splats = replace(splats, surface=Surface.of(away.astype(float), np.full(400, 0.5), np.full((400, 3), 0.7)))
    few = merged(splats, 150)
    outside = np.linalg.norm(few.means, axis=1) > 0.4
    direction = few.means / np.linalg.norm(few.means, axis=1, keepdims=True)
    assert (few.surface.units * direction).sum(axis=1)[outside].min() > 0.7
    assert few.surface.ao == pytest.approx(np.full(150, 0.5), abs=0.01)
    assert few.surface.shades == pytest.approx(np.full((150, 3), 0.7), rel=0.02)


def test_of_several_things_those_without_have_none() -> None:
    part = random_surface(3, shaded=False)
    assert Surface.joined([None, None], [2, 3]) is None
    whole = Surface.joined([None, part, random_surface(2)], [2, 3, 2])
    assert whole is not None and len(whole) == 7 and not whole.normals[:2].any()
    assert whole.normals[2:5].tolist() == part.normals.tolist() and whole.shades[2:5].tolist() == [[1, 1, 1]] * 3
