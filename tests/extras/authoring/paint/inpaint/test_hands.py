"""Hands are skin, in the tone that the picture shows, and gloves only if both are."""

from __future__ import annotations

import numpy as np
import pytest

from glsplat.extras.authoring.body.open_body import open_body
from glsplat.extras.authoring.body.segments import HANDS, joint_weights
from glsplat.extras.authoring.paint.inpaint.hands import hands_of
from glsplat.extras.authoring.paint.skin_tone import likeness
from glsplat.extras.authoring.templates.library import hand_skin
from glsplat.meshes import RiggedMesh
from tests.extras.authoring.paint import scene as made_up
from tests.extras.authoring.paint.scene import photographed

SKIN, WHITE, GREEN = np.array([0.45, 0.3, 0.22]), np.array([0.7, 0.7, 0.72]), np.array([0.05, 0.3, 0.05])
BODY = open_body()
LEFT, RIGHT = (joint_weights(BODY, side, *HANDS) > 0.75 for side in ("left", "right"))


@pytest.mark.parametrize(("left", "right", "wanted"), [(SKIN, WHITE, SKIN), (GREEN, GREEN, GREEN)])
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


def test_skin_in_shade_is_skin_and_cloth_is_not() -> None:
    assert likeness(0.5 * SKIN[None], SKIN[None])[0] == 1
    assert likeness(WHITE[None], SKIN[None])[0] == 0 and likeness(0.05 * SKIN[None], SKIN[None])[0] == 0
