"""Whole JPEGs of which only the covered part is encoded."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import simplejpeg
from hypothesis import given, settings
from hypothesis import strategies as st

from glsplat.net.codec.encode import Encoder
from glsplat.net.codec.partial import encode_covered


def picture(width, height, box, seed=0):
    x, y, w, h = box
    image = np.zeros((height, width, 4), np.uint8)
    noise = np.random.default_rng(seed).integers(0, 256, (h // 4 + 1, w // 4 + 1, 4), np.uint8)
    image[y : y + h, x : x + w] = noise.repeat(4, 0).repeat(4, 1)[:h, :w]
    return image


def at_once(image, interval, quality):
    """The same picture from the codec alone."""
    options = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_RST_INTERVAL, interval]
    options += [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420]
    return cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGBA2BGR), options)[1].tobytes()


@pytest.mark.parametrize(
    ("size", "box", "interval"),
    [
        ((512, 512), (100, 50, 150, 300), 8),
        ((512, 512), (0, 0, 16, 16), 8),
        ((512, 256), (500, 240, 12, 16), 8),
        ((505, 250), (480, 200, 25, 50), 8),  # the last blocks are not whole
        ((1008, 200), (300, 20, 100, 100), 7),
        ((144, 64), (0, 0, 0, 0), 9),  # nothing at all
    ],
)
@pytest.mark.parametrize("quality", [5, 80, 100])
def test_the_bytes_are_those_of_the_codec(size, box, interval, quality):
    image = picture(*size, box)
    assert encode_covered(image, box, quality) == at_once(image, interval, quality)


@settings(max_examples=80, deadline=None)
@given(st.data())
def test_any_box_in_any_picture(data):
    width, height = data.draw(st.integers(1, 400)), data.draw(st.integers(1, 150))
    x, y = data.draw(st.integers(0, width - 1)), data.draw(st.integers(0, height - 1))
    box = x, y, data.draw(st.integers(0, width - x)), data.draw(st.integers(0, height - y))
    image = picture(width, height, box, data.draw(st.integers(0, 9)))
    encoded = encode_covered(image, box, 75)
    if encoded is None:
        return
    blocks = -(-width // 16)
    assert any(encoded == at_once(image, n, 75) for n in range(4, 13) if blocks % n == 0)


def test_where_it_is_no_gain_the_codec_does_all():
    assert encode_covered(picture(512, 512, (0, 0, 512, 500)), (0, 0, 512, 500), 80) is None
    assert encode_covered(picture(13 * 16, 64, (0, 0, 9, 9)), (0, 0, 9, 9), 80) is None  # 13 blocks: no interval fits


def test_the_encoder_uses_it_for_whole_pictures():
    encoder = Encoder()
    try:
        box = (180, 100, 140, 333)
        image = picture(512, 512, box)
        known, unknown = (encoder.encode(image[None], 90, False, covered) for covered in (box, None))
        assert known.boxes is None and b"\xff\xdd" in known.pictures[0] and b"\xff\xdd" not in unknown.pictures[0][:700]
        a, b = (simplejpeg.decode_jpeg(out.pictures[0]).astype(int) for out in (known, unknown))
        assert a.shape == b.shape == (512, 512, 3)
        errors = [((decoded - image[..., :3].astype(int)) ** 2).mean() for decoded in (a, b)]
        assert errors[0] < 1.02 * errors[1]  # at least as near to the picture as the codec's faster transform
        assert not a[:, :100].any() and not a[450:].any()
    finally:
        encoder.close()
