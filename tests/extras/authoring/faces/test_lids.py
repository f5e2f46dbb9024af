"""Lids of people from photographs: folded away at rest, skin before the eye when it shuts."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from glsplat import reference
from glsplat.avatar import Avatar
from glsplat.extras.authoring.faces.eyes import EYEBALL_RETREAT_M, Eyeball, Opening, fit_eyeballs, lid_edges
from glsplat.extras.authoring.faces.lashes import LASH_SPLATS, with_lashes
from glsplat.extras.authoring.faces.lids import lid_colours, with_lids
from glsplat.extras.authoring.geometry.mesh_shapes import with_shapes
from glsplat.skinning.pose import Pose
from glsplat.splats import SH_C0, Splats
from tests.extras.authoring.faces.figures import avatar_on, face

STILL = np.zeros((55, 3))
SKIN = np.array([0.7, 0.5, 0.4])


def eyes() -> list[Opening]:
    return face().eyes


@lru_cache(maxsize=1)
def painted() -> Avatar:
    """Skin below the eyes' middle a little redder than above, dark brows, white eyes and blue lids."""
    mesh = face().mesh
    avatar = with_shapes(avatar_on(mesh, 3000), mesh)
    splats, means = avatar.splats, avatar.splats.means.astype(np.float64)
    rgb = np.tile(SKIN, (len(means), 1))
    for ball in fit_eyeballs(mesh):
        ways = means - ball.centre
        far = np.linalg.norm(ways, axis=1)
        rgb[(ways[:, 1] < 0) & (far < 0.05)] += (0.06, 0, 0)
        rgb[(far < 0.05) & (ways[:, 1] > 0.02)] = (0.1, 0.05, 0.05)
        side, up = np.degrees(np.arctan2(ways[:, 0], ways[:, 2])), np.degrees(np.arcsin(ways[:, 1] / far))
        rgb[(far < 1.5 * ball.radius) & (np.abs(side) < 35) & (np.abs(up + 4) < 14)] = (0.1, 0.2, 0.9)
    made = Splats.create(splats.means, splats.quats, splats.scales, splats.opacities, rgb=rgb)
    return replace(avatar, splats=made)


@lru_cache(maxsize=1)
def lidded() -> Avatar:
    return with_lids(painted(), face().mesh, eyes(), range(0))


def shut(much: float) -> reference.Posed:
    return winking(lidded(), much)


def winking(made: Avatar, much: float) -> reference.Posed:
    weights = made.shapes.weights({"eyeBlinkLeft": much, "eyeBlinkRight": much})
    bones = Pose(STILL).bones(made.skeleton)
    return reference.skin(made.splats, made.skin, bones, shapes=made.shapes, expression=weights)


def opening(ball: Eyeball) -> np.ndarray:
    """[N, 3] unit ways from the eye's middle within the opening of its lids."""
    edges = lid_edges(face().mesh, ball, 0.9)
    side, share = np.meshgrid(edges.side[3:-3:3], [0.1, 0.5, 0.9])
    upper, lower = (np.interp(side, np.sort(edges.side), e[np.argsort(edges.side)]) for e in (edges.upper, edges.lower))
    up = lower + share * (upper - lower)
    return np.stack([np.cos(up) * np.sin(side), np.sin(up), np.cos(up) * np.cos(side)], axis=2).reshape(-1, 3)


def test_an_eye_that_is_shut_is_covered_by_skin_and_an_open_one_is_not() -> None:
    ball = eyes()[1].ball
    count = len(painted().splats)
    solid = lidded().splats.opacities[count:] > 0.7
    ways = opening(ball)
    nearest = []
    for much in (0.0, 1.0):
        posed = shut(much)
        means, size = posed.means[count:][solid] - ball.centre, np.linalg.norm(posed.shapes[count:][solid], axis=1)
        far = np.linalg.norm(means, axis=1)
        before = far > ball.radius if not much else np.ones(len(far), bool)  # inside the eye nothing is visible
        apart = np.linalg.norm(ways[:, None] * far[None, before, None] - means[before], axis=2)
        nearest.append((apart / np.maximum(size[before].max(axis=1), 1e-9)).min(axis=1))
        if much:
            assert far[far < 0.03].min() > ball.radius + EYEBALL_RETREAT_M[2]  # before the eye, which draws back
    assert nearest[1].max() < 1.5  # standard deviations: something lies over every place
    lower = nearest[0][: len(ways) * 2 // 3]  # just below an upper lid's edge its own skin may be
    assert lower.min() > 1.5 and np.median(lower) > 5


def test_a_lid_that_is_half_shut_is_before_the_eye_and_ends_above_the_lower_one() -> None:
    count, half = len(painted().splats), shut(0.5).means
    rest, whole = shut(0.0).means, shut(1.0).means
    for ball, edges in eyes():
        mine = np.flatnonzero(np.linalg.norm(whole[count:] - ball.centre, axis=1) < 0.03) + count
        upper = mine[(whole - rest)[mine, 1] < -0.003]  # the splats that come down
        assert len(upper) > 50
        ways = half[upper] - ball.centre
        assert np.linalg.norm(ways, axis=1).min() > ball.radius + 0.5 * EYEBALL_RETREAT_M[2] - 0.001
        assert np.median(edges.above(ways)[0]) > np.radians(4)
        assert (rest[mine, 1] - whole[mine, 1]).max() > 0.005


def test_a_lid_has_the_hue_of_the_skin_around_it_and_not_of_eyes_or_brows() -> None:
    ball, _edges = eyes()[0]
    count = len(painted().splats)
    rgb = lidded().splats.sh[count:, 0].astype(np.float64) * SH_C0 + 0.5
    skin = rgb.sum(axis=1) > 0.9  # not the lashes
    assert 400 < skin.sum() < len(rgb) - 50
    hue = rgb[skin] / rgb[skin].mean(axis=1, keepdims=True)
    above, below = SKIN / SKIN.mean(), (SKIN + (0.06, 0, 0)) / (SKIN + (0.06, 0, 0)).mean()
    assert (hue > np.minimum(above, below) - 0.03).all() and (hue < np.maximum(above, below) + 0.03).all()
    light = rgb[skin].mean(axis=1) / SKIN.mean()
    assert 0.74 < light.min() < 0.9 and light.max() < 1.06 and light.std() > 0.015  # not one even patch
    ways = np.array([np.linspace(-0.002, 0.002, 9) * 0, np.linspace(-0.004, 0.009, 9), np.full(9, 0.018)]).T
    across = lid_colours(painted().splats, ball.centre + ways, eyes()[0]).mean(axis=1)
    assert across.min() < 0.93 * across.max()  # a crease above, or the shade of lashes below


def test_covered_splats_shrink_and_a_lash_line_appears_where_the_lids_meet() -> None:
    count, made = len(painted().splats), lidded()
    rest, whole = shut(0.0), shut(1.0)
    size = [np.linalg.norm(one.shapes[:count], axis=1).max(axis=1) for one in (rest, whole)]
    dark = made.splats.sh[count:, 0].sum(axis=1) * SH_C0 + 1.5 < 0.9
    for ball, edges in eyes():
        ways = whole.means[:count] - ball.centre
        under = (np.linalg.norm(ways, axis=1) < 0.02) & (edges.beyond(ways) == 0) & (ways[:, 2] > 0)
        assert under.any() and (size[1][under] < 0.5 * size[0][under]).all()
        line = whole.means[count:][dark] - ball.centre
        line = line[np.linalg.norm(line, axis=1) < 0.03]
        low, _, aside = edges.above(line)
        assert len(line) > 20 and np.quantile(np.abs(low[aside < -0.2]), 0.9) < np.radians(8)
        assert np.ptp(line[:, 0]) > 0.012


def test_other_splats_stay_and_without_visible_skin_lids_are_grey() -> None:
    count = len(painted().splats)
    for key in ("means", "quats", "scales", "opacities", "sh"):
        assert np.array_equal(getattr(lidded().splats, key)[:count], getattr(painted().splats, key))
    again = with_lids(painted(), face().mesh, eyes(), range(0))
    assert again.splats.means.tobytes() == lidded().splats.means.tobytes()
    gone = replace(painted().splats, means=np.full_like(painted().splats.means, 50.0))
    bare = with_lids(replace(painted(), splats=gone), face().mesh, eyes(), range(0))
    grey = bare.splats.sh[count:, 0]
    assert np.ptp(grey, axis=1).max() < 0.2 and np.median(np.abs(grey)) < 0.6


def test_lashes_come_before_the_lid_and_turn_down() -> None:
    bare = painted()
    given = with_lashes(bare, face().mesh, eyes())
    first, end = len(bare.splats), len(bare.splats) + LASH_SPLATS * len(eyes())
    made = with_lids(given, face().mesh, eyes(), range(first, end))
    posed = [winking(made, much).means for much in (0.0, 1.0)]
    for ball, edges in eyes():
        ways = [at[first:end] - ball.centre for at in posed]
        upper = (np.linalg.norm(ways[0], axis=1) < 0.03) & (edges.above(ways[0])[1] > np.radians(2))
        lid = posed[1][end:] - ball.centre
        lid = lid[np.linalg.norm(lid, axis=1) < 0.03]
        assert upper.sum() > 30
        assert np.median(np.linalg.norm(ways[1][upper], axis=1)) > np.median(np.linalg.norm(lid, axis=1)) + 0.001
        assert np.median(edges.above(ways[1][upper])[0]) < np.radians(2)  # from where the lids meet downwards
