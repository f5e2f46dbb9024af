"""Premultiplied alpha and glsplat.straight(): against exact fractions, PIL, and the renderer's own backgrounds."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from PIL import Image

import glsplat
from glsplat import Camera, GlsplatError

SIZE = 192


@pytest.fixture(scope="module")
def view() -> Camera:
    return Camera(glsplat.look_at((0.3, 1.3, 2.0), (0, 1.0, 0)), glsplat.pinhole(SIZE, SIZE, 40), SIZE, SIZE)


def over(picture: np.ndarray[Any, Any], colour: tuple[int, int, int]) -> np.ndarray[Any, Any]:
    """PIL's own idea of laying an RGBA picture over a colour."""
    base = Image.new("RGBA", picture.shape[1::-1], (*colour, 255))
    base.alpha_composite(Image.fromarray(picture))
    return np.asarray(base)[..., :3].astype(int)


def test_every_byte_is_rounded_exactly() -> None:
    colour, alpha = np.meshgrid(np.arange(256, dtype=np.uint8), np.arange(256, dtype=np.uint8))
    out = glsplat.straight(np.stack([colour, colour, colour, alpha], axis=-1))
    for a in range(256):
        for c in range(256):
            exact = min(255, int(Fraction(c * 255, a) + Fraction(1, 2))) if a else 0
            assert out[a, c, 0] == exact, (c, a)
    assert np.array_equal(out[..., 3], alpha) and (out[0, :, :3] == 0).all()
    opaque = np.stack([colour, colour.T, colour, np.full_like(colour, 255)], axis=-1)
    assert np.array_equal(glsplat.straight(opaque), opaque)


@pytest.mark.parametrize("shape", [(4,), (0, 4), (5, 4), (3, 5, 4), (2, 3, 5, 4), (2, 2, 3, 5, 4)])
@pytest.mark.parametrize("kind", [np.uint8, np.float32])
def test_any_leading_dimensions(shape: tuple[int, ...], kind: type[Any]) -> None:
    rng = np.random.default_rng(2)
    image = rng.integers(0, 256, shape).astype(np.uint8) if kind is np.uint8 else rng.random(shape, np.float32)
    kept = image.copy()
    out = glsplat.straight(image)
    assert out.shape == shape and out.dtype == kind and np.array_equal(image, kept)
    for index in np.ndindex(shape[:-1]):
        assert np.array_equal(out[index], glsplat.straight(image[index]))
    turned = np.asfortranarray(image)
    turned.flags.writeable = False
    assert np.array_equal(glsplat.straight(turned), out) and out.flags.writeable


def test_floats_are_neither_rounded_nor_clamped() -> None:
    image = np.array([[0.5, 1.5, -0.25, 0.5], [0, 0, 0, 0], [0.3, 0.2, 0.1, 0]], np.float32)
    assert glsplat.straight(image).tolist() == [[1, 3, -0.5, 0.5], [0, 0, 0, 0], [0, 0, 0, 0]]


def test_what_is_no_picture_is_refused() -> None:
    for bad in (
        None,
        [[1, 2, 3, 4]],
        np.zeros((4, 4, 3), np.uint8),
        np.zeros((4, 4, 4)),
        np.zeros((4, 4, 4), np.uint16),
        np.uint8(3),
    ):
        with pytest.raises(GlsplatError, match=r"straight\(\) takes uint8 or float32"):
            glsplat.straight(bad)  # type: ignore[type-var]
    for background in ((1, 1), "white", None, (np.nan, 0, 0)):
        with pytest.raises(GlsplatError, match="background"):
            glsplat.straight(np.zeros((1, 4), np.uint8), background)  # type: ignore[arg-type]


@pytest.mark.gl
def test_over_white_it_is_the_picture_rendered_over_white(renderer_of: Any, view: Camera) -> None:
    """The default avatar: PIL on what render() returns is far too dark, on the straight one right to a level."""
    renderer = renderer_of(glsplat.default_avatar(), (SIZE, SIZE), output="uint8", target="auto")
    black, white = (renderer.render([replace(view, background=b)])[0] for b in ([0, 0, 0], [1, 1, 1]))
    wanted = white[..., :3].astype(int)
    assert np.abs(over(glsplat.straight(black), (255, 255, 255)) - wanted).max() <= 1
    assert np.abs(over(black, (255, 255, 255)) - wanted).max() >= 20
    partly = (black[..., 3] > 0) & (black[..., 3] < 255)
    assert partly.sum() > 500


def test_the_background_is_taken_out_again() -> None:
    rng, blue = np.random.default_rng(4), np.array([0.2, 0.4, 0.9], np.float32)
    plain = rng.uniform(0.1, 1, (20, 4)).astype(np.float32)
    over = plain.copy()
    over[:, :3] = plain[:, :3] * plain[:, 3:] + (1 - plain[:, 3:]) * blue
    assert glsplat.straight(over, blue) == pytest.approx(plain, abs=1e-5)
