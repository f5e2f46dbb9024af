"""The open body's face on people of the same mesh and of another shape."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from glsplat.errors import FormatError
from glsplat.extras.authoring.body.open_body import open_body
from glsplat.extras.authoring.body.open_face import match_open_body, open_face, with_expressions, with_mouth
from glsplat.skinning.expression import ARKIT
from glsplat.skinning.pose import Pose
from tests.extras.authoring.faces.figures import EYES, person

STILL = np.zeros((55, 3))


def test_vertices_are_found_by_their_texture_coordinates_whatever_their_order_and_shape() -> None:
    mesh = person()
    order = np.random.default_rng(4).permutation(len(mesh.vertices))
    place = np.argsort(order)
    parts = tuple(replace(one, faces=place[one.faces].astype(np.int32)) for one in mesh.parts)
    rows = {name: getattr(mesh, name)[order] for name in ("vertices", "joints", "weights")}
    mixed = replace(mesh, **rows, parts=parts)
    same = match_open_body(mixed, "skin")
    found = same >= 0
    assert found.sum() > 13_000
    body = open_body()
    # where two vertices have one coordinate (the seams of the texture have not) either is right
    assert (same[found] == order[found]).mean() > 0.99
    assert np.abs(body.vertices[same[found]] - body.vertices[order[found]]).max() < 1e-3


def test_a_mesh_of_another_layout_is_refused() -> None:
    mesh = person()
    parts = tuple(replace(one, uv=one.uv * 0.5 + 0.013) for one in mesh.parts)
    with pytest.raises(FormatError, match="texture layout of MakeHuman"):
        match_open_body(replace(mesh, parts=parts), "skin")


def test_expressions_move_the_skin_as_the_open_body_does_and_no_eyeball() -> None:
    mesh, body = person(), open_body()
    made = with_expressions(mesh, np.arange(len(mesh.vertices)))
    assert made.morphs.names == open_face().expressions.names and sorted(made.morphs.names) == sorted(ARKIT)
    pose = Pose(STILL, expression={"jawOpen": 0.8, "eyeLookUpLeft": 1.0, "mouthSmileRight": 0.4})
    moved = made.morphs.moved(pose, len(mesh.vertices))
    wanted = open_face().expressions.moved(pose, len(mesh.vertices))
    ball = np.isin(body.part, [mesh.skeleton.names.index(name) for name in EYES])
    assert np.abs(moved[~ball] - wanted[~ball]).max() < 1e-5
    assert np.abs(wanted[ball]).max() > 1e-3 and not moved[ball].any()


def test_lower_teeth_go_with_the_jaw_as_one_piece_and_upper_ones_stay() -> None:
    mesh = person()
    same = np.arange(len(mesh.vertices))
    made = with_mouth(with_expressions(mesh, same), same)
    assert [one.name for one in made.parts] == ["skin", "eyes", "mouth", "teeth"]  # the tongue is in the mouth
    first, face = len(mesh.vertices), open_face()
    moved = made.morphs.moved(Pose(STILL, expression={"jawOpen": 1.0}), len(made.vertices))[first:]
    assert not moved[~face.lower].any()
    rest = made.vertices[first:][face.lower]
    there = rest + moved[face.lower]
    some = np.random.default_rng(0).integers(0, len(rest), (200, 2))
    before, after = (np.linalg.norm(at[some[:, 0]] - at[some[:, 1]], axis=1) for at in (rest, there))
    far = before > 0.005
    assert 0.93 < (after[far] / before[far]).min() and (after[far] / before[far]).max() < 1.07
    assert moved[face.lower, 1].max() < -0.005  # down
    # behind the lips: no tooth stands out of the face
    lips = mesh.vertices[np.abs(mesh.vertices[:, 0]) < 0.01]
    near = lips[np.abs(lips[:, 1] - made.vertices[first:, 1].mean()) < 0.02]
    assert made.vertices[first:, 2].max() < near[:, 2].max() - 0.004


def test_a_person_without_a_tongue_gets_one_that_can_be_shown() -> None:
    mesh = person()
    without = replace(mesh, parts=mesh.parts[:2])
    same = np.where(np.isin(np.arange(len(mesh.vertices)), without.faces), np.arange(len(mesh.vertices)), -1)
    made = with_mouth(with_expressions(without, same), same)
    assert [one.name for one in made.parts] == ["skin", "eyes", "teeth", "tongue"]
    tongue = np.unique(made.parts[-1].faces)
    moved = made.morphs.moved(Pose(STILL, expression={"tongueOut": 1.0}), len(made.vertices))[tongue]
    assert moved[:, 2].max() > 0.015
