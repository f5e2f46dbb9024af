"""The authors' released front end, transcribed from docs/conventions.md: what it sends, and how it reads replies.

It runs unchanged against the real server with the real renderer.
"""

from __future__ import annotations

import asyncio
import json
import struct
from dataclasses import replace

import aiohttp
import numpy as np
import pytest
import simplejpeg

from glsplat.data import default_avatar
from glsplat.net.backends.server import make_server
from glsplat.net.messages import WireOptions
from glsplat.net.server import ServerConfig
from tests.net.wire import HANG

pytestmark = pytest.mark.check

IPD, SIZE, DISTANCE = 0.055, 128, 2.0  # metres, pixels, metres
FOCAL = SIZE / 2 / np.tan(np.radians(65) / 2)


def head(x=0.0, y=1.2):
    """In Unity's frame (left-handed, z forward): 2 m in front of the avatar, turned to face it, as both cameras say."""
    place = {"pos_x": x, "pos_y": y, "pos_z": DISTANCE}
    return place | {"rot_x": 0.0, "rot_y": 1.0, "rot_z": 0.0, "rot_w": 0.0}


def smplx(frame):
    """Axis-angle joints of a moving body; ``trans`` is what the server has to ignore."""
    body = np.zeros((21, 3))
    body[15, 2] = -0.5 + 0.4 * np.sin(frame / 9)  # an arm goes up and down
    return {
        "root_pose": [0.0, 0.3 * float(np.sin(frame / 20)), 0.0],
        "trans": [0.3, 0.9, 0.1],
        "body_pose": body.tolist(),
        "lhand_pose": np.zeros((15, 3)).tolist(),
        "rhand_pose": np.full((15, 3), 0.1).tolist(),
    }


class ReleasedClient:
    """Stop and wait: the next request goes out when both eyes have come."""

    def __init__(self) -> None:
        self.frame_id = 0
        self.last = -1
        self.shown: list[tuple[np.ndarray, np.ndarray]] = []

    def request(self) -> str:
        self.frame_id += 1
        place = head(x=0.1 * np.sin(self.frame_id / 30))
        cameras = [place | {"eye": "left"}, place | {"eye": "right"}]
        return json.dumps({"frame_id": self.frame_id, "cameras": cameras, "smplx": smplx(self.frame_id)})

    def receive(self, data: bytes) -> None:
        assert data[:2] == b"VR"
        version, frame_id, count = struct.unpack_from("<HIB", data, 2)
        assert version == 1 and count == 2
        assert frame_id == self.frame_id
        if frame_id <= self.last:
            return
        self.last = frame_id
        offset, eyes = 9, {}
        for _ in range(count):
            eye, length = struct.unpack_from("<BI", data, offset)
            offset += 5
            eyes[eye] = simplejpeg.decode_jpeg(data[offset : offset + length])
            offset += length
        self.shown.append((eyes[0], eyes[1]))  # what follows the pictures is not read


def thinned(avatar, step=8):
    """Every ``step``-th splat, larger: the same person at a fraction of the time."""
    keep = np.arange(0, len(avatar.splats), step)
    splats, shapes = avatar.splats.take(keep), None if avatar.shapes is None else avatar.shapes.take(keep)
    splats = replace(splats, scales=splats.scales * step**0.5)
    return replace(avatar, splats=splats, skin=avatar.skin.take(keep), shapes=shapes)


async def session(frames, exchange, own_process=True, **wire):
    """A server with the real renderer; ``exchange(ws, frame)`` for each frame. Returns its results and the stats."""
    config = ServerConfig(port=0, wire=WireOptions(size=(SIZE, SIZE), **wire))
    server = make_server(thinned(default_avatar()), config, own_process=own_process)
    await server.start()
    try:
        async with aiohttp.ClientSession() as http, http.ws_connect(f"http://127.0.0.1:{server.port}/ws") as ws:
            results = [await exchange(ws, frame) for frame in range(frames)]
            return results, server.stats()
    finally:
        await server.stop()


async def binary(ws):
    message = await ws.receive(timeout=HANG)
    assert message.type == aiohttp.WSMsgType.BINARY, message
    return message.data


def disparity(left, right):
    """Pixels by which the avatar lies further left in the right eye's picture: middle of the opaque part of each row
    of the head and torso, whose depth is nearly the same."""
    rows, weights = [], []
    for image in (left, right):
        grey = image.astype(float).sum(axis=2)
        grey[grey < 24] = 0  # JPEG's noise on black
        rows.append((grey * (np.arange(SIZE) + 0.5)).sum(axis=1))
        weights.append(grey.sum(axis=1))
    used = (weights[0] > weights[0].max() / 4) & (weights[1] > 0)
    return float(np.median((rows[0] / np.maximum(weights[0], 1) - rows[1] / np.maximum(weights[1], 1))[used]))


@pytest.mark.gl
def test_three_hundred_frames_with_the_released_client():
    client = ReleasedClient()

    async def exchange(ws, frame):
        await ws.send_str(client.request())
        client.receive(await binary(ws))

    _, stats = asyncio.run(session(300, exchange))
    assert len(client.shown) == 300 and client.last == 300
    totals = stats["totals"]
    assert totals["sent"] == 300
    assert [totals[name] for name in ("dropped", "stale", "malformed", "failed", "limited")] == [0] * 5
    assert all(left.shape == right.shape == (SIZE, SIZE, 3) for left, right in client.shown)
    assert all(left.max() > 100 for left, _ in client.shown)
    assert len({left.tobytes() for left, _ in client.shown}) > 290  # it moves
    # the head is 2 m from the pelvis; the avatar's surface is nearer by half its thickness, about 0.1 m
    found = np.array([disparity(*pair) for pair in client.shown])
    near, far = FOCAL * IPD / (DISTANCE - 0.2), FOCAL * IPD / (DISTANCE + 0.05)
    assert far < np.median(found) < near  # 2.7 to 3.1 pixels
    assert np.all((far - 0.1 < found) & (found < near + 0.1))


@pytest.mark.gl
@pytest.mark.parametrize("ipd", [0.0, 0.063, 0.12])
def test_the_right_eye_is_shifted_by_the_distance_of_the_eyes(ipd):
    client = ReleasedClient()

    async def exchange(ws, frame):
        await ws.send_str(client.request())
        client.receive(await binary(ws))

    asyncio.run(session(3, exchange, own_process=False, ipd=ipd))
    left, right = client.shown[-1]
    assert (ipd == 0) == np.array_equal(left, right)
    assert disparity(left, right) == pytest.approx(FOCAL * ipd / (DISTANCE - 0.07), rel=0.06, abs=0.02)


@pytest.mark.gl
def test_the_older_form_gets_one_message_an_eye():
    """One camera a message, no frame_id; each answer is the number of the eye and a JPEG. 300 pictures."""

    async def exchange(ws, frame):
        for eye in ("left", "right"):
            text = json.dumps({"camera": head() | {"eye": eye}, "smplx": smplx(frame)})
            await ws.send_str(text)
        return [await binary(ws) for _ in range(2)]

    pairs, stats = asyncio.run(session(150, exchange))
    shifts = []
    for left, right in pairs:
        assert (left[0], right[0]) == (0, 1)
        shifts.append(disparity(*(simplejpeg.decode_jpeg(data[1:]) for data in (left, right))))
    assert stats["totals"]["sent"] == 300 and stats["totals"]["malformed"] == 0
    assert np.median(shifts) == pytest.approx(FOCAL * IPD / (DISTANCE - 0.07), rel=0.06)


def test_both_cameras_carry_the_head(serve, fake_backend):
    """Unity's left-handed head pose becomes two eyes; the body's translation is ignored."""
    backend = fake_backend()
    client = ReleasedClient()

    async def main():
        async with serve(backend) as server, aiohttp.ClientSession() as http, http.ws_connect(server.url) as ws:
            for _ in range(3):
                await ws.send_str(client.request())
                client.receive(await binary(ws))

    asyncio.run(main())
    request = backend.drawn[-1]
    np.testing.assert_array_equal(request.pose.trans, 0)
    # in Unity the head stands at z = 2 and is turned half about y: it looks at the origin, right is -x there, +x here
    left, right = request.cameras
    np.testing.assert_allclose(right.position - left.position, [IPD, 0, 0], atol=1e-9)
    middle = [-0.1 * np.sin(0.1), 1.2, DISTANCE]
    np.testing.assert_allclose((left.position + right.position) / 2, middle, atol=1e-9)
    np.testing.assert_allclose(left.viewmat[2, :3], [0, 0, -1], atol=1e-9)


def test_a_client_without_frame_ids_is_served_in_order(serve, fake_backend):
    async def main():
        async with serve(fake_backend()) as server, aiohttp.ClientSession() as http:
            async with http.ws_connect(server.url) as ws:
                ids = []
                for _ in range(4):
                    cameras = [head() | {"eye": "left"}, head() | {"eye": "right"}]
                    await ws.send_str(json.dumps({"cameras": cameras, "smplx": {"root_pose": [0, 0, 0]}}))
                    ids.append(struct.unpack_from("<HI", await binary(ws), 2)[1])
                return ids

    assert asyncio.run(main()) == [0, 1, 2, 3]
