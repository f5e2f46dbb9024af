"""Eyes that are drawn are read again: their colours, and whether they are seen at all."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from glsplat.extras.authoring.body.open_body import open_body
from glsplat.extras.authoring.fit import eyes
from glsplat.extras.authoring.fit.eyes import eyeball, iris_angle, read_eyes
from glsplat.extras.authoring.networks.face import Eye, EyeLook, Face, read_eye
from glsplat.extras.authoring.networks.network import Crop

IRIS, WHITE, SKIN, HAIR = (40, 80, 110), (180, 170, 165), (190, 140, 110), (70, 60, 50)


def drawn(x: float = 40.0, hair: float = 0.0, height: float = 8.0) -> tuple[np.ndarray, Eye]:
    """A picture of an eye 24 pixels wide at (x, 30), ``hair`` of it covered from above, and what the network says."""
    picture = np.full((60, 160, 3), SKIN, np.uint8)
    turn = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    lids = np.column_stack([x + 12 * np.cos(turn), 30 + height / 2 * np.sin(turn)])
    inside = np.zeros(picture.shape[:2], np.uint8)
    cv2.fillConvexPoly(inside, np.round(lids).astype(np.int32), 1)
    picture[inside > 0] = WHITE
    rows, columns = np.mgrid[0:60, 0:160] + 0.5
    far = np.hypot(columns - x, rows - 30)
    picture[(inside > 0) & (far < 5)] = IRIS
    picture[(inside > 0) & (far < 2)] = 5
    picture[: int(25 + 10 * hair), int(x) - 20 : int(x) + 20] = np.where(hair > 0, HAIR, SKIN)
    around = np.array([(0, 0), (5, 0), (0, 5), (-5, 0), (0, -5)])
    return picture, Eye(np.array([x, 30]) + around, np.concatenate([lids, np.zeros((55, 2))]))


def test_an_eye_is_read() -> None:
    look = read_eye(*drawn())
    assert look.visible and np.allclose(look.iris, (40, 30)) and look.radius == pytest.approx(5)
    assert np.abs(look.iris_colour - IRIS).max() < 12 and np.abs(look.white_colour - WHITE).max() < 6


@pytest.mark.parametrize("change", [{"hair": 1.0}, {"height": 4.0}])
def test_an_eye_under_hair_or_shut_is_not_seen(change: dict[str, float]) -> None:
    look = read_eye(*drawn(**change))
    assert not look.visible and np.isnan(look.radius) and np.isnan(look.iris).all()
    assert (look.iris_colour < look.white_colour).all()  # usual ones


def test_noise_is_no_eye(rng: np.random.Generator) -> None:
    picture, eye = drawn()
    assert not read_eye(rng.integers(90, 110, picture.shape).astype(np.uint8), eye).visible
    for place in (-500.0, 5000.0, np.nan):  # beside the picture
        assert not read_eye(picture, Eye(eye.iris + place, eye.lids + place)).visible


def test_the_hidden_eye_has_the_others_colours(monkeypatch: pytest.MonkeyPatch) -> None:
    hidden, eye = drawn(hair=1.0)
    seen, other = drawn(120.0)
    picture = np.concatenate([hidden[:, :80], seen[:, 80:]], axis=1)
    monkeypatch.setattr(eyes, "eye_of", lambda picture, face, side: eye if side == "right" else other)
    looks = read_eyes(picture, Face(np.zeros((468, 3)), 1.0, Crop(0.0, 0.0, 1.0)))
    assert looks["left"].visible and not looks["right"].visible
    assert (looks["right"].iris_colour == looks["left"].iris_colour).all() and np.isnan(looks["right"].radius)


@pytest.mark.parametrize("side", ["left", "right"])
def test_eyeballs_are_balls_that_look_ahead(side: str) -> None:
    body = open_body()
    ball = eyeball(body, side)
    points = body.vertices[ball.vertices]
    assert np.abs(np.linalg.norm(points - ball.centre, axis=1) - ball.radius).max() < 0.0005
    assert (points[:, 0] > 0).all() == (side == "left") and 0.012 < ball.radius < 0.018
    ahead = ball.centre + ball.radius * np.array([0, 0, 1])
    aside = ball.centre + ball.radius * np.array([np.sin(0.25), 0, np.cos(0.25)])
    assert ball.zones(np.stack([ahead, aside, ball.centre - (0, 0, ball.radius)]), 0.34).tolist() == [2, 1, 0]


def test_irises_are_as_large_as_they_were_seen() -> None:
    ball, grey = eyeball(open_body(), "left"), np.full(3, 90.0)
    unseen = EyeLook(False, np.full(2, np.nan), np.nan, grey, grey)

    def angle(millimetres: float) -> float:
        look = EyeLook(True, np.zeros(2), millimetres, grey, grey)
        return iris_angle({"left": look, "right": unseen}, ball, 1000.0)

    assert angle(5.0) == pytest.approx(np.arcsin(0.005 / ball.radius)) and angle(1.0) < angle(5.0) < angle(50.0) < 0.45
    assert 0.3 < iris_angle({"left": unseen, "right": unseen}, ball, 1000.0) < 0.4
