"""Workers that are actors of a Ray cluster of simulated machines, one of which dies, then Ray's head."""

from __future__ import annotations

import asyncio
import os
import signal
from functools import partial

import pytest

from apps.ray_tasks import on_ray
from glsplat.errors import FormatError, GlsplatError
from glsplat.extras.workers.cluster import RayCluster
from glsplat.extras.workers.pool import WorkerPool
from glsplat.net.client import Client
from glsplat.net.server import Server, ServerConfig
from tests.extras.workers.fakes import GUARD, camera, until, until_more, watching
from tests.extras.workers.sleeper import Sleeper
from tests.extras.workers.test_pool import pids

pytest.importorskip("ray", reason="needs the extra glsplat[ray]")

pytestmark = [pytest.mark.check, pytest.mark.filterwarnings("ignore")]  # Ray's own


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
    found = dict(on_ray(half, [1, 13], machines.address))
    assert found[0][:2] == (0.5, "1") and found[0][2] != os.getpid() and isinstance(found[1], GlsplatError)
    with pytest.raises(FormatError, match="seven"):
        list(on_ray(half, [7], machines.address))


async def test_machines_that_are_lost(serve, machines, equal):
    """Connected clients stay and see their own pictures, in order."""
    actors = RayCluster(partial(Sleeper), machines.address, cpus=1)
    pool = WorkerPool(actors.launchers(actors.room()), patience=GUARD, close=actors.close)
    async with serve(pool, ServerConfig(port=0)) as server:
        async with watching(server.url, range(1, 7)) as clients:
            assert await until_more(clients)
            spread = [one["clients"] for one in server.drawer.workers()]
            lose = partial(asyncio.to_thread, machines.remove_node, allow_graceful=False)
            await lose(machines.nodes[1])
            assert await until(lambda: living(server) == 2) and await until_more(clients)
            await lose(machines.head_node)
            assert await until_more(clients, 20)
            workers = server.drawer.workers()
            alive = [pid for pid, one in zip(pids(server), workers, strict=True) if one["alive"]]
            os.kill(alive[0], signal.SIGKILL)  # now nobody can start another one
            assert await until(lambda: living(server) == 1) and await until_more(clients)
            async with Client(server.url, timeout=GUARD) as client:
                last = (await client.render([camera(1)])).info["driver"]
        last, healthy = last == f"sleeper {alive[1]}", server.drawer.healthy
    assert spread == [2, 2, 2] and last and healthy
    assert all(one.errors == [] and one.wrong == [] for one in clients)


def living(server: Server) -> int:
    return sum(one["alive"] for one in server.drawer.workers())
