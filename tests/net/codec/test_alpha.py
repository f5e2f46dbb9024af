"""Alpha on the wire, against a direct render; and the eyes of a reply."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import simplejpeg

from glsplat.camera import head_matrix, stereo_cameras
from glsplat.config import RenderConfig
from glsplat.data import default_avatar
from glsplat.errors import ProtocolError
from glsplat.net.backend import AvatarInfo
from glsplat.net.backends.tracking import TrackingSolver
from glsplat.net.client import Client
from glsplat.net.messages import Decoder
from glsplat.net.reply import pack_reply, parse_reply
from glsplat.net.served_scene import gl_server
from glsplat.net.server import ServerConfig
from glsplat.renderer import Renderer
from glsplat.scene import similarity
from glsplat.skinning.pose import Pose
from glsplat.tracking.calibration import Calibration
from tests.net.running import running
from tests.net.wire import native

SIZE = (160, 128)
PAIR = stereo_cameras(head_matrix((0.1, 1.0, 2.2), (0, 0, 0, 1)), size=SIZE)


@pytest.mark.gl
async def test_alpha_is_that_of_a_direct_render():
    """Whole and cropped, one eye and two; without the wish nothing changes."""
    avatar = default_avatar()
    with Renderer(avatar, size=SIZE, views=2, config=RenderConfig(output="uint8")) as renderer:
        direct = renderer.render(PAIR).astype(float)
    assert ((direct[..., 3] > 20) & (direct[..., 3] < 235)).sum() > 100
    asked = [{"alpha": True}, {"alpha": True, "crop": True}, {"alpha": "straight", "crop": True}, {"crop": True}, {}]
    async with running(gl_server(avatar, ServerConfig(port=0), own_process=False)) as server:
        async with Client(server.url) as client:
            replies = [await client.render(PAIR, quality=95, **more) for more in asked]
            whole, cropped, straight, only, plain, single = (
                *replies,
                await client.render(PAIR[:1], quality=95, alpha=True),
            )
    assert straight.info["alpha"] == "straight" and "alpha" not in whole.info and list(single.alphas) == [0]
    for reply in (whole, cropped, single, straight):
        for mine, theirs in zip(reply.rgba(), direct, strict=False):
            assert mine.shape == (SIZE[1], SIZE[0], 4)
            assert np.abs(mine[..., 3] - theirs[..., 3]).mean() < 0.4
            assert np.abs(mine[..., 3] - theirs[..., 3]).max() < 40  # an edge in 8 bit through a JPEG
            room = np.array([30.0, 90.0, 200.0])  # the person in front of something else
            over, expected = (p[..., :3] + (1 - p[..., 3:] / 255) * room for p in (mine.astype(float), theirs))
            assert np.abs(over - expected).mean() < 1.5
    x, _, w, h = cropped.info["crop"][0]
    assert simplejpeg.decode_jpeg(cropped.alphas[0], "GRAY").shape == (h, w, 1)
    assert not np.delete(cropped.rgba()[0], np.s_[x : x + w], axis=1).any()
    assert whole.pictures == plain.pictures and cropped.pictures == only.pictures  # colour is what it was
    assert not plain.alphas and plain.nbytes < whole.nbytes
    with pytest.raises(ProtocolError, match="ask for it with alpha=True"):
        plain.rgba()


def test_a_reply_with_alpha_is_told_from_one_without():
    """Also where a length looks like an eye."""
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
    ("message", "words"),
    [
        (native(1, alpha=1), "bool"),
        (native(1, alpha=None), "bool"),
        (native(1, alpha="yes"), '"straight", not'),
        ('{"v": 1, "ack": 0, "alpha": true}', "found alpha"),
    ],
)
def test_alpha_is_true_false_or_straight(message, words):
    with pytest.raises(ProtocolError, match=words):
        Decoder().decode(message)
    assert Decoder().decode(native(1, alpha="straight")).options.alpha == "straight"


async def test_the_eyes_of_a_reply_are_those_asked_for_and_those_drawn(serve, fake_backend):
    """A user of 1.25 times the avatar: the avatar is placed in the client's room; its own space has other eyes."""
    backend, calibration = fake_backend(), Calibration(scale=1.25, floor=0.1)
    solver = TrackingSolver(default_avatar().skeleton, calibration)
    offered = [AvatarInfo(name="default", solver=lambda height, span: solver)]
    async with serve(backend, offered=offered) as server, Client(server.url) as client:
        cameras = [replace(camera, near=0.5, far=20.0) for camera in PAIR]
        tracked = await client.render(cameras, tracking={"head": [0.1, 1.0, 2.2, 0, 0, 0, 1]})
        posed = await client.render(cameras, pose=Pose.zero())
    for reply in (tracked, posed):
        for eye, camera in zip(reply.info["eyes"], PAIR, strict=True):
            np.testing.assert_allclose(np.reshape(eye["viewmat"], (4, 4)), camera.viewmat)
            assert (eye["near"], eye["far"]) == (0.5, 20.0)
    assert "drawn" not in posed.info
    place = backend.drawn[0].to_user
    np.testing.assert_allclose(place, similarity((0, 0.1, 0), scale=1.25))
    for eye, camera, drawn in zip(tracked.info["drawn"], PAIR, backend.drawn[0].cameras, strict=True):
        np.testing.assert_allclose(drawn.viewmat, camera.viewmat)
        viewmat = camera.viewmat @ place  # which scales all lengths
        viewmat[:3] /= 1.25
        np.testing.assert_allclose(np.reshape(eye["viewmat"], (4, 4)), viewmat)
        assert (eye["near"], eye["far"]) == (0.4, 16.0)
