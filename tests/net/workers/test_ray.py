"""Workers that are actors of a Ray cluster of three simulated machines, one of which dies, then Ray's head."""

from __future__ import annotations

import asyncio
import os
import signal
from functools import partial

import pytest

from apps.farming import on_ray
from glsplat.errors import ContextError, FormatError, GlsplatError
from glsplat.net.client import Client
from glsplat.net.server import ServerConfig
from glsplat.net.workers.cluster import RayCluster
from glsplat.net.workers.farm import Farm
from tests.net.workers.fakes import camera, watch
from tests.net.workers.sleeper import Sleeper
from tests.net.workers.test_farm import pids, until

pytest.importorskip("ray", reason="needs the extra glsplat[ray]")

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]  # Ray's own


@pytest.fixture(scope="module")
def machines():
    """A head that draws nothing, and three nodes with room for a worker each."""
    before = os.environ.get("RAY_AUTH_MODE")
    os.environ["RAY_AUTH_MODE"] = "disabled"  # of a cluster that lives as long as this test
    from ray.cluster_utils import Cluster

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 0})
    cluster.nodes = [cluster.add_node(num_cpus=1, wait=False) for _ in range(3)]
    cluster.wait_for_nodes()
    yield cluster
    cluster.shutdown()
    if before is None:
        del os.environ["RAY_AUTH_MODE"]
    else:
        os.environ["RAY_AUTH_MODE"] = before


def half(piece: int) -> tuple[float, str, int]:
    """A piece of work: 13 ends its process, 7 is an error."""
    if piece == 13:
        os._exit(1)
    if piece == 7:
        raise FormatError("seven")
    return piece / 2, os.environ["LP_NUM_THREADS"], os.getpid()


def test_pieces_of_work(machines):
    """Each in a process of its own, on one core; one that is lost costs itself."""
    found = dict(on_ray(half, [1, 13, 3], machines.address))
    assert sorted(found) == [0, 1, 2] and isinstance(found[1], GlsplatError)
    assert found[0][:2] == (0.5, "1") and found[2][:2] == (1.5, "1")
    assert len({os.getpid(), found[0][2], found[2][2]}) == 3
    with pytest.raises(FormatError, match="seven"):
        list(on_ray(half, [7], machines.address))


def test_machines_that_are_lost(serve, machines, monkeypatch):
    """A machine, then the head: who is connected stays, sees its own pictures only, and those in their order."""
    actors = RayCluster(partial(Sleeper), machines.address, cpus=1)

    async def main():
        farm = Farm(actors.places(actors.room()), patience=60, close=actors.close)
        async with serve(farm, ServerConfig(port=0)) as server:
            over = asyncio.Event()
            watching = [asyncio.create_task(watch(server.url, i, over)) for i in range(1, 7)]
            assert await until(10, lambda: server.stats()["totals"]["sent"] > 100)
            spread = [one["clients"] for one in server.pump.workers()]
            loop = asyncio.get_running_loop()
            await loop.run_in_executor(None, partial(machines.remove_node, machines.nodes[1], allow_graceful=False))
            assert await until(5, lambda: sum(one["alive"] for one in server.pump.workers()) == 2)
            await asyncio.sleep(0.5)
            await loop.run_in_executor(None, partial(machines.remove_node, machines.head_node, allow_graceful=False))
            sent = server.stats()["totals"]["sent"]
            assert await until(10, lambda: server.stats()["totals"]["sent"] > sent + 100)
            alive = [pid for pid, one in zip(pids(server), server.pump.workers(), strict=True) if one["alive"]]
            os.kill(alive[0], signal.SIGKILL)  # now nobody can start another one
            assert await until(3, lambda: sum(one["alive"] for one in server.pump.workers()) == 1)
            async with Client(server.url) as client:
                last = (await client.render([camera(1)])).info["driver"]
            over.set()
            return spread, last == f"sleeper {alive[1]}", server.pump.healthy, await asyncio.gather(*watching)

    spread, last, healthy, clients = asyncio.run(main())
    assert spread == [2, 2, 2] and last and healthy
    for one in clients:
        assert one.errors == [] and one.wrong == [] and one.pictures > 50
        assert one.longest < 2.5


def test_a_cluster_that_is_not_there():
    actors = RayCluster(Sleeper, "127.0.0.1:9", cpus=1)
    try:
        with pytest.raises(ContextError, match=r"^Ray cannot be reached: .*refused"):
            actors.room()
    finally:
        actors.close()
