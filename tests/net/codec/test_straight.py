"""Straight colours, pixel by pixel."""

from __future__ import annotations

import numpy as np
import pytest

from glsplat.net.codec.encode import straightened

BLOCK = 16


def test_every_pixel_is_its_own_colour_or_its_blocks(rng):
    """By a loop over blocks, on a picture with holes and thin rims."""
    image = np.zeros((70, 101, 4), np.uint8)
    y, x = np.mgrid[:70, :101]
    image[..., 3] = np.clip(255 - 20 * (np.hypot(x - 50, y - 33) - 25), 0, 255)
    image[rng.random((70, 101)) < 0.02, 3] = 0
    straight = rng.integers(0, 256, (70, 101, 3))
    image[..., :3] = (straight * (image[..., 3:] / 255.0)).round()
    found = straightened(image)
    assert (found[..., 3] == image[..., 3]).all()
    for top in range(0, 70, BLOCK):
        for left in range(0, 101, BLOCK):
            block = np.s_[top : top + BLOCK, left : left + BLOCK]
            mine, theirs = found[block].astype(float), image[block].astype(float)
            if not theirs[..., 3].any() or ((theirs[..., 3] == 255).all() and theirs.shape[:2] == (BLOCK, BLOCK)):
                assert (mine == theirs).all()
                continue
            for a in (0, 8):
                for b in (0, 8):
                    part = theirs[a : a + 8, b : b + 8]
                    if not part.size:
                        continue
                    source = part if part[..., 3].any() else theirs
                    mean = source[..., :3].sum((0, 1)) / source[..., 3].sum() * 255
                    own = part[..., :3] * 255 / np.maximum(part[..., 3:], 1)
                    expected = mean + (own - mean) * np.minimum(part[..., 3:] / 32, 1)
                    assert np.abs(mine[a : a + 8, b : b + 8, :3] - np.minimum(expected, 255)).max() <= 0.51


@pytest.mark.parametrize("shape", [(1, 1), (16, 16), (17, 3)])
def test_pictures_of_any_shape(shape):
    clear = np.zeros((*shape, 4), np.uint8)
    assert not straightened(clear).any()
    solid = np.full((*shape, 4), 255, np.uint8)
    assert (straightened(solid) == 255).all()
    faint = np.full((*shape, 4), (1, 0, 0, 1), np.uint8)  # red, as far as one bit can say
    assert (straightened(faint)[..., :3] == (255, 0, 0)).all()
