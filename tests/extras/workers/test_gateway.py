"""The gateway as a program: restarted by a signal and killed; its pictures beside those of a server alone."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

import glsplat
from apps.serve.wiring import assemble
from glsplat.camera import head_matrix, stereo_cameras
from glsplat.extras.workers.pool import Workers
from glsplat.formats.scene_file import SceneFile
from glsplat.net.client import Client
from glsplat.net.served_scene import ServedScene
from glsplat.net.server import ServerConfig
from tests.extras.workers.fakes import GUARD, until
from tests.net.running import running

pytestmark = pytest.mark.check

ROOT = Path(__file__).resolve().parents[3]
GATEWAY = """
import asyncio, json
from glsplat.net.options import ServerConfig
from glsplat.net.served_scene import server_of
from tests.extras.workers.fakes import pool
if __name__ == "__main__":
    server = server_of(pool(2), ServerConfig(port=0))
    asyncio.run(server.run(lambda: print(json.dumps(server.drawer.workers()), flush=True)))
"""


def runs(pid: int) -> bool:
    """Whether the process lives; a zombie does not."""
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def test_workers_are_started_anew_by_a_signal_and_end_with_their_gateway(tmp_path):
    script = tmp_path / "gateway.py"
    script.write_text(GATEWAY)
    environment = {**os.environ, "PYTHONPATH": "."}
    with subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, cwd=ROOT, env=environment) as gateway:
        try:
            first = {int(one["driver"].split()[1]) for one in json.loads(gateway.stdout.readline())}

            def workers() -> set[int]:
                return {one.pid for one in psutil.Process(gateway.pid).children() if runs(one.pid)}

            assert first <= workers()
            gateway.send_signal(signal.SIGHUP)
            assert asyncio.run(until(lambda: not first & workers() and len(workers()) >= len(first)))
            second = workers()
        finally:
            gateway.kill()
        assert asyncio.run(until(lambda: not any(map(runs, second))))


@pytest.mark.gl
def test_a_worker_draws_what_a_server_alone_draws():
    """The same JPEGs byte by byte; poses, boxes and tracking reach the worker."""
    avatar = glsplat.default_avatar()
    cameras = stereo_cameras(head_matrix((0, 1.4, 1.2), (0, 0, 0, 1)), size=(128, 128))
    pose = {"body_pose": [[0.1 * (i % 3), 0, 0.05 * (i % 5)] for i in range(21)]}
    tracking = {"head": [0, 1.6, 0, 0, 0, 0, 1], "left": [0.3, 1.2, -0.3, 0, 0, 0, 1], "right": None}

    async def ask(workers):
        served = ServedScene(file=SceneFile.of(avatar))
        async with running(assemble(served, ServerConfig(port=0), workers=workers)) as server:
            async with Client(server.url, timeout=GUARD) as client:
                replies = [
                    await client.render(cameras),
                    await client.render(cameras, pose=pose, crop=True, alpha="straight", box=True, hide=["head"]),
                    await client.render(cameras, tracking=tracking),
                ]
                infos = [{k: v for k, v in one.info.items() if k not in ("t", "times")} for one in replies]
                return [(one.pictures, one.alphas, info) for one, info in zip(replies, infos, strict=True)]

    alone, worker = (asyncio.run(ask(workers)) for workers in (None, Workers(count=1)))
    assert alone == worker
