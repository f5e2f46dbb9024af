"""A gateway with workers that are killed, stall, cannot load an avatar, or do not survive a picture."""

from __future__ import annotations

import asyncio
import os
import signal
import time
from functools import partial

import aiohttp
import psutil
import pytest

from glsplat.errors import ContextError, ProtocolError
from glsplat.net.backend import Offered
from glsplat.net.client import Client
from glsplat.net.server import Server, ServerConfig
from glsplat.net.workers import link
from glsplat.net.workers import pump as pump_module
from tests.net.guard.test_blame import visitor
from tests.net.wire import native
from tests.net.workers.fakes import camera, farm, watch
from tests.net.workers.sleeper import Sleeper


def pids(server: Server) -> list[int]:
    return [int(one["driver"].split()[1]) for one in server.pump.workers()]


async def until(seconds: float, true) -> bool:
    """Whether it came true in time."""
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        if true():
            return True
        await asyncio.sleep(0.01)
    return bool(true())


def all_alive(server: Server) -> bool:
    return all(one["alive"] for one in server.pump.workers())


def test_one_fault_after_the_other(serve, monkeypatch):
    """Killed, stalled in a picture, stalled at rest, started anew in turn: no client notices more than a pause."""
    monkeypatch.setattr(link, "_BUSY", 0.5)
    monkeypatch.setattr(link, "_SILENT", 0.4)

    async def main():
        async with serve(farm(3), ServerConfig(port=0)) as server, aiohttp.ClientSession() as http:
            over = asyncio.Event()
            watching = [asyncio.create_task(watch(server.url, i, over)) for i in range(1, 7)]
            assert await until(5, lambda: server.stats()["totals"]["sent"] > 60)
            spread = [one["clients"] for one in server.pump.workers()]
            seen = []
            for fault in (signal.SIGKILL, signal.SIGSTOP, signal.SIGSTOP):
                before = pids(server)
                os.kill(before[0], fault)
                assert await until(5, lambda: not server.pump.workers()[0]["alive"])
                async with http.get(f"http://127.0.0.1:{server.port}/healthz") as response:
                    seen.append(response.status)
                assert await until(20, lambda: all_alive(server))
                assert pids(server)[0] != before[0] and pids(server)[1:] == before[1:]
                assert server.pump._pumps[0]._turns.rest(time.perf_counter()) < 0.1  # as after a long picture
                sent = server.stats()["totals"]["sent"]  # what was never drawn there may take long to load
                assert await until(5, lambda sent=sent: server.stats()["totals"]["sent"] > sent + 100)
            again = [one["clients"] for one in server.pump.workers()]
            before, sent = pids(server), server.stats()["totals"]["sent"]
            await server.pump.restart()
            assert not set(pids(server)) & set(before) and server.stats()["totals"]["sent"] > sent
            over.set()
            return spread, seen, again, server.pump.rebuilds, await asyncio.gather(*watching)

    spread, seen, again, lost, clients = asyncio.run(main())
    assert spread == [2, 2, 2] and sorted(again) == [2, 2, 2] and seen == [200] * 3 and lost == 3
    for one in clients:
        assert one.errors == [] and one.wrong == [] and one.pictures > 50
        assert one.longest < 2.5  # of which 0.5 until a stalled one is given up


def test_a_worker_that_stalls_at_rest_is_found_before_it_is_asked(serve, monkeypatch):
    monkeypatch.setattr(link, "_SILENT", 0.4)

    async def main():
        async with serve(farm(2), ServerConfig(port=0)) as server:
            os.kill(pids(server)[0], signal.SIGSTOP)
            assert await until(3, lambda: not server.pump.workers()[0]["alive"])
            os.kill(pids(server)[1], signal.SIGKILL)  # and then there is none
            assert await until(3, lambda: not server.pump.healthy)
            async with Client(server.url) as client:
                return (await client.render([camera(1)])).frame_id  # it waits for a new one

    assert asyncio.run(main()) == 1


def test_a_picture_that_kills_does_not_kill_them_all(serve):
    """Two workers: its client is ended and held off; who is drawn for by the other worker notices nothing."""

    async def main():
        async with serve(farm(2), ServerConfig(port=0)) as server, visitor("127.0.0.9") as http:
            over = asyncio.Event()
            watching = asyncio.create_task(watch(server.url, 5, over))
            assert await until(5, lambda: server.stats()["totals"]["sent"] > 5)
            before = pids(server)
            mine = next(i for i, one in enumerate(server.pump.workers()) if one["clients"])
            answers = []
            eye = {"viewmat": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 2, 0, 0, 0, 1], "K": [1, 50, 90, 32]}
            async with http.ws_connect(server.url) as ws:
                await ws.send_str(native(1, eyes=[eye]))
                for _ in range(2):
                    message = await ws.receive(timeout=20)
                    answers.append(
                        message.data if message.type == aiohttp.WSMsgType.CLOSE else message.json()["error"]["code"]
                    )
            async with http.get(server.url.replace("ws", "http", 1)) as response:
                status = response.status
            assert await until(10, lambda: all_alive(server))
            survived = pids(server)[mine] == before[mine]
            # what else may go wrong costs that picture
            async with Client(server.url) as client:
                for act, words in ((93, "no such joint"), (94, "could not be drawn")):
                    with pytest.raises(ProtocolError, match=words):
                        await client.render([camera(1, act)])
                good = (await client.render([camera(1)])).frame_id
            # who leaves while a picture is drawn leaves nothing behind
            async with Client(server.url) as client:
                await client.send([camera(1, 71)])
                await asyncio.sleep(0.2)
            await asyncio.sleep(1.0)
            free = max(one.drawing_for for one in server.pump._pumps) < 0.5
            over.set()
            return answers, status, survived, good, free, await watching

    answers, status, survived, good, free, seen = asyncio.run(main())
    assert answers == ["render", 1008] and status == 429
    assert survived and good == 3 and free
    assert seen.errors == [] and seen.wrong == [] and seen.longest < 1.5


def test_an_avatar_that_is_not_on_every_worker(serve):
    offered = [Offered(name=name) for name in ("default", "ann", "bob")]
    makes = [partial(Sleeper, without=name) for name in ("ann", "bob")]

    async def main():
        async with serve(farm(makes=makes), ServerConfig(port=0), offered=offered) as server:
            first, second = (f"sleeper {pid}" for pid in pids(server))
            async with Client(server.url, avatar="ann") as ann, Client(server.url, avatar="bob") as bob:
                drivers = []
                for _ in range(3):
                    drivers += [(await one.render([camera(1)])).info["driver"] for one in (ann, bob)]
                assert drivers == [second, first] * 3
                os.kill(pids(server)[1], signal.SIGKILL)
                assert await until(3, lambda: not server.pump.workers()[1]["alive"])
                with pytest.raises(ProtocolError, match="could not be drawn"):  # nobody can, for now
                    await ann.render([camera(1)])
                assert await until(10, lambda: all_alive(server))
                server.pump._pumps[0]._refuses.clear()  # as after a minute
                again = (await ann.render([camera(1)])).info["driver"]
                return again == f"sleeper {pids(server)[1]}", server.pump.rebuilds

    assert asyncio.run(main()) == (True, 1)


def test_rooms_are_drawn_in_one_place(serve, monkeypatch):
    async def main():
        async with serve(farm(2), ServerConfig(port=0)) as server:
            add = server.pump.add

            def to_a_room(channel):
                channel.place_key = "room:lab" if channel.number < 4 else "room:other"
                add(channel)

            monkeypatch.setattr(server.pump, "add", to_a_room)
            over = asyncio.Event()
            watching = []
            for i in range(1, 6):
                watching.append(asyncio.create_task(watch(server.url, i, over)))
                assert await until(3, lambda i=i: len(server.stats()["clients"]) == i)
            assert await until(5, lambda: server.stats()["totals"]["sent"] > 60)
            places = sorted(one["clients"] for one in server.pump.workers())
            os.kill(pids(server)[0], signal.SIGKILL)
            assert await until(3, lambda: not server.pump.workers()[0]["alive"])
            assert await until(10, lambda: all_alive(server))
            again = sorted(one["clients"] for one in server.pump.workers())
            over.set()
            return places, again, await asyncio.gather(*watching)

    places, again, clients = asyncio.run(main())
    assert places == again == [2, 3]
    assert all(one.errors == [] and one.wrong == [] and len(one.drivers) <= 3 for one in clients)


def test_workers_that_cannot_be_opened(serve, tmp_path, monkeypatch):
    """One of two: the other serves. None of them, again and again: the server ends."""
    monkeypatch.setattr(pump_module, "_PAUSES", (0.0, 0.1, 0.1))
    monkeypatch.setattr(pump_module, "_LATER", 0.2)
    broken = tmp_path / "broken"
    broken.touch()
    makes = [partial(Sleeper, fails=str(broken)), Sleeper]

    async def main():
        with pytest.raises(ContextError, match="no EGL device here"):
            await Server(farm(1, fails=str(broken)), ServerConfig(port=0)).start()
        async with serve(farm(makes=makes), ServerConfig(port=0)) as server, Client(server.url) as client:
            alive = [one["alive"] for one in server.pump.workers()]
            assert (await client.render([camera(1)])).frame_id == 1
            broken.unlink()
            assert await until(10, lambda: all_alive(server))
            broken.touch()
            server.pump._pumps[1].place._make = makes[0]
            for pid in pids(server):
                os.kill(pid, signal.SIGKILL)
            with pytest.raises(ContextError, match="no worker lives, and none can be started: no EGL device here"):
                await asyncio.wait_for(server.pump.ended(), 30)
            return alive, server.pump.healthy

    assert asyncio.run(main()) == ([False, True], False)


def test_nothing_is_left_behind(serve):
    """No process, no descriptor."""
    own = psutil.Process()

    async def main():
        async with serve(farm(2), ServerConfig(port=0)) as server:
            async with Client(server.url) as client:
                await client.render([camera(1)])
            return pids(server)

    before = own.num_fds()
    assert not any(psutil.pid_exists(pid) for pid in asyncio.run(main()))
    assert own.num_fds() <= before + 1  # the resource tracker's pipe
