"""What an arm hides of a garment: its pattern goes on, its shadow is taken out."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from glsplat.extras.authoring.paint.picture_layers.fill import fill_hole
from glsplat.extras.authoring.paint.picture_layers.patches import continue_cloth, fill_with_patches
from glsplat.extras.authoring.paint.picture_layers.shadows import shadow_gain

HEIGHT = 360.0


def cloth(kind: str) -> np.ndarray:
    """[260, 160, 3] linear: stripes down, or checks, with a little noise."""
    rng = np.random.default_rng(7)
    y, x = np.mgrid[:260, :160].astype(float)
    waves = {
        "stripes": np.sin(2 * np.pi * x / 11),
        "checks": np.maximum(np.sin(2 * np.pi * x / 19), np.sin(2 * np.pi * y / 17)),
    }[kind]
    light = 0.25 + 0.2 * np.tanh(3 * waves) + rng.normal(0, 0.01, waves.shape)
    return (light[..., None] * (1.0, 0.6, 0.4)).clip(0, 1).astype(np.float32)


def arm() -> np.ndarray:
    """[260, 160] a forearm across it."""
    return cv2.line(np.zeros((260, 160), np.uint8), (20, 120), (140, 140), 1, 30) > 0


@pytest.mark.check
@pytest.mark.parametrize("kind", ["stripes", "checks"])
def test_a_pattern_goes_on_behind_an_arm(kind: str) -> None:
    true, hole = cloth(kind), arm()
    begun = fill_hole(np.where(hole[..., None], np.float32(0), true), ~hole, hole, HEIGHT)
    filled = fill_with_patches(begun, ~hole, hole, HEIGHT)
    assert np.array_equal(filled[~hole], true[~hole])
    smooth, sewn = (np.abs(picture - true)[hole].mean() for picture in (begun, filled))
    assert sewn < 0.6 * smooth, (sewn, smooth)
    assert filled[hole].std() > 0.8 * true[hole].std()
    assert np.array_equal(filled, fill_with_patches(begun, ~hole, hole, HEIGHT))


def test_without_known_pixels_nothing_changes() -> None:
    true, hole = cloth("checks"), arm()
    assert fill_with_patches(true, np.zeros_like(hole), hole, HEIGHT) is true
    assert fill_with_patches(true, ~hole, np.zeros_like(hole), HEIGHT) is true


@pytest.mark.check
def test_cloth_is_continued_only_where_the_body_is_behind_an_arm() -> None:
    """The trunk ends beside the arm's tip; a thing over it occludes it as an arm does, a thin foreign rim does not."""
    true, hole = cloth("stripes"), arm()
    there = np.zeros_like(hole)
    there[:, 30:130] = True
    label = np.where(hole, 1, 0)
    label[200:230, 60:90], label[:, 128:131] = -1, -1
    spoilt = np.where((label != 0)[..., None], np.float32(0.9), true)
    out = continue_cloth(spoilt, label == 0, there, label, 0)
    changed = (out != spoilt).any(axis=2)
    assert changed[hole & there].all() and not changed[~there].any()
    assert changed[205:225, 65:85].all() and not changed[20:90, 128:131].any()


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
def test_a_shadow_is_removed(shadow: float, scale: int) -> None:
    picture, shown, arms = (np.repeat(np.repeat(part, scale, 0), scale, 1) for part in shirt(shadow))
    times = shadow_gain(picture, shown, arms, HEIGHT * scale)[::scale, ::scale]
    middle = times[SHADE, 30:-30][3:-7]  # its edge comes out as soft as the cloth's pattern is fine
    assert np.abs(middle * shadow - 1).max() < 0.06
    assert (times[:80] == 1).all() and (times[HEM:] == 1).all()
    assert (times[ARM, 30:-30] == 1).all()


def test_lit_cloth_is_unchanged() -> None:
    assert np.abs(shadow_gain(*shirt(1.0), HEIGHT)[:, 20:-20] - 1).max() < 0.04


def test_another_hue_or_a_far_darker_colour_is_no_shadow() -> None:
    picture, shown, arms = shirt(1.0)
    for other in (BLUE, WHITE * 0.2):
        picture[SHADE] = other
        assert np.abs(shadow_gain(picture, shown, arms, HEIGHT)[SHADE, 30:-30][3:-3] - 1).max() < 0.05


def test_without_an_arm_there_is_no_shadow() -> None:
    picture, shown, arms = shirt(0.5)
    assert (shadow_gain(picture, shown | arms, np.zeros_like(arms), HEIGHT) == 1).all()
    assert (shadow_gain(picture, np.zeros_like(arms), arms, HEIGHT) == 1).all()  # nor where no trunk is seen
