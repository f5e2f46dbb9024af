"""A room behind a gateway: everybody in it is drawn by one worker, and by another when that one is killed."""

from __future__ import annotations

import os
import signal
from dataclasses import replace

import numpy as np
import pytest

from glsplat.camera import head_matrix, stereo_cameras
from glsplat.data import default_avatar
from glsplat.net.backends.server import make_server
from glsplat.net.client import Client
from glsplat.net.server import ServerConfig
from glsplat.net.workers.options import Workers
from glsplat.net.workers.pool import WorkerPool
from glsplat.scene import Scene
from tests.net.loops import in_a_loop
from tests.net.workers.fakes import GUARD, held, patient

pytestmark = pytest.mark.check

EYES = stereo_cameras(head_matrix((0, 1.5, 0.1), (0, 1, 0, 0)), size=(96, 96))
POSE = {"root_pose": [0, 0.1, 0]}


@pytest.mark.gl
@pytest.mark.usefixtures("nobody_fades")
@in_a_loop
async def test_a_room_survives_its_worker(monkeypatch: pytest.MonkeyPatch) -> None:
    patient(monkeypatch)
    person = replace(default_avatar().levels[-1].content, levels=())
    config = ServerConfig(port=0, rooms={"lab": 2})
    server = make_server(person, config, rooms={"lab": Scene()}, workers=Workers(count=2))
    await server.start()
    try:
        ann, bob = (Client(server.url, room="lab", name=name, timeout=GUARD) for name in ("Ann", "Bob"))
        async with ann, bob:
            for client in (ann, bob, ann, bob):
                reply = await client.render(EYES, pose=POSE, hide=["head"])
            whole = reply.images()
            assert [one["name"] for one in reply.info["room"]["people"]] == ["Ann", "Bob"]
            workers = server.stats()["workers"]
            assert sorted(worker["clients"] for worker in workers) == [0, 2]
            busy = next(i for i, worker in enumerate(workers) if worker["clients"])
            assert isinstance(server.render_loop, WorkerPool)
            held(server)  # they need not wait for a new one
            os.kill(server.render_loop._render_loops[busy].launcher._process.pid, signal.SIGKILL)  # type: ignore[attr-defined]
            replies = [await client.render(EYES, pose=POSE, hide=["head"]) for client in (ann, bob)]
            for client, reply in zip((ann, bob), replies, strict=True):
                assert len(reply.info["room"]["people"]) == 2
                assert client.flow.newest > 1  # the same connection
            assert np.array_equal(replies[1].images()[0], whole[0])
    finally:
        await server.stop()
