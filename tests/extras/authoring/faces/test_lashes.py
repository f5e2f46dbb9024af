"""Lashes and shadows of lids."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest

from glsplat import reference
from glsplat.avatar import Avatar
from glsplat.extras.authoring.body.open_face import with_expressions
from glsplat.extras.authoring.faces.eyes import find_openings, fit_eyeballs, lid_edges
from glsplat.extras.authoring.faces.lashes import LID_SHADOW_RGB, with_lashes
from glsplat.extras.authoring.geometry.mesh_shapes import with_shapes
from glsplat.meshes import RiggedMesh
from glsplat.skinning.pose import Pose
from glsplat.splats import SH_C0
from tests.extras.authoring.faces.figures import avatar_on, person

STILL = np.zeros((55, 3))


@lru_cache(maxsize=1)
def expressive() -> RiggedMesh:
    mesh = person()
    return with_expressions(mesh)


def test_lids_end_where_the_eye_begins_and_the_upper_one_comes_down() -> None:
    mesh = expressive()
    for ball in fit_eyeballs(mesh):
        edges = lid_edges(mesh, ball, 0.9)
        assert len(edges.side) > 25 and (edges.upper > edges.lower).all()
        reach = np.linalg.norm(np.concatenate([edges.upper_at, edges.lower_at]) - ball.centre, axis=1) / ball.radius
        assert reach.min() > 0.85 and reach.max() < 1.4
        side = "Left" if ball.joint.startswith("left") else "Right"
        shut = mesh.morphs.moved(Pose(STILL, expression={f"eyeBlink{side}": 1.0}), len(mesh.vertices))
        middle = slice(len(edges.side) // 3, 2 * len(edges.side) // 3)
        assert shut[mesh.faces[edges.upper_face[middle]], 1].mean() < -0.004


@pytest.mark.check
def test_lashes_follow_the_lid() -> None:
    mesh = expressive()
    avatar = smiling()
    made = with_lashes(avatar, mesh, find_openings(mesh, fit_eyeballs(mesh)))
    count = len(avatar.splats)
    assert len(made.splats) - count > 200 and made.shapes is not None and avatar.shapes is not None
    assert np.array_equal(made.splats.means[:count], avatar.splats.means)
    weights = made.shapes.weights({"eyeBlinkLeft": 1.0, "eyeBlinkRight": 1.0})
    bones = Pose(STILL).bones(made.skeleton)
    posed = reference.skin(made.splats, made.skin, bones, shapes=made.shapes, expression=weights)
    moved = posed.means - made.splats.means
    assert np.quantile(moved[count:, 1], 0.2) < -0.004


@lru_cache(maxsize=1)
def smiling() -> Avatar:
    """Few splats with shapes."""
    return with_shapes(avatar_on(expressive(), 300), expressive())


def test_lid_shadows_follow_the_lids_without_stretching() -> None:
    mesh = expressive()
    avatar = smiling()
    lashed = with_lashes(avatar, mesh, find_openings(mesh, fit_eyeballs(mesh)))
    shapes, made = lashed.shapes, lashed.splats
    veils = np.abs(made.sh[:, 0] * SH_C0 + 0.5 - LID_SHADOW_RGB).max(axis=1) < 1e-3
    assert shapes is not None and veils.sum() > 60
    assert not shapes.bends[veils[shapes.rows]].any() and np.abs(shapes.metres[veils[shapes.rows]]).max() > 0.004
