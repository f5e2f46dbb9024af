"""JPEG encoding and the binary reply."""

from __future__ import annotations

import struct

import numpy as np
import pytest
import simplejpeg
from hypothesis import given, settings
from hypothesis import strategies as st

from glsplat.errors import ProtocolError
from glsplat.net.codec.encode import Encoder, covered_box, encode_picture
from glsplat.net.reply import pack_reply, pack_single, parse_reply


@pytest.fixture(scope="module")
def encoder():
    encoder = Encoder()
    yield encoder
    encoder.close()


def gradient(height=96, width=128):
    y, x = np.mgrid[:height, :width]
    rgb = [x * 255 // width, y * 255 // height, (x + y) * 255 // (width + height)]
    return np.stack([*rgb, np.full_like(x, 255)], axis=-1).astype(np.uint8)


def psnr(a, b):
    return 10 * np.log10(255**2 / np.mean((a.astype(float) - b) ** 2))


def test_both_eyes_come_back(encoder):
    images = np.stack([gradient(), 255 - gradient()])
    out, coarse = encoder.encode(images, 90), encoder.encode(images, 20)
    assert out.boxes is None and out.ms > 0 and len(coarse.pictures[0]) < len(out.pictures[0])
    for image, picture in zip(images, out.pictures, strict=True):
        assert psnr(simplejpeg.decode_jpeg(picture), image[..., :3]) > 38
        assert simplejpeg.decode_jpeg_header(picture)[3] == "420"


@pytest.mark.parametrize("view", [np.s_[:, ::-1], np.s_[::-1], np.s_[8:40, 16:80], np.s_[::2, ::2], np.s_[..., :3]])
def test_any_view_of_an_array(view):
    image = gradient()[view]
    assert psnr(simplejpeg.decode_jpeg(encode_picture(image, 95)), image[..., :3]) > 33


def test_a_known_box_is_not_searched(encoder):
    images = np.zeros((2, 100, 90, 4), np.uint8)
    images[:, 40:50, 30:40] = 255
    assert encoder.encode(images, crop=True).boxes == [(16, 32, 32, 32)] * 2
    covered = tuple(np.array((33, 37, 3, 20)))  # numpy's integers, as the renderer gives them
    out = encoder.encode(images, crop=True, covered=covered)
    assert out.boxes == [(32, 32, 16, 32)] * 2 and all(type(n) is int for n in out.boxes[0])
    assert simplejpeg.decode_jpeg(out.pictures[0]).shape == (32, 16, 3)
    assert encoder.encode(images, crop=True, covered=(0, 0, 90, 100)).boxes == [(16, 32, 32, 32)] * 2  # says nothing
    assert encoder.encode(images, crop=True, covered=(0, 0, 0, 0)).boxes == [(0, 0, 16, 16)] * 2
    assert encoder.encode(images, crop=True, covered=(80, 90, 10, 10)).boxes == [(80, 80, 10, 20)] * 2
    assert encoder.encode(images, crop=True, covered=(90, 100, 0, 0)).boxes == [(80, 96, 10, 4)] * 2
    assert encoder.encode(images, covered=covered).boxes is None


def test_the_covered_box():
    image = np.zeros((100, 90, 4), np.uint8)
    assert covered_box(image) == (0, 0, 16, 16)
    image[37, 50, 3] = 1
    assert covered_box(image) == (48, 32, 16, 16)
    image[99, 89, 3] = 1
    assert covered_box(image) == (48, 32, 42, 68)
    assert covered_box(np.full((8, 5, 4), 255, np.uint8)) == (0, 0, 5, 8)


def test_cropping_loses_nothing_of_the_avatar(encoder):
    image = np.zeros((1, 96, 128, 4), np.uint8)
    image[0, 20:70, 30:90] = gradient()[20:70, 30:90]
    out = encoder.encode(image, 92, crop=True)
    reply = parse_reply(pack_reply(3, (0,), out.pictures, {"crop": out.boxes, "size": (128, 96)}))
    (back,) = reply.images()
    (whole,) = encoder.encode(image, 92).pictures
    assert len(out.pictures[0]) < len(whole)
    expected = simplejpeg.decode_jpeg(whole)
    np.testing.assert_array_equal(back[20:70, 30:90], expected[20:70, 30:90])  # the box lies on the codec's own grid
    assert np.abs(back.astype(int) - expected).max() <= 4  # the codec interpolates colour across the box's edge


def test_the_layout_of_a_reply():
    data = pack_reply(0xDEADBEEF, (0, 1), (b"left", b"right!"), {"t": 1.5})
    assert data[:9] == b"VR" + struct.pack("<HIB", 1, 0xDEADBEEF, 2)
    assert data[9:18] == b"\0" + struct.pack("<I", 4) + b"left"
    assert data[18:29] == b"\1" + struct.pack("<I", 6) + b"right!"
    assert data[29:] == struct.pack("<I", 9) + b'{"t":1.5}'
    reply = parse_reply(data)
    assert (reply.frame_id, reply.pictures, reply.info) == (0xDEADBEEF, {0: b"left", 1: b"right!"}, {"t": 1.5})
    assert reply.nbytes == len(data)
    assert pack_single(1, b"jpeg") == b"\1jpeg"


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_damaged_replies_are_protocol_errors(data):
    good = pack_reply(7, (0, 1), (b"abc", b"defg"), {"t": None})
    cut = good[: data.draw(st.integers(0, len(good) - 1))]
    with pytest.raises(ProtocolError):
        parse_reply(cut)
    noise = data.draw(st.binary(max_size=64))
    try:
        parse_reply(b"VR\1\0" + noise)
    except ProtocolError:
        pass


def test_pictures_that_are_none():
    with pytest.raises(ProtocolError, match="not a JPEG"):
        parse_reply(pack_reply(1, (0,), (b"nonsense",), {})).images()
    with pytest.raises(ProtocolError, match="version 1"):
        parse_reply(b"VR\2\0" + b"\0" * 20)
