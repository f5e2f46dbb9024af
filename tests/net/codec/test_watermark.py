"""A server that marks: each session by an id of its own, in the log, in /stats, and in its pictures."""

from __future__ import annotations

import asyncio
import logging

import numpy as np
import pytest

from glsplat.camera import head_matrix, stereo_cameras
from glsplat.data import default_avatar
from glsplat.extras.watermark.detect import detect
from glsplat.extras.watermark.mark import WatermarkKey
from glsplat.formats.motion_files import load_embedded_motion
from glsplat.net.client import Client
from glsplat.net.served_scene import gl_server
from glsplat.net.server import ServerConfig
from glsplat.net.session import SessionConfig
from tests.net.running import running

pytestmark = pytest.mark.check

WATERMARK = WatermarkKey(0x1A2B, b"sixteen bytes 01")
CONFIG = ServerConfig(port=0, session=SessionConfig(watermark=WATERMARK))


@pytest.mark.gl
def test_pictures_lead_to_their_session(caplog):
    avatar, size = default_avatar(), (448, 448)
    motion = load_embedded_motion("walk", avatar.skeleton)
    eyes = stereo_cameras(head_matrix((0, 0.35, 1.0), (0, 0, 0, 1)), size=size)

    async def watch(server):
        async with Client(server.url) as client:
            replies = [await client.render(eyes, pose=motion.pose(frame), quality=60) for frame in range(6)]
            (row,) = server.stats()["clients"]
            return [reply.images()[0] for reply in replies], row["mark"]

    async def main():
        async with running(gl_server(avatar, CONFIG)) as server:
            return [await watch(server) for _ in range(2)]

    with caplog.at_level(logging.INFO, "glsplat.net.session"):
        (first, one), (second, two) = asyncio.run(main())
    logged = [record.getMessage() for record in caplog.records if record.name == "glsplat.net.session"]
    assert one != two and len(logged) == 2
    for pictures, told, line in ((first, one, logged[0]), (second, two, logged[1])):
        found = detect(pictures, WATERMARK.key)
        assert found is not None and f"{found.session:08x}" == told and found.server == WATERMARK.server
        assert line.endswith(f"is marked as session {told}") and WATERMARK.key.hex() not in line
        assert detect(pictures, b"sixteen bytes 02") is None


def test_a_server_marks_where_it_is_told_to(serve, fake_backend):
    eyes = stereo_cameras(np.eye(4), size=(64, 64))

    async def main(config):
        backend = fake_backend()
        async with serve(backend, config) as server, Client(server.url) as client:
            await client.render(eyes)
            return backend.drawn[0].mark, server.stats()["clients"][0]["mark"]

    assert asyncio.run(main(ServerConfig(port=0))) == (None, None)
    mark, told = asyncio.run(main(CONFIG))
    assert (mark.server, mark.key, f"{mark.session:08x}") == (WATERMARK.server, WATERMARK.key, told)
