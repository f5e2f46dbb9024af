"""The open body's face on people of the same mesh and of another shape."""

from __future__ import annotations

import numpy as np

from glsplat.extras.authoring.body.open_body import open_body
from glsplat.extras.authoring.body.open_face import open_face, with_expressions, with_mouth
from glsplat.skinning.expression import ARKIT
from glsplat.skinning.pose import Pose
from tests.extras.authoring.faces.figures import EYES, person

STILL = np.zeros((55, 3))


def test_expressions_move_the_skin_as_the_open_body_does_and_no_eyeball() -> None:
    mesh, body = person(), open_body()
    made = with_expressions(mesh)
    assert made.morphs.names == open_face().expressions.names and sorted(made.morphs.names) == sorted(ARKIT)
    pose = Pose(STILL, expression={"jawOpen": 0.8, "eyeLookUpLeft": 1.0, "mouthSmileRight": 0.4})
    moved = made.morphs.moved(pose, len(mesh.vertices))
    wanted = open_face().expressions.moved(pose, len(mesh.vertices))
    ball = np.isin(body.part, [mesh.skeleton.names.index(name) for name in EYES])
    assert np.abs(moved[~ball] - wanted[~ball]).max() < 1e-5
    assert np.abs(wanted[ball]).max() > 1e-3 and not moved[ball].any()


def test_lower_teeth_go_with_the_jaw_as_one_piece_and_upper_ones_stay() -> None:
    mesh = person()
    made = with_mouth(with_expressions(mesh))
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
