"""The face that people from photographs get: lids, teeth, lips' shade, and how the mouth's inside is coloured."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from glsplat import reference
from glsplat.avatar import Avatar
from glsplat.extras.authoring.body.open_face import mouth_lining, open_face
from glsplat.extras.authoring.body.teeth import paint_teeth
from glsplat.extras.authoring.faces.moving_face import FACE_SPLATS, with_face
from glsplat.extras.authoring.geometry.mesh_shapes import with_shapes
from glsplat.extras.authoring.geometry.visibility import EYES
from glsplat.skinning.expression import ARKIT
from glsplat.skinning.pose import Pose
from glsplat.splats import SH_C0
from tests.extras.authoring.faces.figures import avatar_on, face

STILL = np.zeros((55, 3))


@lru_cache(maxsize=1)
def bare() -> Avatar:
    return with_shapes(avatar_on(face().mesh), face().mesh)


@lru_cache(maxsize=1)
def faced() -> Avatar:
    return with_face(bare(), face(), len(bare().splats) + FACE_SPLATS)


def posed(**expression: float) -> reference.Posed:
    made = faced()
    weights = made.shapes.weights(expression)
    bones = Pose(STILL).bones(made.skeleton)
    return reference.skin(made.splats, made.skin, bones, shapes=made.shapes, expression=weights)


def test_a_person_from_a_photograph_gets_52_shapes_and_keeps_every_splat_but_about_eyes_and_in_the_mouth() -> None:
    avatar, made = bare(), faced()
    count = len(avatar.splats)
    assert len(made.splats) == count + FACE_SPLATS
    for key in ("means", "quats", "scales", "opacities"):
        assert np.array_equal(getattr(made.splats, key)[:count], getattr(avatar.splats, key))
    means = avatar.splats.means
    balls = np.stack([eye.ball.centre for eye in face().eyes])
    about = (np.linalg.norm(means[:, None] - balls, axis=2) < 0.034).any(axis=1)
    darker = np.flatnonzero(np.any(made.splats.sh[:count] != avatar.splats.sh, axis=(1, 2)) & ~about)
    assert 0 < len(darker) < 0.05 * count and (made.splats.sh[darker] <= avatar.splats.sh[darker]).all()
    rim = face().mesh.vertices[mouth_lining().upper]
    assert (means[darker, 2] < rim[:, 2].max() + 0.001).all()  # of the mouth's inside
    assert made.shapes is not None and sorted(made.shapes.names) == sorted(ARKIT)
    assert set(np.unique(made.shapes.targets)) == set(range(52))
    again = with_face(avatar, face(), count + FACE_SPLATS)
    assert again.splats.means.tobytes() == made.splats.means.tobytes()


def test_nothing_pokes_through_closed_lips_and_no_splat_becomes_a_string() -> None:
    count = len(bare().splats)
    middle = face().mesh.vertices[mouth_lining().upper].mean(axis=0)
    rest, far = posed().means[count:], posed(jawOpen=1.0)
    mouth = np.linalg.norm(rest - middle, axis=1) < 0.03
    lips = face().mesh.vertices[np.flatnonzero(mouth_lining().lips)]
    assert mouth.sum() > 400 and rest[mouth, 2].max() < lips[:, 2].max() - 0.002
    size = [np.linalg.norm(one.shapes[count:][mouth], axis=1).max(axis=1) for one in (posed(), far)]
    assert (size[1] / size[0]).max() < 1.5


def test_teeth_are_separate_brighter_in_front_and_no_longer_than_crowns() -> None:
    parts = open_face()
    uv, texture = paint_teeth(parts.mouth, parts.faces, parts.tooth, parts.lower)
    high, wide = texture.shape[:2]
    column = np.clip((uv[..., 0] * wide).astype(int), 0, wide - 1)
    row = np.clip(((1 - uv[..., 1]) * high).astype(int), 0, high - 1)
    light = texture[row, column, :3].astype(float).mean(axis=2).mean(axis=1)
    middle = parts.mouth[parts.faces].mean(axis=1)
    ahead = parts.tooth & (np.abs(middle[:, 0]) < 0.005)
    aside = parts.tooth & (np.abs(middle[:, 0]) > 0.018)
    assert light[ahead].mean() > 1.8 * light[aside].mean()
    between = ahead & (np.abs(middle[:, 0]) < 0.0006)
    inside = ahead & (np.abs(np.abs(middle[:, 0]) - 0.0034) < 0.001)
    assert light[between].mean() < 0.9 * light[inside].mean()
    crown = parts.tooth & (uv[..., 1].max(axis=1) < 1)
    upper = crown & ~parts.lower[parts.faces].any(axis=1) & (np.abs(middle[:, 0]) < 0.006)
    assert 0.006 < np.ptp(parts.mouth[parts.faces[upper], 1]) < 0.0105
    red, blue = texture[..., 0].astype(int), texture[..., 2].astype(int)
    assert (np.abs(red - blue).max() < 90) and texture[..., :3].max() < 226  # no white


def lit_by(white: float) -> float:
    """Return the brightness of the teeth for eyeballs of this brightness."""
    sh = bare().splats.sh.copy()
    ball = np.isin(bare().skin.joints[:, 0], [bare().skeleton.names.index(name) for name in EYES])
    assert ball.sum() > 5
    sh[ball, 0] = (white - 0.5) / SH_C0
    made = with_face(replace(bare(), splats=replace(bare().splats, sh=sh)), face(), len(sh) + FACE_SPLATS).splats
    middle = face().mesh.vertices[mouth_lining().upper].mean(axis=0)
    mouth = np.linalg.norm(made.means[len(sh) :] - middle, axis=1) < 0.025
    return float(np.quantile((made.sh[len(sh) :, 0] * SH_C0 + 0.5).mean(axis=1)[mouth], 0.98))


@pytest.mark.check
def test_teeth_are_as_light_as_the_whites_of_the_eyes() -> None:
    bright, dim, dark = (lit_by(white) for white in (0.9, 0.5, 0.05))
    assert 0.75 < bright < 0.88
    assert 0.6 < dim / bright < 0.8 and 0.5 < dark / bright < 0.6


def test_lip_shadows_lie_behind_the_rims_and_move_with_the_lips() -> None:
    made, count = faced(), len(bare().splats)
    rgb = made.splats.sh[count:, 0] * SH_C0 + 0.5
    veils = np.flatnonzero(np.abs(rgb - np.array((30, 10, 9)) / 255).max(axis=1) < 2e-3) + count
    assert len(veils) > 50 and made.shapes is not None
    assert not made.shapes.bends[np.isin(made.shapes.rows, veils)].any()
    moved = posed(jawOpen=1.0).means[veils] - posed().means[veils]
    assert moved[:, 1].min() < -0.012 and np.abs(moved[:, 1]).min() < 0.004  # the lower lip's, and the upper one's


def test_without_visible_eyes_the_photographs_splats_stay() -> None:
    avatar = bare()
    count = len(avatar.splats)
    made = with_face(avatar, face(), count + FACE_SPLATS, eyes_visible=False)
    balls = np.stack([eye.ball.centre for eye in face().eyes])
    about = (np.linalg.norm(avatar.splats.means[:, None] - balls, axis=2) < 0.034).any(axis=1)
    assert about.sum() > 100 and np.array_equal(made.splats.sh[:count][about], avatar.splats.sh[about])
    assert len(made.splats) == count + FACE_SPLATS
    rest = np.linalg.norm(made.splats.means[count:, None] - balls, axis=2).min(axis=1)
    dark = (made.splats.sh[count:, 0] * SH_C0 + 0.5).max(axis=1) < 0.1
    fine = made.splats.scales[count:].max(axis=1) > 0.0006
    assert not (dark & fine & (rest < 0.034) & (rest > 0.0155)).any()  # no lashes
