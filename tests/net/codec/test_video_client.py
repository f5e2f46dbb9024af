"""The Python client takes video where the server has it."""

from __future__ import annotations

import asyncio
import sys

import numpy as np
import pytest

from glsplat.errors import GlsplatError, ProtocolError
from glsplat.extras.far_links.video import VideoReader, VideoStream
from glsplat.net.client import Client
from glsplat.net.server import ServerConfig

av = pytest.importorskip("av", reason="PyAV (glsplat[video]) is not installed")

WATCHES = ServerConfig(port=0, video=True)


def grey(reply, eye=1):
    """In the middle of the ellipse that the fake backend draws."""
    image = reply.images()[eye]
    return float(image[image.shape[0] // 2, image.shape[1] // 2].mean())


@pytest.mark.parametrize("codec", ["vp9", "h264"])
@pytest.mark.parametrize("alpha", [False, True, "straight"])
async def test_pictures_are_those_of_jpegs(serve, fake_backend, cameras, codec, alpha, monkeypatch):
    monkeypatch.setattr(VideoReader, "request_fields", lambda self: {"codecs": [codec]})
    async with serve(fake_backend(), WATCHES) as server:
        async with Client(server.url, video=True) as one, Client(server.url) as other:
            ask = {"quality": 90, "alpha": alpha}
            found = [(await one.render(cameras, **ask), await other.render(cameras, **ask)) for _ in range(6)]
    for number, (mine, theirs) in enumerate(found, 1):
        assert mine.info["video"]["number"] == number and "video" not in theirs.info
        assert mine.frame_id == theirs.frame_id == number
        pairs = zip(*((one.rgba() if alpha else one.images()) for one in (mine, theirs)), strict=True)
        for found, expected in pairs:
            assert found.shape == expected.shape and found.dtype == np.uint8
            assert np.abs(found.astype(float) - expected).mean() < 4
        assert not alpha or len(mine.alphas) == 0
    assert mine.nbytes < theirs.nbytes
    if not alpha:
        with pytest.raises(ProtocolError, match="alpha=True"):
            mine.rgba()


async def test_who_does_not_show_all_of_them_sees_the_newest_right(serve, fake_backend, cameras):
    """Pictures that nobody takes are decoded all the same."""
    async with serve(fake_backend(), WATCHES) as server, Client(server.url, video=True, window=8) as client:
        for number in range(1, 21):
            await client.send(cameras, quality=90)
            if number % 5 == 0:
                while (arrived := await client.receive()).reply.frame_id < client.newest:
                    pass
        reply = arrived.reply
    assert reply.frame_id == 20 and not reply.info["video"]["key"]
    assert abs(grey(reply) - (20 % 200 + 50)) < 6


async def test_after_a_loss_it_asks_for_a_key_frame(serve, fake_backend, cameras):
    async with serve(fake_backend(), WATCHES) as server, Client(server.url, video=True) as client:
        first = await client.render(cameras)
        (one,) = server.clients.values()
        one.video.stream._number += 1  # one that never came
        lost, said = await client.render(cameras), []
        for _ in range(40):
            said.append(await client.render(cameras))
            if said[-1].video:
                break
            await asyncio.sleep(0.03)
        found = said[-1]
    assert first.images() and not lost.video
    with pytest.raises(ProtocolError, match="did not arrive"):
        lost.images()
    with pytest.raises(ProtocolError, match="did not arrive"):
        lost.rgba()
    assert found.info["video"]["key"] and abs(grey(found) - (found.frame_id % 200 + 50)) < 6


def coded(**more):
    stream = VideoStream()
    images = np.full((2, 64, 80, 4), 90, np.uint8)
    found = [stream.encode(images, ["vp9"]) for _ in range(3)]
    return [(one.pictures[0], one.video | more, (80, 64)) for one in found]


@pytest.mark.parametrize(
    "more",
    [
        {"eyes": [(0, 0), (100, 0)]},
        {"eyes": [(-1, 0)]},
        {"eyes": 7},
        {"number": "x"},
        {"number": float("inf")},
        {"alpha": [(0, 0)]},
        {"eyes": {}, "alpha": [(0, 64), (80, 64)]},
        {"codec": "av01.0"},
        {"codec": None},
        {"eyes": None},
        {"number": None},
        {"alpha": [(0, 64)], "eyes": [(0, 0)]},
    ],
)
def test_a_reply_that_lies_is_no_picture(more):
    reader = VideoReader()
    assert reader.eyes(*coded(**more)[0]) == () and reader.request_fields()["key"] is True
    missing, said, size = coded()[0]
    said = {key: value for key, value in said.items() if key not in more}
    assert more.keys() == {"alpha"} or reader.eyes(missing, said, size) == ()
    assert len(reader.eyes(*coded()[0])) == 2 and "key" not in reader.request_fields()


def test_bytes_that_are_no_video():
    reader, (first, second, third) = VideoReader(), coded()
    assert reader.eyes(*first) and reader.eyes(b"nonsense" * 9, *second[1:]) == ()
    assert reader.eyes(*third) == () and reader.eyes(*coded()[0])


def test_without_pyav_one_line_says_what_to_do(monkeypatch):
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(GlsplatError, match=r"pip install 'glsplat\[video\]'"):
        Client("ws://127.0.0.1:1/ws", video=True)
    with pytest.raises(GlsplatError, match="video"):
        Client("ws://127.0.0.1:1/ws", video="yes")
    Client("ws://127.0.0.1:1/ws")
