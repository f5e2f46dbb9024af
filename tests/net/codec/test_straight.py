"""Straight colours: what they are pixel by pixel, and the silhouette that is left of them behind the codec."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

import glsplat
from glsplat.camera import head_matrix
from glsplat.net.codec.encode import Encoder
from glsplat.net.codec.straight import straightened
from glsplat.net.reply import Reply

BLOCK = 16


def test_every_pixel_is_its_own_colour_or_its_blocks(rng):
    """By a loop over blocks, on a picture whose sides are no multiples of one, with holes and thin rims."""
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


@pytest.mark.gl
@pytest.mark.parametrize("crop", [False, True])
def test_the_silhouette_is_cleaner_and_no_larger(crop):
    """The embedded avatar before a checkerboard, three pixels to either side of its outline, at quality 80."""
    side = 512
    camera = glsplat.stereo_cameras(head_matrix((0, 1.2, 2.2), (0, 0, 0, 1)), fov=50, size=(side, side))[0]
    with glsplat.Renderer(glsplat.default_avatar(), size=(side, side)) as renderer:
        drawn = renderer.render([camera])
    board = 255.0 * (np.add.outer(np.arange(side) // 8, np.arange(side) // 8) % 2)[..., None]
    inside = (drawn[0, ..., 3] > 127).astype(np.uint8)
    ball = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (7, 7))
    rim = cv2.dilate(inside, ball) > cv2.erode(inside, ball)
    encoder = Encoder()
    errors, sizes = {}, {}
    for alpha in (True, "straight"):
        encoded = encoder.encode(drawn, 80, crop, None, alpha)
        info = {"size": (side, side), "crop": encoded.boxes, "alpha": alpha}
        reply = Reply(1, {0: encoded.pictures[0]}, info, 0, {0: encoded.alphas[0]})
        mine, theirs = (p[..., :3] + (1 - p[..., 3:] / 255.0) * board for p in (reply.rgba()[0], drawn[0]))
        errors[alpha], sizes[alpha] = np.abs(mine - theirs)[rim].mean(), len(encoded.pictures[0])
    encoder.close()
    assert errors["straight"] <= 2.0 < errors[True]  # of 255: 1.8 and 3.7
    assert sizes["straight"] < sizes[True]
