"""Lashes, shadows, lights in the eyes, strands of hair; and the face that people from photographs get."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from glsplat import reference
from glsplat.avatar import Avatar
from glsplat.extras.authoring.body.open_face import with_expressions
from glsplat.extras.authoring.faces.eyeballs import fit_eyeballs
from glsplat.extras.authoring.faces.lashes_and_hair import LID_SHADOW_RGB, with_brow_hairs, with_lashes, with_strands
from glsplat.extras.authoring.faces.openings import find_openings, lid_edges
from glsplat.extras.authoring.geometry.mesh_shapes import with_shapes
from glsplat.meshes import MeshPart, RiggedMesh
from glsplat.skinning.pose import Pose
from glsplat.splats import SH_C0
from tests.extras.authoring.faces.figures import avatar_on, person

STILL = np.zeros((55, 3))


@lru_cache(maxsize=1)
def expressive() -> RiggedMesh:
    mesh = person()
    return with_expressions(mesh, np.arange(len(mesh.vertices)))


def test_lids_end_where_the_eye_begins_and_the_upper_one_comes_down() -> None:
    mesh = expressive()
    for ball in fit_eyeballs(mesh, "eyes"):
        edges = lid_edges(mesh, ball, 0.9)
        assert len(edges.side) > 25 and (edges.upper > edges.lower).all()
        reach = np.linalg.norm(np.concatenate([edges.upper_at, edges.lower_at]) - ball.centre, axis=1) / ball.radius
        assert reach.min() > 0.85 and reach.max() < 1.4
        side = "Left" if ball.joint.startswith("left") else "Right"
        shut = mesh.morphs.moved(Pose(STILL, expression={f"eyeBlink{side}": 1.0}), len(mesh.vertices))
        middle = slice(len(edges.side) // 3, 2 * len(edges.side) // 3)
        assert shut[mesh.faces[edges.upper_face[middle]], 1].mean() < -0.004


@pytest.mark.check
def test_lashes_follow_the_lid_and_the_light_goes_out() -> None:
    mesh = expressive()
    avatar = smiling()
    made = with_lashes(avatar, mesh, find_openings(mesh, fit_eyeballs(mesh, "eyes")))
    count = len(avatar.splats)
    assert len(made.splats) - count > 200 and made.shapes is not None and avatar.shapes is not None
    assert np.array_equal(made.splats.means[:count], avatar.splats.means)
    weights = made.shapes.weights({"eyeBlinkLeft": 1.0, "eyeBlinkRight": 1.0})
    bones = Pose(STILL).bones(made.skeleton)
    posed = reference.skin(made.splats, made.skin, bones, shapes=made.shapes, expression=weights)
    moved = posed.means - made.splats.means
    lashes, lights = moved[count:-2], moved[-2:]
    assert np.quantile(lashes[:, 1], 0.2) < -0.004
    assert (lights[:, 2] < -0.007).all() and np.abs(lights[:, :2]).max() < 1e-4
    quiet = with_lashes(avatar, mesh, find_openings(mesh, fit_eyeballs(mesh, "eyes")), strength=0.5, light=False)
    assert len(quiet.splats) == len(made.splats) - 2
    assert np.allclose(quiet.splats.opacities[count:], 0.5 * made.splats.opacities[count:-2], atol=1e-6)


@lru_cache(maxsize=1)
def smiling() -> Avatar:
    """Few splats with shapes."""
    return with_shapes(avatar_on(expressive(), 300), expressive())


def test_strands_lie_along_the_texture_s_second_axis() -> None:
    mesh = person()
    vertices = np.array([[0.0, 1.9, 0], [0.2, 1.9, 0], [0.2, 2.1, 0.05], [0, 2.1, 0.05]])
    first = len(mesh.vertices)
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32) + first
    uv = np.array([[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]], float)
    hair = MeshPart("hair", faces, uv, np.full((4, 4, 4), 255, np.uint8))
    head = mesh.skeleton.names.index("head")
    bound = np.zeros((4, mesh.joints.shape[1]), np.int64)
    bound[:, 0] = head
    weights = np.zeros(bound.shape)
    weights[:, 0] = 1
    tufted = replace(
        mesh,
        vertices=np.concatenate([mesh.vertices, vertices]),
        joints=np.concatenate([mesh.joints, bound]),
        weights=np.concatenate([mesh.weights, weights]),
        parts=(*mesh.parts, hair),
    )
    bald = avatar_on(mesh, 300)
    made = with_strands(bald, tufted, "hair", 200)
    assert len(made.splats) == 500 and (made.skin.joints[300:, 0] == head).all()
    w, x, y, z = made.splats.quats[300:].astype(float).T
    along = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)], axis=1)
    up = np.array([0, 0.2, 0.05]) / np.linalg.norm([0.2, 0.05])
    assert (np.abs(along @ up) > 0.999).all()
    assert (made.splats.scales[300:, 0] > 5 * made.splats.scales[300:, 1]).all()
    assert with_strands(bald, tufted, "wig", 200) is bald


def test_brows_have_hairs_upright_at_the_nose_and_lying_at_the_temple() -> None:
    mesh = person()
    bald = avatar_on(mesh, 300)
    head = mesh.skeleton.names.index("head")
    middle = np.array(mesh.skeleton.joints[head]) + (0, 0.1, 0.1)
    corners = [[-0.06, 0, 0], [-0.01, 0, 0], [-0.06, 0.01, 0], [-0.01, 0.01, 0]]
    corners += [[0.01, 0, 0], [0.06, 0, 0], [0.01, 0.01, 0], [0.06, 0.01, 0]]
    first, influences = len(mesh.vertices), mesh.joints.shape[1]
    faces = np.array([[0, 1, 2], [1, 3, 2], [4, 5, 6], [5, 7, 6]], np.int32) + first
    brown = np.full((4, 4, 4), 255, np.uint8)
    brown[..., :3] = (90, 60, 40)
    browed = replace(
        mesh,
        vertices=np.concatenate([mesh.vertices, middle + np.array(corners)]),
        joints=np.concatenate([mesh.joints, np.full((8, influences), head)]),
        weights=np.concatenate([mesh.weights, np.eye(1, influences).repeat(8, axis=0)]),
        parts=(*mesh.parts, MeshPart("eyebrows", faces, np.zeros((4, 3, 2)) + [[0, 0], [1, 0], [0, 1]], brown)),
        morphs=None,
    )
    made = with_brow_hairs(bald, browed, "eyebrows", 160)
    assert len(made.splats) == 460 and (made.splats.scales[300:, 0] > 5 * made.splats.scales[300:, 1]).all()
    w, x, y, z = made.splats.quats[300:].astype(float).T
    along = np.abs(np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z)], axis=1))
    aside = np.abs(made.splats.means[300:, 0] - middle[0])
    assert along[aside < 0.02, 1].mean() > 0.85 and along[aside > 0.05, 0].mean() > 0.85
    assert with_brow_hairs(bald, browed, "beard", 160) is bald


def test_lid_shadows_follow_the_lids_without_stretching() -> None:
    mesh = expressive()
    avatar = smiling()
    lashed = with_lashes(avatar, mesh, find_openings(mesh, fit_eyeballs(mesh, "eyes")))
    shapes, made = lashed.shapes, lashed.splats
    veils = np.abs(made.sh[:, 0] * SH_C0 + 0.5 - LID_SHADOW_RGB).max(axis=1) < 1e-3
    assert shapes is not None and veils.sum() > 60
    assert not shapes.bends[veils[shapes.rows]].any() and np.abs(shapes.metres[veils[shapes.rows]]).max() > 0.004
