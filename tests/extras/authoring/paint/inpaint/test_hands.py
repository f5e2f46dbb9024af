"""Hands are skin, in the tone that the picture shows, and gloves only if both are."""

from __future__ import annotations

import numpy as np
import pytest

from glsplat.extras.authoring.body.open_body import open_body
from glsplat.extras.authoring.body.segments import HANDS, joint_weights
from glsplat.extras.authoring.fit.eyes import eyeball
from glsplat.extras.authoring.fit.offsets import face_vertices
from glsplat.extras.authoring.geometry.surface_points import SurfacePoints
from glsplat.extras.authoring.paint.inpaint.hands import hands_of
from glsplat.extras.authoring.paint.painter import painter_of
from glsplat.extras.authoring.paint.skin_tone import face_colour, likeness
from glsplat.extras.authoring.sample.scatter import even_points
from glsplat.extras.authoring.templates.library import hand_skin
from glsplat.meshes import RiggedMesh
from glsplat.pictures import to_linear
from tests.extras.authoring.paint import scene as made_up
from tests.extras.authoring.paint.scene import photographed

SKIN, WHITE, GREEN = np.array([0.45, 0.3, 0.22]), np.array([0.7, 0.7, 0.72]), np.array([0.05, 0.3, 0.05])
BODY = open_body()
LEFT, RIGHT = (joint_weights(BODY, side, *HANDS) > 0.75 for side in ("left", "right"))


@pytest.mark.parametrize(
    ("left", "right", "wanted"), [(SKIN, WHITE, SKIN), (GREEN, 0.8 * GREEN, GREEN), (0.4 * SKIN, 0.4 * SKIN, SKIN)]
)
def test_hands_have_the_tone_of_skin_unless_both_wear_gloves(
    left: np.ndarray, right: np.ndarray, wanted: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    usual = made_up.albedo

    def worn(mesh: RiggedMesh) -> np.ndarray:
        colours = usual(mesh)
        colours[LEFT], colours[RIGHT] = left, right
        return colours

    monkeypatch.setattr(made_up, "albedo", worn)
    shot = (scene := photographed.__wrapped__("front")).shots[0]
    hands = hands_of(BODY, shot, scene.light, hand_skin())
    for hand in (LEFT, RIGHT):
        assert likeness(np.median(hands.colour[hand], axis=0)[None], wanted[None])[0] > 0.8
        assert hands.share[hand].min() > 0.9
        assert hands.colour[hand].sum(axis=1).std() > 0.03 * hands.colour[hand].sum(axis=1).mean()  # the texture's
    assert np.allclose(*(np.median(hands.colour[hand], axis=0) for hand in (LEFT, RIGHT)), rtol=0.1)


def test_hands_below_long_sleeves_have_the_tone_of_the_face(monkeypatch: pytest.MonkeyPatch) -> None:
    usual = made_up.albedo
    arms = [joint_weights(BODY, side, "elbow", *HANDS) > 0.3 for side in ("left", "right")]

    def sleeved(mesh: RiggedMesh) -> np.ndarray:
        colours = usual(mesh)
        colours[arms[0] | arms[1]] = GREEN
        return colours

    monkeypatch.setattr(made_up, "albedo", sleeved)
    shot = (scene := photographed.__wrapped__("front")).shots[0]
    hands, face = hands_of(BODY, shot, scene.light, hand_skin()), face_colour(BODY, shot, scene.light)
    assert face is not None
    for hand in (LEFT, RIGHT):
        assert likeness(np.median(hands.colour[hand], axis=0)[None], face[None])[0] > 0.8


def test_hands_are_lit_as_the_arms_are() -> None:
    shot = (scene := photographed("front")).shots[0]
    hands, shade = hands_of(BODY, shot, scene.light), scene.light.shade(shot.normals)
    usual = float(np.median(shade[face_vertices(BODY)]))
    some = (LEFT | RIGHT) & (shade > 0.8 * usual) & (shade < 1.5 * usual)
    assert shade[some].std() > 0.1 * usual
    assert (hands.colour[some, 0] / shade[some]).std() < 0.02 * hands.colour[some, 0].mean()


def test_a_patch_in_the_picture_of_a_hand_is_not_painted(monkeypatch: pytest.MonkeyPatch) -> None:
    usual, painted = made_up.albedo, []
    half = LEFT & (BODY.vertices[:, 2] > np.median(BODY.vertices[LEFT, 2]))
    for factor in (1.0, 1.5):  # of brightness: still like skin

        def worn(mesh: RiggedMesh, factor: float = factor) -> np.ndarray:
            colours = usual(mesh)
            colours[LEFT | RIGHT] = SKIN
            colours[half] *= factor
            return colours

        monkeypatch.setattr(made_up, "albedo", worn)
        scene = photographed.__wrapped__("front")
        painter = painter_of(BODY, scene.shots, even_points(scene.mesh, 4000), hand_texture=hand_skin())
        corners = np.repeat(np.flatnonzero(LEFT)[:, None], 3, axis=1)
        painted.append(painter.colours(SurfacePoints(corners, np.full(corners.shape, 1 / 3))))
    assert np.abs(painted[1] - painted[0]).max() > 0.01  # the tone is the picture's
    ratio = to_linear(painted[1]) / to_linear(painted[0])
    assert ratio.std() < 0.02  # and the same everywhere


def test_the_tone_of_a_face_is_that_of_its_cheeks_between_fringe_and_mask(monkeypatch: pytest.MonkeyPatch) -> None:
    usual, eyes = made_up.albedo, eyeball(BODY, "left").centre[1]

    def worn(mesh: RiggedMesh) -> np.ndarray:
        colours = usual(mesh)
        height = BODY.vertices[:, 1] - eyes
        colours[(height > 0) | (height < -0.025)] = 0.01
        return colours

    monkeypatch.setattr(made_up, "albedo", worn)
    tone = face_colour(BODY, (scene := photographed.__wrapped__("front")).shots[0], scene.light)
    assert tone is not None and likeness(tone[None], SKIN[None])[0] > 0.8


def test_skin_in_shade_is_skin_and_cloth_is_not() -> None:
    assert likeness(0.5 * SKIN[None], SKIN[None])[0] == 1
    assert likeness(WHITE[None], SKIN[None])[0] == 0 and likeness(0.05 * SKIN[None], SKIN[None])[0] == 0
