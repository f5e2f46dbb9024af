"""Whole JPEGs of which only the covered part is encoded."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import simplejpeg
from hypothesis import given, settings
from hypothesis import strategies as st

from glsplat.net.codec.encode import Encoder, encode_covered, encode_picture


def picture(width, height, box, seed=0):
    x, y, w, h = box
    image = np.zeros((height, width, 4), np.uint8)
    noise = np.random.default_rng(seed).integers(0, 256, (h // 4 + 1, w // 4 + 1, 4), np.uint8)
    image[y : y + h, x : x + w] = noise.repeat(4, 0).repeat(4, 1)[:h, :w]
    return image


def check(image, box, quality):
    """Compare with the codec's whole picture, read by two decoders. Return False where it was not worth while."""
    encoded = encode_covered(image, box, quality)
    if encoded is None:
        return False
    whole = encode_picture(image, quality)
    np.testing.assert_array_equal(simplejpeg.decode_jpeg(encoded), simplejpeg.decode_jpeg(whole))
    np.testing.assert_array_equal(*(cv2.imdecode(np.frombuffer(data, np.uint8), 1) for data in (encoded, whole)))
    return True


@pytest.mark.parametrize(
    ("size", "box"),
    [
        ((512, 512), (100, 50, 150, 300)),
        ((512, 512), (0, 0, 16, 16)),
        ((512, 256), (500, 240, 12, 16)),
        ((505, 250), (480, 200, 25, 50)),  # the last blocks are not whole
        ((13 * 32, 400), (48, 20, 60, 100)),
        ((144, 64), (0, 0, 0, 0)),  # nothing at all
        ((2048, 64), (1024, 0, 8, 64)),
    ],
)
@pytest.mark.parametrize("quality", [1, 50, 80, 100])  # 100: the black block begins with a byte of ones
def test_it_is_what_the_codec_makes_of_the_whole(size, box, quality):
    assert check(picture(*size, box), box, quality)
    assert encode_covered(picture(512, 512, (0, 0, 512, 500)), (0, 0, 512, 500), 80) is None  # no gain


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_any_box_in_any_picture(data):
    width, height = data.draw(st.integers(1, 900)), data.draw(st.integers(1, 150))
    x, y = data.draw(st.integers(0, width - 1)), data.draw(st.integers(0, height - 1))
    box = x, y, data.draw(st.integers(0, width - x)), data.draw(st.integers(0, height - y))
    check(picture(width, height, box, data.draw(st.integers(0, 9))), box, data.draw(st.integers(1, 100)))


def test_the_encoder_uses_it_for_whole_pictures():
    encoder = Encoder()
    try:
        box = (180, 100, 140, 333)
        image = picture(512, 512, box)
        known, unknown = (encoder.encode(image[None], 90, False, covered) for covered in (box, None))
        assert known.boxes is None and known.alphas is None
        assert b"\xff\xdd" in known.pictures[0] and b"\xff\xdd" not in unknown.pictures[0][:700]
        np.testing.assert_array_equal(*(simplejpeg.decode_jpeg(out.pictures[0]) for out in (known, unknown)))
    finally:
        encoder.close()
