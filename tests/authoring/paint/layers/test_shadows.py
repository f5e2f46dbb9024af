"""An arm's shadow on the cloth below it is no colour of that cloth; other garments and other hues are."""

from __future__ import annotations

import numpy as np
import pytest

from glsplat.authoring.paint.layers.shadows import brightening

HEIGHT, WIDE = 360, 160
ARM, SHADE, HEM = slice(100, 125), slice(125, 142), 185
WHITE, BLUE = np.array([0.7, 0.65, 0.6]), np.array([0.1, 0.15, 0.5])


def shirt(shadow: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Linear colours, where they are the trunk's, and where an arm's: a pale shirt with fine stripes over trousers."""
    picture = np.tile(WHITE, (HEIGHT, WIDE, 1)) * (1 + 0.1 * np.sin(np.arange(WIDE) * 1.3))[:, None]
    picture[HEM:] = 0.05
    picture[SHADE] *= shadow
    picture[ARM] = (0.6, 0.1, 0.1)
    arms = np.zeros((HEIGHT, WIDE), bool)
    arms[ARM, 10:-10] = True
    return picture.astype(np.float32), ~arms, arms


@pytest.mark.parametrize("shadow", [0.5, 0.8])
@pytest.mark.parametrize("scale", [1, 3])
def test_a_shadow_is_taken_out(shadow: float, scale: int) -> None:
    picture, shown, arms = (np.repeat(np.repeat(part, scale, 0), scale, 1) for part in shirt(shadow))
    times = brightening(picture, shown, arms, HEIGHT * scale)[::scale, ::scale]
    middle = times[SHADE, 30:-30][3:-7]  # its edge comes out as soft as the cloth's pattern is fine
    assert np.abs(middle * shadow - 1).max() < 0.06
    assert (times[:80] == 1).all() and (times[HEM:] == 1).all()
    assert (times[ARM, 30:-30] == 1).all()


def test_what_is_as_bright_as_the_rest_stays() -> None:
    assert np.abs(brightening(*shirt(1.0), HEIGHT)[:, 20:-20] - 1).max() < 0.04


def test_another_hue_and_what_is_far_darker_is_no_shadow() -> None:
    picture, shown, arms = shirt(1.0)
    for other in (BLUE, WHITE * 0.2):
        picture[SHADE] = other
        assert np.abs(brightening(picture, shown, arms, HEIGHT)[SHADE, 30:-30][3:-3] - 1).max() < 0.05


def test_without_an_arm_there_is_none() -> None:
    picture, shown, arms = shirt(0.5)
    assert (brightening(picture, shown | arms, np.zeros_like(arms), HEIGHT) == 1).all()
    assert (brightening(picture, np.zeros_like(arms), arms, HEIGHT) == 1).all()  # nor where no trunk is seen
