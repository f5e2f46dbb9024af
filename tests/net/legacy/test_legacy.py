"""The authors' released front end (docs/conventions.md), and the messages of older clients."""

from __future__ import annotations

import asyncio
import json
import math
import struct
from dataclasses import replace

import aiohttp
import numpy as np
import pytest
import simplejpeg

from glsplat.data import default_avatar
from glsplat.errors import ProtocolError
from glsplat.net.backends.server import make_server
from glsplat.net.messages import Decoder, WireOptions
from glsplat.net.server import ServerConfig
from glsplat.skinning.skeleton import Skeleton
from tests.net.wire import HANG

IPD, SIZE, DISTANCE = 0.055, 128, 2.0  # metres, pixels, metres
FOCAL = SIZE / 2 / np.tan(np.radians(65) / 2)


def head(x=0.0, y=1.2):
    """In Unity's frame (left-handed, z forward): 2 m in front of the avatar, turned to face it, as both cameras say."""
    place = {"pos_x": x, "pos_y": y, "pos_z": DISTANCE}
    return place | {"rot_x": 0.0, "rot_y": 1.0, "rot_z": 0.0, "rot_w": 0.0}


def smplx(frame):
    """Axis-angle joints of a moving body; the server ignores ``trans``."""
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
    """Sends the next request when both eyes have come."""

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
    """Serve with the real renderer; return the results of ``exchange(ws, frame)`` and the stats."""
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
    """Median shift in pixels of the opaque rows of head and torso, left to right."""
    rows, weights = [], []
    for image in (left, right):
        grey = image.astype(float).sum(axis=2)
        grey[grey < 24] = 0  # JPEG's noise on black
        rows.append((grey * (np.arange(SIZE) + 0.5)).sum(axis=1))
        weights.append(grey.sum(axis=1))
    used = (weights[0] > weights[0].max() / 4) & (weights[1] > 0)
    return float(np.median((rows[0] / np.maximum(weights[0], 1) - rows[1] / np.maximum(weights[1], 1))[used]))


@pytest.mark.check
@pytest.mark.gl
@pytest.mark.parametrize(("ipd", "frames"), [(IPD, 60), (0.0, 3), (0.12, 3)])
def test_the_released_client(ipd, frames):
    client = ReleasedClient()

    async def exchange(ws, frame):
        await ws.send_str(client.request())
        client.receive(await binary(ws))

    _, stats = asyncio.run(session(frames, exchange, own_process=ipd == IPD, ipd=ipd))
    assert len(client.shown) == client.last == stats["totals"]["sent"] == frames
    assert [stats["totals"][name] for name in ("dropped", "stale", "malformed", "failed", "limited")] == [0] * 5
    assert all(left.shape == right.shape == (SIZE, SIZE, 3) and left.max() > 100 for left, right in client.shown)
    assert len({left.tobytes() for left, _ in client.shown}) > 0.9 * frames  # it moves
    assert (ipd == 0) == all(np.array_equal(left, right) for left, right in client.shown)
    # the head is 2 m from the pelvis; the avatar's surface is nearer by half its thickness, about 0.1 m
    found = np.array([disparity(*pair) for pair in client.shown])
    near, far = FOCAL * ipd / (DISTANCE - 0.2), FOCAL * ipd / (DISTANCE + 0.05)
    assert far <= np.median(found) <= near and np.all((far - 0.1 < found) & (found < near + 0.1))


@pytest.mark.check
@pytest.mark.gl
def test_the_older_form_gets_one_message_an_eye():
    """One camera a message, no frame_id; each answer is the number of the eye and a JPEG."""

    async def exchange(ws, frame):
        for eye in ("left", "right"):
            await ws.send_str(json.dumps({"camera": head() | {"eye": eye}, "smplx": smplx(frame)}))
        return [await binary(ws) for _ in range(2)]

    pairs, stats = asyncio.run(session(30, exchange))
    assert all((left[0], right[0]) == (0, 1) for left, right in pairs)
    shifts = [disparity(*(simplejpeg.decode_jpeg(data[1:]) for data in pair)) for pair in pairs]
    assert stats["totals"]["sent"] == 60 and stats["totals"]["malformed"] == 0
    assert np.median(shifts) == pytest.approx(FOCAL * IPD / (DISTANCE - 0.07), rel=0.06)


def decode(message, options=None):
    return Decoder(options).decode(json.dumps(message))


def unity_camera(position, quat_xyzw, eye):
    names = ("pos_x", "pos_y", "pos_z", "rot_x", "rot_y", "rot_z", "rot_w")
    return dict(zip(names, map(float, (*position, *quat_xyzw)), strict=True)) | {"eye": eye}


def test_a_unity_head_sees_what_it_saw_in_unity(rng):
    """Points in front of a left-handed camera keep their place; only the eye's offset is added."""
    from scipy.spatial.transform import Rotation

    options = WireOptions(ipd=0.06)
    for _ in range(20):
        turn, place = Rotation.random(random_state=int(rng.integers(1e6))), rng.normal(size=3)
        cameras = [unity_camera(place, turn.as_quat(), eye) for eye in ("right", "left")]
        request = decode({"frame_id": 1, "cameras": cameras, "smplx": {}}, options)
        for camera, offset in zip(request.cameras, (-0.03, 0.03), strict=True):
            point = rng.normal(size=3)
            x, y, z = turn.inv().apply(point - place)  # Unity: right, up, forward of the head
            ours = camera.viewmat @ (*(point * (-1, 1, 1)), 1)
            np.testing.assert_allclose(ours[:3], [x - offset, -y, z], atol=1e-9)


def test_old_forms():
    head = unity_camera((0, 1.6, -2), (0, 0, 0, 1), "right")
    smplx = {"root_pose": [0, 0.5, 0], "trans": [9, 9, 9], "body_pose": [0.0] * 63, "lhand_pose": [0.1] * 45}
    options = WireOptions(size=(512, 256), quality=70)
    request = decode({"camera": head, "smplx": smplx}, options)
    assert request.form == "single-legacy" and request.eyes == (1,) and request.frame_id is None
    assert (request.cameras[0].width, request.cameras[0].height, request.options.quality) == (512, 256, 70)
    np.testing.assert_array_equal(request.pose.trans, 0)  # ignored, as their server does
    np.testing.assert_allclose(request.pose.rotations[0], [0, 0.5, 0])
    np.testing.assert_allclose(request.pose.rotations[25:40], 0.1)
    fov = 2 * math.degrees(math.atan(128 / request.cameras[0].K[1, 1]))
    assert fov == pytest.approx(65)
    bundle = decode({"frame_id": 3, "cameras": [head, head | {"eye": "left"}], "smplx": smplx})
    assert bundle.form == "bundle-legacy" and bundle.eyes == (0, 1) and bundle.frame_id == 3
    assert bundle.cameras[0].name == "left"


def test_a_pose_is_for_the_rig_that_is_shown():
    head = unity_camera((0, 1.6, -2), (0, 0, 0, 1), "left")
    rod = Skeleton.from_joints(["root", "tip"], [-1, 0], [[0, 0, 0], [0, 1, 0]])
    text = json.dumps({"frame_id": 4, "cameras": [head], "smplx": {"root_pose": [0, 0.5, 0]}})
    with pytest.raises(ProtocolError, match="takes poses") as refused:
        Decoder(skeleton=rod).decode(text)
    assert (refused.value.code, refused.value.frame_id) == ("bad_pose", 4)
    assert Decoder(skeleton=rod).decode(json.dumps({"frame_id": 4, "cameras": [head]})).pose is None


@pytest.mark.parametrize(
    "message",
    [
        {"cameras": []},
        {"cameras": [unity_camera((0, 0, 0), (0, 0, 0, 1), "left")] * 2},
        {"cameras": [unity_camera((0, 0, 0), (0, 0, 0, 0), "left")]},
        {"cameras": [unity_camera((0, 1e9, 0), (0, 0, 0, 1), "left")]},
        {"cameras": [unity_camera((0, 0, 0), (0, 0, 0, 1), "middle")]},
        {"camera": {"pos_x": 0}},
        {"camera": unity_camera((0, 0, 0), (0, 0, 0, 1), "left"), "smplx": {"body_pose": [1, 2]}},
        {"camera": unity_camera((0, 0, 0), (0, 0, 0, 1), "left"), "frame_id": -4},
    ],
)
def test_old_forms_are_checked_too(message):
    with pytest.raises(ProtocolError) as caught:
        decode(message)
    assert len(str(caught.value)) <= 300 and "\n" not in str(caught.value)
