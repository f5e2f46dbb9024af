"""The face that people from photographs get: lids, teeth, lips' shade, and how the mouth's inside is coloured."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from glsplat import reference
from glsplat.authoring.faces.enamel import painted
from glsplat.authoring.faces.given import FACE_SPLATS, MovingFace, with_face
from glsplat.authoring.faces.lining import mouth_lining
from glsplat.authoring.faces.open_face import of_open_body, open_face, with_expressions
from glsplat.authoring.faces.shapes import with_shapes
from glsplat.authoring.faces.tiles import tiled
from glsplat.authoring.fit.body import open_body
from glsplat.authoring.visibility import EYES
from glsplat.avatar import Avatar
from glsplat.skinning.expression import ARKIT
from glsplat.skinning.pose import Pose
from glsplat.splats import SH_C0
from tests.authoring.faces.figures import avatar_on, face, person

STILL = np.zeros((55, 3))


@lru_cache(maxsize=1)
def bare() -> Avatar:
    return with_shapes(avatar_on(face().mesh), face().mesh)


@lru_cache(maxsize=1)
def faced() -> Avatar:
    return with_face(bare(), face(), len(bare().splats) + FACE_SPLATS)


def posed(**expression: float) -> reference.SkinnedSplats:
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


def test_nothing_is_behind_closed_lips_that_stands_out_of_them_and_no_splat_becomes_a_string() -> None:
    count = len(bare().splats)
    middle = face().mesh.vertices[mouth_lining().upper].mean(axis=0)
    rest, far = posed().means[count:], posed(jawOpen=1.0)
    mouth = np.linalg.norm(rest - middle, axis=1) < 0.03
    lips = face().mesh.vertices[np.flatnonzero(mouth_lining().lips)]
    assert mouth.sum() > 400 and rest[mouth, 2].max() < lips[:, 2].max() - 0.002
    size = [np.linalg.norm(one.shapes[count:][mouth], axis=1).max(axis=1) for one in (posed(), far)]
    assert (size[1] / size[0]).max() < 1.5


def test_teeth_are_told_apart_lighter_ahead_and_no_longer_than_crowns() -> None:
    parts = open_face()
    uv, texture = painted(parts.mouth, parts.faces, parts.tooth, parts.lower)
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


def test_each_tooth_is_a_grid_of_splats_on_its_front() -> None:
    parts = open_face()
    tiles = tiled(parts.mouth, parts.faces, parts.tooth, parts.lower)
    corners = parts.mouth[parts.faces[tiles.faces]]
    at = np.einsum("nk,nkc->nc", tiles.shares, corners)
    assert parts.tooth[tiles.faces].all() and (tiles.shares > -1e-6).all() and 300 < len(at) < 600
    vertices = np.unique(parts.faces[parts.tooth])
    far, every = (np.hypot(p[:, 0], p[:, 2] - 0.105) for p in (at, parts.mouth[vertices]))
    for place, out in zip(at[::7], far[::7], strict=True):  # nothing of a tooth is before it
        near = np.linalg.norm(parts.mouth[vertices] - place, axis=1) < 0.001
        assert not near.any() or every[near].max() < out + 0.001
    ahead = (np.abs(at[:, 0]) < 0.0065) & ~parts.lower[parts.faces[tiles.faces][:, 0]] & (tiles.solid > 0.9)
    rows = np.unique(np.rint(at[ahead, 1] * 1e4))
    assert ahead.sum() > 40 and len(rows) <= 8  # two incisors, tile beside tile
    assert (tiles.scales[ahead] > 0.0004).all() and (tiles.scales[ahead] < 0.0015).all()
    light = tiles.rgb.mean(axis=1)
    assert light[tiles.solid < 0.9].max() < 0.5 * light[ahead].min()  # the seams


def lit_by(white: float) -> float:
    """How light the teeth are of somebody whose eyeballs are so light."""
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


def test_the_mouth_of_a_photograph_without_colours_is_grey() -> None:
    """Everybody here is grey but for the eyes; with a red cheek the mouth is red as well."""
    count, middle = len(bare().splats), face().mesh.vertices[mouth_lining().upper].mean(axis=0)
    sh = bare().splats.sh.copy()
    sh[::5, 0] = (np.array([0.8, 0.5, 0.4]) - 0.5) / SH_C0
    colourful = with_face(replace(bare(), splats=replace(bare().splats, sh=sh)), face(), count + FACE_SPLATS)
    spread = []
    for made in (faced(), colourful):
        rgb = made.splats.sh[count:, 0] * SH_C0 + 0.5
        mouth = (np.linalg.norm(made.splats.means[count:] - middle, axis=1) < 0.025) & (rgb.mean(axis=1) > 0.12)
        assert mouth.sum() > 200
        spread.append(np.ptp(rgb[mouth], axis=1).max())
    assert spread[0] < 0.02 and spread[1] > 0.15


def test_a_tongue_that_is_put_out_parts_the_lips_and_hangs() -> None:
    mesh, body = face().mesh, open_body()
    moved = mesh.vertices + mesh.morphs.dense("tongueOut", len(mesh.vertices))
    straight = mesh.vertices + with_expressions(person(), of_open_body(mesh)).morphs.dense("tongueOut", len(moved))
    upper, lower = mouth_lining().upper, mouth_lining().lower
    gap = [at[upper, 1].max() - at[lower, 1].min() for at in (mesh.vertices, moved)]
    assert gap[1] > gap[0] + 0.004
    tip = np.flatnonzero(~body.skin)[straight[: len(body.skin)][~body.skin, 2].argmax()]
    assert moved[tip, 2] > mesh.vertices[lower, 2].max() + 0.005 and moved[tip, 1] < straight[tip, 1] - 0.01


def test_the_lining_is_what_nobody_sees_of_a_mouth_that_is_shut() -> None:
    body, lining = open_body(), mouth_lining()
    assert 300 < lining.inside.sum() < 600 and 0.08 < lining.far[lining.inside].max() < 0.11
    deep = body.vertices[lining.inside & (lining.far > 0.01)]
    lips = body.vertices[lining.lips]
    assert deep[:, 2].max() < lips[:, 2].max() - 0.004 and not (lining.lips & lining.inside).any()
    lowered = open_face().expressions.dense("jawOpen", len(body.vertices))[:, 1]
    assert lowered[lining.lower].max() < -0.01 and lowered[lining.upper].min() > 2 * lowered[lining.lower].max()
    rim = np.concatenate([lining.upper, lining.lower])
    assert not lining.far[rim].any() and np.ptp(body.vertices[rim, 0]) > 0.04


def test_lips_shade_what_is_behind_their_rims_and_go_with_them() -> None:
    made, count = faced(), len(bare().splats)
    rgb = made.splats.sh[count:, 0] * SH_C0 + 0.5
    veils = np.flatnonzero(np.abs(rgb - np.array((30, 10, 9)) / 255).max(axis=1) < 2e-3) + count
    assert len(veils) > 50 and made.shapes is not None
    assert not made.shapes.bends[np.isin(made.shapes.rows, veils)].any()
    moved = posed(jawOpen=1.0).means[veils] - posed().means[veils]
    assert moved[:, 1].min() < -0.012 and np.abs(moved[:, 1]).min() < 0.004  # the lower lip's, and the upper one's


def test_where_no_eye_is_seen_what_the_photograph_has_there_stays() -> None:
    avatar = bare()
    count = len(avatar.splats)
    made = with_face(avatar, face(), count + FACE_SPLATS, seen=False)
    balls = np.stack([eye.ball.centre for eye in face().eyes])
    about = (np.linalg.norm(avatar.splats.means[:, None] - balls, axis=2) < 0.034).any(axis=1)
    assert about.sum() > 100 and np.array_equal(made.splats.sh[:count][about], avatar.splats.sh[about])
    assert len(made.splats) == count + FACE_SPLATS
    rest = np.linalg.norm(made.splats.means[count:, None] - balls, axis=2).min(axis=1)
    dark = (made.splats.sh[count:, 0] * SH_C0 + 0.5).max(axis=1) < 0.1
    fine = made.splats.scales[count:].max(axis=1) > 0.0006
    assert not (dark & fine & (rest < 0.034) & (rest > 0.0155)).any()  # no lashes


def test_an_eye_that_is_shut_has_a_face_all_the_same() -> None:
    mesh = face().mesh
    shut = mesh.morphs.dense("eyeBlinkLeft", len(mesh.vertices))
    right = [eye for eye in face().eyes if "left" not in eye.ball.joint]
    blind = MovingFace(replace(mesh, vertices=mesh.vertices + shut), right)
    made = with_face(bare(), blind, len(bare().splats) + FACE_SPLATS)
    assert len(made.splats) == len(bare().splats) + FACE_SPLATS
