"""A gateway with workers that are killed, stall, cannot load an avatar, or do not survive a picture."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from functools import partial

import aiohttp
import psutil
import pytest

from glsplat.errors import ContextError, GlsplatError, ProtocolError
from glsplat.extras.workers.pool import WorkerPool, Workers
from glsplat.net import render_loop as loop_module
from glsplat.net.backend import AvatarInfo
from glsplat.net.client import Client
from glsplat.net.guard.limits import Limits
from glsplat.net.served_scene import server_of
from glsplat.net.server import Server, ServerConfig
from glsplat.net.worker.process import ProcessLauncher
from tests.extras.workers.fakes import GUARD, camera, held, pool, until, until_more, watching
from tests.extras.workers.sleeper import FragileEncoder, Sleeper
from tests.net.guard.test_fault_tracker import visitor
from tests.net.wire import native

pytestmark = pytest.mark.check


def pids(server: Server) -> list[int]:
    return [int(one["driver"].split()[1]) for one in server.drawer.workers()]


def all_alive(server: Server) -> bool:
    return all(one["alive"] for one in server.drawer.workers())


def lives(server: Server, index: int) -> bool:
    return server.drawer.workers()[index]["alive"]


async def test_one_fault_after_the_other(serve, monkeypatch, equal, silences):
    """Killed, stalled in a picture and at rest, started anew: the others draw for all meanwhile."""
    begun, opened = [], WorkerPool.opened

    def open_(pool, render_loop):
        begun.append(render_loop._turns.rest(0.0))  # any picture leaves a trace in what long ones have to rest
        opened(pool, render_loop)

    monkeypatch.setattr(WorkerPool, "opened", open_)
    async with serve(pool(3), ServerConfig(port=0)) as server, aiohttp.ClientSession() as http:
        async with watching(server.url, range(1, 7)) as clients:
            assert await until_more(clients)
            spread = [one["clients"] for one in server.drawer.workers()]
            seen = []
            for fault in (signal.SIGKILL, signal.SIGSTOP, signal.SIGSTOP):
                before, free = pids(server), held(server)
                os.kill(before[0], fault)
                assert await until(lambda: not lives(server, 0))
                async with http.get(f"http://127.0.0.1:{server.port}/healthz") as response:
                    seen.append(response.status)
                assert await until_more(clients)
                free.set()
                assert await until(lambda: all_alive(server))
                assert pids(server)[0] != before[0] and pids(server)[1:] == before[1:]
                assert await until_more(clients)
            again = [one["clients"] for one in server.drawer.workers()]
            before, restarting = pids(server), server.drawer.restart()
            assert await until_more(clients)
            await restarting
            assert not set(pids(server)) & set(before) and await until_more(clients)
        lost = server.drawer.rebuilds
    assert spread == [2, 2, 2] and sorted(again) == [2, 2, 2] and seen == [200] * 3 and lost == 3
    assert all(one.errors == [] and one.wrong == [] for one in clients)
    assert begun[:3] == [0.0] * 3  # the time until the old one was given up is nobody's debt
    assert len(silences) == 2 and {why.rpartition("within ")[2] for why in silences} <= {"0.5 s", "0.4 s"}


async def test_a_picture_that_kills_does_not_kill_them_all(serve):
    """Its client is ended and held off; clients of the other worker notice nothing."""
    held_off = ServerConfig(port=0, limits=Limits(hold_off=2 * GUARD))
    async with serve(pool(2), held_off) as server, visitor("127.0.0.9") as http:
        async with watching(server.url, [5]) as seen:
            assert await until_more(seen)
            before, free = pids(server), held(server)
            mine = next(i for i, one in enumerate(server.drawer.workers()) if one["clients"])
            answers = []
            eye = {"viewmat": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 2, 0, 0, 0, 1], "K": [1, 50, 90, 32]}
            async with http.ws_connect(server.url) as ws:
                await ws.send_str(native(1, eyes=[eye]))
                assert await until(lambda: not all_alive(server)) and await until_more(seen)
                free.set()  # it is not drawn by the last one
                for _ in range(2):
                    message = await ws.receive(timeout=GUARD)
                    answers.append(
                        message.data if message.type == aiohttp.WSMsgType.CLOSE else message.json()["error"]["code"]
                    )
            async with http.get(server.url.replace("ws", "http", 1)) as response:
                status = response.status
            assert await until(lambda: all_alive(server))
            survived = pids(server)[mine] == before[mine]
            # what else may go wrong costs that picture
            async with Client(server.url, timeout=GUARD) as client:
                for act, words in ((93, "no such joint"), (94, "could not be drawn")):
                    with pytest.raises(ProtocolError, match=words):
                        await client.render([camera(1, act)])
                good = (await client.render([camera(1)])).frame_id
            # who leaves while a picture is drawn leaves nothing behind
            async with Client(server.url, timeout=GUARD) as client:
                await client.send([camera(1, 71)])
                left = max(server.clients)
                assert await until(lambda: left in drawing(server))
            assert await until(lambda: left not in drawing(server)) and await until_more(seen)
    assert answers == ["render", 1008] and status == 429
    assert survived and good == 3
    assert seen[0].errors == [] and seen[0].wrong == []


async def test_a_picture_whose_encoding_kills_is_given_up(serve):
    """It does not go from worker to worker without end."""
    async with serve(pool(makes=[FragileEncoder] * 2), ServerConfig(port=0)) as server:
        async with Client(server.url, timeout=GUARD) as client:
            with pytest.raises(ProtocolError, match="could not be encoded"):
                await client.render([camera(31)])
            assert (await client.render([camera(1)])).frame_id == 2
        assert server.drawer.rebuilds == 2


def drawing(server: Server) -> list[int]:
    """The clients whose pictures are in hand."""
    return [client.number for render_loop in server.drawer._render_loops for client in render_loop._turning.values()]


async def test_an_avatar_that_is_not_on_every_worker(serve):
    offered = [AvatarInfo(name=name) for name in ("default", "ann", "bob")]
    makes = [partial(Sleeper, without=name) for name in ("ann", "bob")]
    async with serve(pool(makes=makes), ServerConfig(port=0), offered=offered) as server:
        first, second = (f"sleeper {pid}" for pid in pids(server))
        async with (
            Client(server.url, avatar="ann", timeout=GUARD) as ann,
            Client(server.url, avatar="bob", timeout=GUARD) as bob,
        ):
            drivers = []
            for _ in range(3):
                drivers += [(await one.render([camera(1)])).info["driver"] for one in (ann, bob)]
            assert drivers == [second, first] * 3
            free = held(server)
            os.kill(pids(server)[1], signal.SIGKILL)
            assert await until(lambda: not lives(server, 1))
            with pytest.raises(ProtocolError, match="could not be drawn"):  # nobody can, for now
                await ann.render([camera(1)])
            free.set()
            assert await until(lambda: all_alive(server))
            server.drawer._refused.clear()  # as after a minute
            again = (await ann.render([camera(1)])).info["driver"]
            assert again == f"sleeper {pids(server)[1]}" and server.drawer.rebuilds == 1


async def test_workers_that_cannot_be_opened(serve, tmp_path, monkeypatch):
    """One of two: the other serves. None, again and again: the server ends."""
    monkeypatch.setattr(loop_module, "_REVIVE_PAUSES_S", (0.0, 0.1, 0.1))
    monkeypatch.setattr(loop_module, "_REVIVE_PERIOD_S", 0.2)
    broken = tmp_path / "broken"
    broken.touch()
    makes = [partial(Sleeper, fails=str(broken)), Sleeper]
    with pytest.raises(ContextError, match="no EGL device here"):
        await server_of(pool(1, fails=str(broken)), ServerConfig(port=0)).start()
    async with (
        serve(pool(makes=makes), ServerConfig(port=0)) as server,
        Client(server.url, timeout=GUARD) as client,
    ):
        alive = [one["alive"] for one in server.drawer.workers()]
        assert (await client.render([camera(1)])).frame_id == 1
        broken.unlink()
        assert await until(lambda: all_alive(server))
        broken.touch()
        server.drawer._workers[1].launcher._make = makes[0]
        for pid in pids(server):
            os.kill(pid, signal.SIGKILL)
        with pytest.raises(ContextError, match="no worker lives, and none can be started: no EGL device here"):
            await asyncio.wait_for(server.drawer.ended(), 2 * GUARD)
        assert alive == [False, True] and not server.drawer.healthy


async def test_a_worker_lost_during_a_rolling_restart(serve, equal):
    """It has clients again before the restart looks: the restart goes on to the next one."""
    async with (
        serve(pool(2), ServerConfig(port=0)) as server,
        aiohttp.ClientSession() as http,
        Client(server.url, timeout=GUARD) as drawn,
    ):
        async with http.ws_connect(server.url):
            first, second = server.drawer._render_loops
            assert await until(lambda: second.clients)
            await drawn.send([camera(1, 71)])
            assert await until(lambda: drawing(server))
            before, restarting, rebuild = pids(server), server.drawer.restart(), first.worker.rebuild

            async def at_once():
                first.worker.rebuild = rebuild
                return "sleeper 0"

            first.worker.rebuild = at_once
            assert await until(lambda: not first.living)
            os.kill(before[0], signal.SIGKILL)
            assert await until(lambda: first.clients)
            await drawn.close()  # its picture is drawn by the second worker, until it is abandoned
            await asyncio.wait_for(restarting, GUARD)
            assert pids(server)[0] == 0 and pids(server)[1] not in before


def test_a_pool_that_cannot_be_made_ends_rays_driver(monkeypatch):
    closed = []

    class Cluster:
        def __init__(self, *_):
            pass

        def room(self):
            return 1

        def launchers(self, count):
            return [ProcessLauncher(Sleeper)] * count

        def close(self):
            closed.append(1)

    monkeypatch.setattr("glsplat.extras.workers.pool.RayCluster", Cluster)
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(GlsplatError, match="video"):
        Workers(count=None, ray=True).pool([Sleeper], None, 5.0, video=True)
    assert closed == [1]


class Slow(ProcessLauncher):
    """Never done with its start."""

    starts = 0

    async def start(self):
        self.starts += 1
        await asyncio.Event().wait()


async def test_a_start_that_is_cancelled_ends_all_workers():
    slow, closed = Slow(Sleeper), []
    workers = WorkerPool([ProcessLauncher(Sleeper), slow], close=lambda: closed.append(1))
    starting = asyncio.create_task(workers.start())
    assert await until(lambda: slow.starts and workers.workers()[0]["alive"])
    (pid,) = [int(one["driver"].split()[1]) for one in workers.workers() if one["alive"]]
    starting.cancel()
    with pytest.raises(asyncio.CancelledError):
        await starting
    await asyncio.sleep(0.05)  # the first attempt to restart a worker needs no pause
    assert not psutil.pid_exists(pid) and slow.starts == 1 and closed == [1]
    assert [task.get_name() for task in asyncio.all_tasks() if "render loop" in task.get_name()] == []


def test_nothing_is_left_behind(serve):
    own = psutil.Process()

    async def main():
        async with serve(pool(2), ServerConfig(port=0)) as server:
            async with Client(server.url, timeout=GUARD) as client:
                await client.render([camera(1)])
            return pids(server)

    before = own.num_fds()
    assert not any(psutil.pid_exists(pid) for pid in asyncio.run(main()))
    assert own.num_fds() <= before + 1  # the resource tracker's pipe
