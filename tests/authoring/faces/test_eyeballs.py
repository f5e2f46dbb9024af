"""Round eyeballs with a painted iris."""

from __future__ import annotations

import numpy as np
import pytest

from glsplat.authoring.faces.eyeballs import IRISES, eye_texture, eyeballs, with_eyeballs
from glsplat.errors import FormatError
from glsplat.skinning.pose import Pose
from tests.authoring.faces.figures import EYES, person


@pytest.mark.parametrize("iris", IRISES)
def test_an_iris_has_a_black_pupil_a_dark_rim_and_is_never_red(iris: str) -> None:
    texture = eye_texture(iris, 0.015)[..., :3].astype(int)
    rows = len(texture)
    angle = np.arange(rows) / (rows - 1) * np.radians(115)
    rim = np.arcsin(0.0059 / 0.015)
    assert texture[angle < 0.25 * rim].max() < 20
    zones = (0.9, 0.97), (0.5, 0.75), (1.2, 1.4)
    ring, middle, white = (texture[(angle > low * rim) & (angle < high * rim)].mean() for low, high in zones)
    assert ring < 0.6 * middle < 0.6 * white
    inside = texture[(angle > 0.4 * rim) & (angle < 0.95 * rim)].reshape(-1, 3)
    assert (inside[:, 0] <= 2.2 * inside[:, 1] + 8).all()  # red, of which brown has twice its green at most


def test_the_ball_turns_about_its_middle_and_stays_where_it_is() -> None:
    mesh = person()
    made = with_eyeballs(mesh, "eyes", "blue")
    assert [one.name for one in made.parts] == ["skin", "mouth", *EYES]
    for ball in eyeballs(made, *EYES):
        index = made.skeleton.names.index(ball.joint)
        assert np.abs(made.skeleton.joints[index] - ball.centre).max() < 1e-4
        rotations = np.zeros((55, 3))
        rotations[index] = (0.3, -0.4, 0)
        part = next(one for one in made.parts if one.name == ball.joint)
        posed = made.posed(Pose(rotations))[np.unique(part.faces)]
        assert np.abs(np.linalg.norm(posed - ball.centre, axis=1) - ball.radius).max() < 1e-4


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(FormatError, match="an iris is one of brown, dark brown, blue, grey, green, not 'red'"):
        with_eyeballs(person(), "eyes", "red")
    with pytest.raises(FormatError, match="left_eye_smplhf"):
        eyeballs(person(), "skin")
