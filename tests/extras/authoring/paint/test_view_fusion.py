"""Colours of a body from many pictures: each place from the picture that sees it best, and evenly lit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from glsplat.extras.authoring.body.open_face import mouth_lining
from glsplat.extras.authoring.fit.offsets import face_vertices
from glsplat.extras.authoring.geometry.surface_points import SurfacePoints
from glsplat.extras.authoring.paint.view_fusion import fusion_of
from tests.extras.authoring.paint.scene import Scene, photographed

SIDES = ("front", "left", "back", "right")


def middles(scene: Scene) -> SurfacePoints:
    faces = scene.mesh.parts[0].faces.astype(np.intp)
    return SurfacePoints(faces, np.full((len(faces), 3), 1 / 3))


def test_shares_sum_to_the_visibility() -> None:
    scene = photographed(*SIDES)
    fusion = fusion_of(scene.body, scene.shots)
    assert np.allclose(fusion.shares.sum(axis=1), fusion.visibility) and fusion.shares.min() >= 0
    hidden = np.stack([shot.visibility for shot in scene.shots], axis=1) == 0
    assert (fusion.shares[hidden] == 0).all()
    assert (fusion.shares > 0.02).sum(axis=1).mean() < 1.6  # seams are narrow
    assert (fusion.visibility[scene.body.skin] < 0.1).mean() < 0.3


def test_each_place_comes_from_the_picture_that_sees_it_best() -> None:
    """Pictures in one plain colour each: a back is of the back's."""
    scene = photographed(*SIDES)
    plain = [np.full_like(shot.rgb, 0) for shot in scene.shots]
    for number, rgb in enumerate(plain):
        rgb[:] = 40 + 60 * number
    shots = [replace(shot, rgb=rgb) for shot, rgb in zip(scene.shots, plain, strict=True)]
    fusion = fusion_of(scene.body, shots)
    points = middles(scene)
    level = fusion.colours(points)[:, 0] * 255
    shown = scene.body.skin[points.corners].all(axis=1) & ~mouth_lining().inside[points.corners].any(axis=1)
    assert level[shown].min() > 36 and level.max() < 221  # the mouth's inside is darker than any of them
    square = np.stack([points.at(shot.squareness[:, None])[:, 0] for shot in shots])
    sure = (points.at(fusion.visibility[:, None])[:, 0] > 0.95) & (square.max(axis=0) > 0.97)
    assert sure.sum() > 1000
    wanted = 40 + 60 * square.argmax(axis=0)
    assert (np.abs(level - wanted)[sure] < 6).mean() > 0.9


def test_a_penalised_picture_loses_its_share() -> None:
    scene = photographed("front", "front", "back")
    even = fusion_of(scene.body, scene.shots).shares
    pairs = ([0, 0.2, 0], [0.2, 0, 0])
    first, second = (fusion_of(scene.body, scene.shots, penalties=penalties).shares for penalties in pairs)
    trunk = (scene.shots[0].visibility > 0.5) & ~face_vertices(scene.body) & (scene.body.vertices[:, 1] < 0.6)
    assert np.allclose(even[trunk, 0], even[trunk, 1], atol=1e-6)
    assert (first[trunk, 0] > 10 * first[trunk, 1]).all() and (second[trunk, 1] > 10 * second[trunk, 0]).all()


def test_unseen_surface_is_filled_smoothly() -> None:
    """From the front alone the back is as smooth as its edges are."""
    scene = photographed("front")
    fusion = fusion_of(scene.body, scene.shots)
    painted = fusion.paint(middles(scene))
    assert np.isfinite(painted.rgb).all() and painted.rgb.min() >= 0 and painted.rgb.max() <= 1
    assert painted.visibility.min() == 0 and painted.visibility.max() == 1
    assert 0 <= painted.detail.min() <= painted.detail.max() <= 1
    assert (fusion.colours(middles(scene)) == painted.rgb).all()
