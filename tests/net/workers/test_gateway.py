"""The gateway as a program: killed, restarted by a signal; its pictures beside those of a server alone."""

from __future__ import annotations

import asyncio
import json
import os
import random
import signal
import socket
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import psutil
import pytest

import glsplat
from glsplat.camera import head_matrix, stereo_cameras
from glsplat.net.backends.server import make_server
from glsplat.net.client import Client
from glsplat.net.server import ServerConfig
from glsplat.net.workers.options import Workers
from tests.net.loops import in_a_loop, running
from tests.net.workers.fakes import GUARD, Seen, until, until_more, watching

pytestmark = pytest.mark.check

ROOT = Path(__file__).resolve().parents[3]
GATEWAY = """
import asyncio, json, sys
from glsplat.net.server import Server, ServerConfig
from tests.net.workers.fakes import pool
if __name__ == "__main__":
    server = Server(pool(2), ServerConfig(port=int(sys.argv[1])))
    asyncio.run(server.run(lambda: print(json.dumps(server.render_loop.workers()), flush=True)))
"""


def begin(script: Path, port: int) -> tuple[subprocess.Popen, list[int]]:
    """A gateway, ready, and its workers' processes."""
    command, environment = [sys.executable, str(script), str(port)], {**os.environ, "PYTHONPATH": "."}
    process = subprocess.Popen(command, stdout=subprocess.PIPE, cwd=ROOT, env=environment)
    assert process.stdout is not None
    return process, [int(one["driver"].split()[1]) for one in json.loads(process.stdout.readline())]


def port_of_its_own() -> int:
    """Below those that the system gives to connections: nobody takes it between two gateways."""
    for port in random.sample(range(20_000, 30_000), 100):
        with socket.socket() as probe, suppress(OSError):
            probe.bind(("127.0.0.1", port))
            return port
    raise OSError("all of these ports are in use")


def runs(pid: int) -> bool:
    """Whether the process lives; a zombie does not."""
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


@in_a_loop
async def test_a_gateway_that_is_killed(tmp_path):
    """Its workers end with it, its clients come back to the next one; SIGHUP starts all workers anew meanwhile."""
    port = port_of_its_own()
    script = tmp_path / "gateway.py"
    script.write_text(GATEWAY)
    loop = asyncio.get_running_loop()
    gateway, first = await loop.run_in_executor(None, begin, script, port)
    try:
        async with watching(f"ws://127.0.0.1:{port}/ws", (1, 2), again=True) as clients:
            assert await until_more(clients)
            os.kill(gateway.pid, signal.SIGHUP)
            assert await until(lambda: not any(map(runs, first)))
            restarted = [one.pid for one in psutil.Process(gateway.pid).children()]
            assert await until_more(clients)
            gateway.kill()
            gateway.wait()
            gateway.stdout.close()
            assert await until(lambda: not any(map(runs, restarted)))
            gateway, third = await loop.run_in_executor(None, begin, script, port)
            assert await until(lambda: all(drivers_of(one) & set(third) for one in clients))
        found = clients
    finally:
        gateway.terminate()
        await loop.run_in_executor(None, gateway.wait)
        gateway.stdout.close()
    for one in found:
        assert one.wrong == [] and len(drivers_of(one)) >= 2
        assert {error.split(":")[0] for error in one.errors} <= {"closed", "unreachable"} and one.errors


def drivers_of(seen: Seen) -> set[int]:
    return {int(driver.split()[1]) for driver in seen.drivers}


@pytest.mark.gl
def test_a_worker_draws_what_a_server_alone_draws():
    """The same JPEGs byte by byte; poses, boxes and tracking reach the worker."""
    avatar = glsplat.default_avatar()
    cameras = stereo_cameras(head_matrix((0, 1.4, 1.2), (0, 0, 0, 1)), size=(128, 128))
    pose = {"body_pose": [[0.1 * (i % 3), 0, 0.05 * (i % 5)] for i in range(21)]}
    tracking = {"head": [0, 1.6, 0, 0, 0, 0, 1], "left": [0.3, 1.2, -0.3, 0, 0, 0, 1], "right": None}

    async def ask(workers):
        async with running(make_server(avatar, ServerConfig(port=0), own_process=False, workers=workers)) as server:
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
