"""Alpha on the wire: over real sockets, against a renderer in this process; and the eyes a reply speaks of."""

from __future__ import annotations

import asyncio
import json
import struct
from dataclasses import replace

import aiohttp
import numpy as np
import pytest
import simplejpeg

from glsplat.camera import head_matrix, stereo_cameras
from glsplat.config import RenderConfig
from glsplat.data import default_avatar
from glsplat.errors import ProtocolError
from glsplat.net.backend import AvatarInfo, Solved
from glsplat.net.backends.server import make_server
from glsplat.net.backends.tracking import TrackingSolver
from glsplat.net.client import Client
from glsplat.net.messages import Decoder
from glsplat.net.reply import pack_reply, parse_reply
from glsplat.net.server import ServerConfig
from glsplat.renderer import Renderer
from glsplat.skinning.pose import Pose
from glsplat.tracking.calibration import Calibration
from tests.net.wire import HANG, native

SIZE = (160, 128)
PAIR = stereo_cameras(head_matrix((0.1, 1.0, 2.2), (0, 0, 0, 1)), size=SIZE)


@pytest.mark.gl
def test_alpha_is_that_of_a_direct_render():
    """Whole and cropped, one eye and two, from a picture whose edges are soft; without the wish nothing changes."""
    avatar = default_avatar()
    with Renderer(avatar, size=SIZE, views=2, config=RenderConfig(output="uint8")) as renderer:
        direct = renderer.render(PAIR).astype(float)
    assert ((direct[..., 3] > 20) & (direct[..., 3] < 235)).sum() > 100

    async def main():
        server = make_server(avatar, ServerConfig(port=0), own_process=False)
        await server.start()
        try:
            async with Client(server.url) as client:
                ask = [{"alpha": True}, {"alpha": True, "crop": True}, {"crop": True}, {}]
                replies = [await client.render(PAIR, quality=95, **more) for more in ask]
                single = await client.render(PAIR[:1], quality=95, alpha=True)
                return replies, single, await client.render(PAIR, quality=95, alpha="straight", crop=True)
        finally:
            await server.stop()

    (whole, cropped, only, plain), single, straight = asyncio.run(main())
    assert straight.info["alpha"] == "straight" and "alpha" not in whole.info
    for reply in (whole, cropped, single, straight):
        for mine, theirs in zip(reply.rgba(), direct, strict=False):
            assert mine.shape == (SIZE[1], SIZE[0], 4)
            assert np.abs(mine[..., 3] - theirs[..., 3]).mean() < 0.4
            assert np.abs(mine[..., 3] - theirs[..., 3]).max() < 40  # an edge in 8 bit through a JPEG
            room = np.array([30.0, 90.0, 200.0])  # what it is for: the person in front of something else
            over, expected = (p[..., :3] + (1 - p[..., 3:] / 255) * room for p in (mine.astype(float), theirs))
            assert np.abs(over - expected).mean() < 1.5
    assert list(single.alphas) == [0]
    x, _, w, h = cropped.info["crop"][0]
    assert simplejpeg.decode_jpeg(cropped.alphas[0], "GRAY").shape == (h, w, 1)
    assert simplejpeg.decode_jpeg_header(cropped.alphas[0])[2] == "Gray"
    assert not np.delete(cropped.rgba()[0], np.s_[x : x + w], axis=1).any()
    assert whole.pictures == plain.pictures and cropped.pictures == only.pictures  # colour is what it was
    assert not plain.alphas and plain.nbytes < whole.nbytes
    with pytest.raises(ProtocolError, match="ask for it with alpha=True"):
        plain.rgba()


def test_the_bytes_are_where_the_protocol_says(serve):
    """By hand, without the reader of this package: each eye's JPEG, then a length and a grey JPEG."""

    async def main():
        async with serve() as server, aiohttp.ClientSession() as http, http.ws_connect(server.url) as ws:
            await ws.send_str(native(1, alpha=True))
            asked = (await ws.receive(timeout=HANG)).data
            await ws.send_str(native(2, alpha=False))
            return asked, (await ws.receive(timeout=HANG)).data

    asked, plain = asyncio.run(main())
    offset, sizes = 9, []
    for eye in range(2):
        number, length = struct.unpack_from("<BI", asked, offset)
        assert number == eye
        offset += 5
        colour = simplejpeg.decode_jpeg(asked[offset : offset + length])
        offset += length
        (length,) = struct.unpack_from("<I", asked, offset)
        offset += 4
        alpha = simplejpeg.decode_jpeg(asked[offset : offset + length], "GRAY")
        offset += length
        assert colour.shape[:2] == alpha.shape[:2] == (64, 64)
        assert alpha.max() > 240 and alpha.min() < 10
        sizes.append(length + 4)
    (length,) = struct.unpack_from("<I", asked, offset)
    assert offset + 4 + length == len(asked)
    json.loads(asked[offset + 4 :])
    assert 0 < len(asked) - len(plain) - sum(sizes) + 40 < 80  # but for the numbers in the JSON, nothing else is new
    assert not parse_reply(plain).alphas and len(parse_reply(asked).alphas) == 2


def test_a_reply_with_alpha_is_told_from_one_without():
    """By what lies there, whatever the lengths: a length that looks like an eye, the highest a picture can have."""
    grey, colour = (b"\xff\xd8" + bytes(n) + b"\xff\xd9" for n in (252, 300))
    for alphas in (None, [grey, b"\xff\xd8"]):
        data = pack_reply(1, (0, 1), (colour, grey), {"t": None}, alphas)
        reply = parse_reply(data)
        assert reply.pictures == {0: colour, 1: grey} and reply.info == {"t": None} and reply.nbytes == len(data)
        assert reply.alphas == ({} if alphas is None else dict(enumerate(alphas)))
        for cut in range(len(data)):
            with pytest.raises(ProtocolError):
                parse_reply(data[:cut])


@pytest.mark.parametrize(
    ("value", "words"), [(1, "bool"), ("yes", '"straight", not'), (None, "bool"), ([True], "bool")]
)
def test_alpha_is_true_false_or_straight(value, words):
    with pytest.raises(ProtocolError, match=words):
        Decoder().decode(native(1, alpha=value))
    assert Decoder().decode(native(1, alpha="straight")).options.alpha == "straight"


def test_alpha_without_a_number_is_no_acknowledgement():
    with pytest.raises(ProtocolError, match="found alpha"):
        Decoder().decode('{"v": 1, "ack": 0, "alpha": true}')


class Fixed:
    """A solver that leaves pose and eyes as they are, in new objects."""

    def solve(self, request, now):
        return Solved(Pose.zero(), tuple(replace(camera) for camera in request.cameras))


@pytest.mark.parametrize("moves", [False, True])
def test_the_eyes_of_a_reply_are_those_asked_for_and_those_drawn(serve, moves, fake_backend):
    """A user of 1.25 times the avatar: the client's room has its own eyes, the picture was drawn with others."""
    backend, calibration = fake_backend(), Calibration(scale=1.25, floor=0.1)
    skeleton = default_avatar().skeleton

    def solver(height, span):
        return TrackingSolver(skeleton, calibration) if moves else Fixed()

    async def main():
        async with (
            serve(backend, offered=[AvatarInfo(name="default", solver=solver)]) as server,
            Client(server.url) as client,
        ):
            cameras = [replace(camera, near=0.5, far=20.0) for camera in PAIR]
            tracked = await client.render(cameras, tracking={"head": [0.1, 1.0, 2.2, 0, 0, 0, 1]})
            return tracked, await client.render(cameras, pose=Pose.zero())

    tracked, posed = asyncio.run(main())
    for reply in (tracked, posed):
        for eye, camera in zip(reply.info["eyes"], PAIR, strict=True):
            np.testing.assert_allclose(np.reshape(eye["viewmat"], (4, 4)), camera.viewmat)
            assert (eye["near"], eye["far"]) == (0.5, 20.0)
    assert "drawn" not in posed.info
    if not moves:
        assert "drawn" not in tracked.info
        return
    for eye, camera, drawn in zip(tracked.info["drawn"], PAIR, backend.drawn[0].cameras, strict=True):
        np.testing.assert_allclose(np.reshape(eye["viewmat"], (4, 4)), drawn.viewmat)
        np.testing.assert_allclose(drawn.position, (camera.position - (0, 0.1, 0)) / 1.25)
        assert (eye["near"], eye["far"]) == (0.4, 16.0)
