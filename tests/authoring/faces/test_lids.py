"""Lids of people from photographs: folded away at rest, skin before the eye when it shuts."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from glsplat import reference
from glsplat.authoring.faces.eyeballs import Eyeball, eyeballs
from glsplat.authoring.faces.lids import ShutLid, shut_lids, with_lids
from glsplat.authoring.faces.open_face import with_expressions
from glsplat.authoring.faces.shapes import with_shapes
from glsplat.authoring.faces.trimmings import lid_edges
from glsplat.avatar import Avatar
from glsplat.meshes import RiggedMesh
from glsplat.skinning.pose import Pose
from glsplat.splats import SH_C0, Splats
from tests.authoring.faces.figures import avatar_on, person

STILL = np.zeros((55, 3))
SKIN = np.array([0.7, 0.5, 0.4])


@lru_cache(maxsize=1)
def expressive() -> RiggedMesh:
    mesh = person()
    return with_expressions(mesh, np.arange(len(mesh.vertices)))


@lru_cache(maxsize=1)
def painted() -> Avatar:
    """Skin below the eyes' middle a little redder than above, dark brows, white eyes and what lies on lids blue."""
    mesh = expressive()
    avatar = with_shapes(avatar_on(mesh, 3000), mesh)
    splats, means = avatar.splats, avatar.splats.means.astype(np.float64)
    rgb = np.tile(SKIN, (len(means), 1))
    for ball in eyeballs(mesh, "eyes"):
        ways = means - ball.centre
        far = np.linalg.norm(ways, axis=1)
        rgb[(ways[:, 1] < 0) & (far < 0.05)] += (0.06, 0, 0)
        rgb[(far < 0.05) & (ways[:, 1] > 0.02)] = (0.1, 0.05, 0.05)
        side, up = np.degrees(np.arctan2(ways[:, 0], ways[:, 2])), np.degrees(np.arcsin(ways[:, 1] / far))
        rgb[(far < 1.5 * ball.radius) & (np.abs(side) < 35) & (np.abs(up + 4) < 14)] = (0.1, 0.2, 0.9)
    made = Splats.create(splats.means, splats.quats, splats.scales, splats.opacities, rgb=rgb)
    return replace(avatar, splats=made)


def lids() -> list[ShutLid]:
    balls = eyeballs(expressive(), "eyes")
    return shut_lids(expressive(), [(ball, lid_edges(expressive(), ball)) for ball in balls])


@lru_cache(maxsize=1)
def lidded() -> Avatar:
    return with_lids(painted(), lids())


def shut(much: float) -> reference.SkinnedSplats:
    made = lidded()
    assert made.shapes is not None
    weights = made.shapes.weights({"eyeBlinkLeft": much, "eyeBlinkRight": much})
    return reference.skin(
        made.splats, made.skin, Pose(STILL).bones(made.skeleton), shapes=made.shapes, expression=weights
    )


def opening(ball: Eyeball) -> np.ndarray:
    """[N, 3] unit ways from the eye's middle within the opening of its lids."""
    edges = lid_edges(expressive(), ball)
    side, share = np.meshgrid(edges.side[3:-3:3], [0.1, 0.5, 0.9])
    upper, lower = (np.interp(side, np.sort(edges.side), e[np.argsort(edges.side)]) for e in (edges.upper, edges.lower))
    up = lower + share * (upper - lower)
    return np.stack([np.cos(up) * np.sin(side), np.sin(up), np.cos(up) * np.cos(side)], axis=2).reshape(-1, 3)


@pytest.mark.parametrize("which", [0, 1])
def test_an_eye_that_is_shut_is_covered_by_skin_and_an_open_one_is_not(which: int) -> None:
    ball = eyeballs(expressive(), "eyes")[which]
    count = len(painted().splats)
    solid = lidded().splats.opacities[count:] > 0.7
    ways = opening(ball)
    nearest = []
    for much in (0.0, 1.0):
        posed = shut(much)
        means, size = posed.means[count:][solid] - ball.centre, np.linalg.norm(posed.shapes[count:][solid], axis=1)
        far = np.linalg.norm(means, axis=1)
        assert far[far < 0.03].min() > ball.radius  # never in the eye
        apart = np.linalg.norm(ways[:, None] * far[None, :, None] - means, axis=2)
        nearest.append((apart / np.maximum(size.max(axis=1), 1e-9)).min(axis=1))
    assert nearest[1].max() < 1.5  # standard deviations: something lies over every place
    lower = nearest[0][: len(ways) * 2 // 3]  # just below an upper lid's edge its own skin may be
    assert lower.min() > 1.5 and np.median(lower) > 5


def test_a_lid_that_is_half_shut_is_before_the_eye() -> None:
    count, half = len(painted().splats), shut(0.5).means
    rest, whole = shut(0.0).means, shut(1.0).means
    for ball in eyeballs(expressive(), "eyes"):
        mine = np.flatnonzero(np.linalg.norm(whole[count:] - ball.centre, axis=1) < 0.03) + count
        assert np.linalg.norm(half[mine] - ball.centre, axis=1).min() > ball.radius
        assert (rest[mine, 1] - whole[mine, 1]).max() > 0.005


def test_it_has_the_colour_of_the_skin_about_it_and_not_of_eyes_or_brows() -> None:
    rgb = lidded().splats.sh[len(painted().splats) :, 0] * SH_C0 + 0.5
    assert np.abs(rgb[:, 1:] - SKIN[1:]).max() < 0.03
    assert rgb[:, 0].min() > 0.69 and rgb[:, 0].max() < 0.77


def test_other_splats_stay_and_somebody_without_skin_gets_grey_lids() -> None:
    count = len(painted().splats)
    for key in ("means", "quats", "scales", "opacities", "sh"):
        assert np.array_equal(getattr(lidded().splats, key)[:count], getattr(painted().splats, key))
    again = with_lids(painted(), lids())
    assert again.splats.means.tobytes() == lidded().splats.means.tobytes()
    gone = replace(painted().splats, means=np.full_like(painted().splats.means, 50.0))
    bare = with_lids(replace(painted(), splats=gone), lids())
    assert np.allclose(bare.splats.sh[count:, 0], 0, atol=1e-6)
