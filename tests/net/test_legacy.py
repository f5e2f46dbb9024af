"""The authors' released front end, transcribed from docs/conventions.md: what it sends, and how it reads replies."""

from __future__ import annotations

import asyncio
import json
import struct

import aiohttp
import numpy as np
import simplejpeg

from glsplat.net.messages import WireOptions
from glsplat.net.server import ServerConfig


class ReleasedClient:
    """Stop and wait: the next request goes out when both eyes have come."""

    def __init__(self) -> None:
        self.frame_id = 0
        self.last = -1
        self.shown: list[tuple[np.ndarray, np.ndarray]] = []

    def request(self) -> str:
        self.frame_id += 1
        head = {"pos_x": 0.1, "pos_y": 1.6, "pos_z": 2.0, "rot_x": 0.0, "rot_y": 1.0, "rot_z": 0.0, "rot_w": 0.0}
        return json.dumps(
            {
                "frame_id": self.frame_id,
                "cameras": [head | {"eye": "left"}, head | {"eye": "right"}],
                "smplx": {
                    "root_pose": [0.0, 0.1, 0.0],
                    "trans": [0.3, 0.9, 0.1],
                    "body_pose": np.zeros((21, 3)).tolist(),
                    "lhand_pose": np.zeros((15, 3)).tolist(),
                    "rhand_pose": np.zeros((15, 3)).tolist(),
                },
            }
        )

    def receive(self, data: bytes) -> None:
        assert data[:2] == b"VR"
        version, frame_id, count = struct.unpack_from("<HIB", data, 2)
        assert version == 1 and count == 2
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


def test_thirty_frames_with_the_released_client(serve, fake_backend):
    backend = fake_backend()
    client = ReleasedClient()
    config = ServerConfig(port=0, wire=WireOptions(size=(128, 128)))

    async def main():
        async with serve(backend, config) as server, aiohttp.ClientSession() as http:
            async with http.ws_connect(f"http://127.0.0.1:{server.port}/ws") as ws:
                for _ in range(30):
                    await ws.send_str(client.request())
                    client.receive((await ws.receive(timeout=2)).data)
                return server.stats()

    stats = asyncio.run(main())
    assert len(client.shown) == 30 and client.last == 30
    assert all(left.shape == right.shape == (128, 128, 3) for left, right in client.shown)
    assert not np.array_equal(*client.shown[0])
    assert stats["totals"]["sent"] == 30 and stats["totals"]["dropped"] == stats["totals"]["malformed"] == 0
    request = backend.drawn[-1]
    np.testing.assert_array_equal(request.pose.trans, 0)
    # in Unity the head stands at z = 2 and is turned half about y: it looks at the origin, right is -x there, +x here
    left, right = request.cameras
    np.testing.assert_allclose(right.position - left.position, [0.055, 0, 0], atol=1e-9)
    np.testing.assert_allclose((left.position + right.position) / 2, [-0.1, 1.6, 2.0], atol=1e-9)
    np.testing.assert_allclose(left.viewmat[2, :3], [0, 0, -1], atol=1e-9)


def test_the_oldest_form_gets_one_message_an_eye(serve):
    head = {"pos_x": 0, "pos_y": 1.6, "pos_z": 2, "rot_x": 0, "rot_y": 1, "rot_z": 0, "rot_w": 0}
    config = ServerConfig(port=0, wire=WireOptions(size=(64, 64)))

    async def main():
        async with serve(config=config) as server, aiohttp.ClientSession() as http:
            async with http.ws_connect(server.url) as ws:
                out = []
                for _ in range(5):
                    for eye in ("left", "right"):
                        await ws.send_str(
                            json.dumps({"camera": head | {"eye": eye}, "smplx": {"root_pose": [0, 0, 0]}})
                        )
                    out.append([(await ws.receive(timeout=2)).data for _ in range(2)])
                return out

    for left, right in asyncio.run(main()):
        assert (left[0], right[0]) == (0, 1)
        assert simplejpeg.decode_jpeg(left[1:]).shape == (64, 64, 3)
