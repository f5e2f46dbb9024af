"""Video as it is coded, decoded again by PyAV."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from glsplat.errors import GlsplatError
from glsplat.extras.far_links.video import CODECS, STEPS, VideoStream, available
from tests.net.clocks import Stopped

av = pytest.importorskip("av", reason="PyAV (glsplat[video]) is not installed")

RNG = np.random.default_rng(5)
PATTERN = np.kron(RNG.integers(40, 220, (40, 40, 3)), np.ones((8, 8, 1))).astype(np.uint8)


def moved(index, width=150, height=130, views=2):
    """Eyes with a patterned box that moves and changes its size."""
    out = np.zeros((views, height, width, 4), np.uint8)
    x, y, w, h = 5 + 7 * (index % 9), 3 + 5 * (index % 11), 61 - index % 5, 50 + index % 7
    w, h = min(w, width - x), min(h, height - y)
    for view in range(views):
        out[view, y : y + h, x : x + w, :3] = PATTERN[view : view + h, index % 8 : index % 8 + w]
        out[view, y : y + h, x : x + w, 3] = 128 + 12 * (index % 10)
    return out, (x, y, w, h)


def decoder(codec):
    found = av.CodecContext.create(codec, "r")
    found.options = {"flags": "low_delay"}
    return found


def decoded(context, encoded):
    (frame,) = context.decode(av.Packet(encoded.pictures[0]))
    return frame.to_ndarray(format="rgb24").astype(float)


@pytest.mark.parametrize("alpha", [False, True])
@pytest.mark.parametrize("codec", CODECS)
def test_each_picture_comes_back_at_once(codec, alpha):
    stream, reader = VideoStream(), decoder(codec)
    for index in range(8):
        images, box = moved(index)
        encoded = stream.encode(images, ["av2", codec], 90, box if index % 3 else None, alpha)
        said = encoded.video
        assert said["number"] == index + 1 and said["key"] == (index == 0) and encoded.ms > 0
        seen = decoded(reader, encoded)
        assert seen.shape[1::-1] == said["size"] and ("alpha" in said) == alpha
        for eye, (image, (x, y)) in enumerate(zip(images, said["eyes"], strict=True)):
            part = seen[y : y + 130, x : x + 150]
            assert np.abs(part - image[..., :3]).mean() < 4
            assert np.abs(part[image[..., 3] == 0]).mean() < 1.5  # what was there before is gone
            if alpha:
                x, y = said["alpha"][eye]
                assert np.abs(seen[y : y + 130, x : x + 150, 0] - image[..., 3]).mean() < 3


def test_quality_is_coarser_for_a_thin_link():
    images, box = moved(3)
    sizes = [len(VideoStream().encode(images, ["h264"], quality, box).pictures[0]) for quality in STEPS]
    assert sizes == sorted(sizes) and sizes[0] < 0.7 * sizes[-1]


def test_key_frames_are_not_given_without_end():
    clock = Stopped()
    stream, keys = VideoStream(clock), 0
    for index in range(300):  # 3 s
        images, box = moved(index, 64, 64, 1)
        keys += stream.encode(images, ["vp9"], 80, box, key=True).video["key"]
        clock.now += 0.01
    assert 5 <= keys <= 7


def test_another_form_begins_with_a_key_frame():
    clock = Stopped()
    stream = VideoStream(clock)
    small, large = moved(0, 64, 64)[0], moved(0, 96, 64)[0]
    assert stream.encode(small, ["vp9"]).video["key"]
    assert stream.encode(large, ["vp9"]) is None  # not so soon
    assert not stream.encode(small, ["vp9"]).video["key"]  # which changes nothing
    clock.now += 1
    said = stream.encode(large, ["vp9"]).video
    assert said["key"] and said["number"] == 3


@pytest.mark.parametrize(
    ("codecs", "width", "height"), [([], 64, 64), (["av1"], 64, 64), (["vp9"], 31, 64), (["h264"], 4096, 2305)]
)
def test_what_is_no_video_is_left_to_jpeg(codecs, width, height):
    assert VideoStream().encode(np.zeros((1, height, width, 4), np.uint8), codecs) is None


def test_after_a_fault_it_begins_anew(monkeypatch):
    stream, (images, box) = VideoStream(), moved(0)
    stream.encode(images, ["vp9"], 80, box)
    with monkeypatch.context() as broken:
        broken.setattr(VideoStream, "_code", lambda *_: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            stream.encode(images, ["vp9"], 80, box)
    assert stream._form == ()
    stream._opened = -np.inf
    assert stream.encode(images, ["vp9"], 80, box).video["key"]


def test_without_pyav_one_line_says_what_to_do(monkeypatch):
    assert available() == tuple(CODECS)
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(GlsplatError, match=r"pip install 'glsplat\[video\]'"):
        available()


def test_what_begins_anew_takes_a_part_of_the_time(monkeypatch):
    """On a machine where that takes 0.2 s: some forms at once, then one in two seconds, JPEGs in between."""
    clock, opened = Stopped(), []
    opening = VideoStream._open

    def slow(self, *form):
        opened.append(clock.now)
        opening(self, *form)
        clock.now += 0.2

    monkeypatch.setattr(VideoStream, "_open", slow)
    stream, start = VideoStream(clock), clock.now
    for index in range(200):
        stream.encode(moved(0, 64 + 2 * (index % 2), 64, 1)[0], ["vp9"])
        clock.now += 0.6
    seconds = clock.now - start
    assert len([at for at in opened if at < start + 4]) >= 4
    assert 0.05 * seconds <= 0.2 * len(opened) <= 0.1 * seconds + 1.2
    clock.now += 20
    assert stream.encode(moved(0, 96, 64, 1)[0], ["vp9"]).video["key"]


@pytest.mark.parametrize("quality", [STEPS[-1] + 1, 100])
def test_the_best_quality_is_the_last_step(quality: int) -> None:
    best, better = VideoStream(), VideoStream()
    images, box = moved(0)
    pictures = [stream.encode(images, CODECS, q, box).pictures for stream, q in ((best, STEPS[-1]), (better, quality))]
    assert pictures[0] == pictures[1]
