"""The authors' released front end (docs/conventions.md), and the messages of older clients."""

from __future__ import annotations

import json
import math
import struct
from dataclasses import replace

import aiohttp
import numpy as np
import pytest
import simplejpeg

from glsplat.errors import ProtocolError
from glsplat.net.messages import Decoder, WireOptions
from glsplat.net.server import ServerConfig
from glsplat.skinning.skeleton import Skeleton
from tests.net.wire import HANG

SIZE, DISTANCE = 128, 2.0  # pixels, metres


def head(x=0.0, y=1.2):
    """In Unity's frame (left-handed, z forward): 2 m in front of the avatar, turned to face it, as both cameras say."""
    place = {"pos_x": x, "pos_y": y, "pos_z": DISTANCE}
    return place | {"rot_x": 0.0, "rot_y": 1.0, "rot_z": 0.0, "rot_w": 0.0}


SMPLX = {
    "root_pose": [0.0, 0.3, 0.0],
    "trans": [0.3, 0.9, 0.1],  # ignored by the server
    "body_pose": np.zeros((21, 3)).tolist(),
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
        return json.dumps({"frame_id": self.frame_id, "cameras": cameras, "smplx": SMPLX})

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


async def binary(ws):
    message = await ws.receive(timeout=HANG)
    assert message.type == aiohttp.WSMsgType.BINARY, message
    return message.data


@pytest.mark.parametrize("ipd", [0.0, 0.055])
async def test_the_released_client(serve, fake_backend, ipd):
    backend, client = fake_backend(), ReleasedClient()
    config = ServerConfig(port=0, wire=WireOptions(size=(SIZE, SIZE), ipd=ipd))
    async with serve(backend, config) as server, aiohttp.ClientSession() as http, http.ws_connect(server.url) as ws:
        for _ in range(40):
            await ws.send_str(client.request())
            client.receive(await binary(ws))
        totals = server.stats()["totals"]
    assert len(client.shown) == client.last == totals["sent"] == 40
    assert [totals[name] for name in ("dropped", "stale", "malformed", "failed", "limited")] == [0] * 5
    assert all(left.shape == right.shape == (SIZE, SIZE, 3) and left.max() > 50 for left, right in client.shown)
    # in Unity the head stands at z = 2 and is turned half about y: it looks at the origin, right is -x there, +x here
    left, right = backend.drawn[-1].cameras
    np.testing.assert_array_equal(backend.drawn[-1].pose.trans, 0)
    np.testing.assert_allclose(right.position - left.position, [ipd, 0, 0], atol=1e-9)
    middle = [-0.1 * np.sin(40 / 30), 1.2, DISTANCE]
    np.testing.assert_allclose((left.position + right.position) / 2, middle, atol=1e-9)
    np.testing.assert_allclose(left.viewmat[2, :3], [0, 0, -1], atol=1e-9)


async def test_a_client_without_frame_ids_is_served_in_order(serve, fake_backend):
    async with (
        serve(fake_backend()) as server,
        aiohttp.ClientSession() as http,
        http.ws_connect(server.url) as ws,
    ):
        ids = []
        for _ in range(4):
            cameras = [head() | {"eye": "left"}, head() | {"eye": "right"}]
            await ws.send_str(json.dumps({"cameras": cameras, "smplx": {"root_pose": [0, 0, 0]}}))
            ids.append(struct.unpack_from("<HI", await binary(ws), 2)[1])
        assert ids == [0, 1, 2, 3]


async def test_the_older_form_gets_one_message_an_eye(serve, fake_backend):
    """One camera a message, no frame_id; each answer is the number of the eye and a JPEG."""
    config = ServerConfig(port=0, wire=WireOptions(size=(SIZE, SIZE)))
    async with (
        serve(fake_backend(), config) as server,
        aiohttp.ClientSession() as http,
        http.ws_connect(server.url) as ws,
    ):
        for _ in range(10):
            for eye in ("left", "right"):
                await ws.send_str(json.dumps({"camera": head() | {"eye": eye}, "smplx": SMPLX}))
            pair = [await binary(ws) for _ in range(2)]
            assert [data[0] for data in pair] == [0, 1] and simplejpeg.decode_jpeg(pair[1][1:]).any()
        assert server.stats()["totals"]["sent"] == 20 and server.stats()["totals"]["malformed"] == 0


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
