"""Tracking solved on arrival: every sample, in order, whatever is drawn."""

from __future__ import annotations

import asyncio
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from glsplat.errors import PoseError
from glsplat.net.backend import Offered, Solved
from glsplat.net.client import Client
from glsplat.net.guard.limits import Limits
from glsplat.net.messages import RenderRequest
from glsplat.net.server import ServerConfig
from glsplat.net.solving import Solving
from glsplat.skinning.pose import Pose

HEAD = {"head": [0, 1.6, 0, 0, 0, 0, 1]}


def request(frame_id):
    return RenderRequest(frame_id=frame_id, cameras=(), tracking=HEAD, t=frame_id * 10.0)


class Solver:
    def __init__(self, wait=None):
        self.seen, self.now, self.wait = [], [], wait

    def solve(self, request, now):
        if self.wait is not None:
            self.wait.wait(5)
        self.seen.append(request.frame_id)
        self.now.append(now)
        if request.frame_id == 3 and not request.cameras:
            raise PoseError("three")
        return Solved(Pose.zero(), request.cameras, (str(request.frame_id),))


@pytest.fixture
def thread():
    with ThreadPoolExecutor(1) as pool:
        yield pool


def test_samples_are_solved_in_order_and_the_one_that_is_drawn_is_taken(thread):
    solver = Solver()
    solving = Solving(solver, thread, time.perf_counter)
    for frame_id in range(1, 7):
        solving.add(request(frame_id))
    solved, ms = solving.take(5).result(5)  # the failure of a request that is not drawn is nobody's
    assert solved.notes == ("5",) and ms >= 0
    assert solving.take(6).result(5)[0].notes == ("6",)
    assert solver.seen == [1, 2, 3, 4, 5, 6] and solver.now == sorted(solver.now)
    assert solving.take(7) is None
    solving.add(request(3))
    with pytest.raises(PoseError, match="three"):
        solving.take(3).result(5)


def test_what_waits_is_bounded_and_the_newest_are_kept(thread):
    gate = threading.Event()
    solver = Solver(gate)
    solving = Solving(solver, thread, time.perf_counter)
    for frame_id in range(4, 104):
        solving.add(request(frame_id))
    gate.set()
    solving.take(103).result(5)
    assert solver.seen[0] == 4 and solver.seen[1:] == list(range(72, 104))  # the first had begun; then the newest 32


def test_a_client_that_left_is_not_solved_for(thread):
    gate = threading.Event()
    solver = Solver(gate)
    solving = Solving(solver, thread, time.perf_counter)
    for frame_id in range(4, 20):
        solving.add(request(frame_id))
    solving.clear()
    gate.set()
    thread.submit(lambda: None).result(5)
    assert solver.seen in ([], [4])


class Gated:
    """Solves once told, or each sample after a while."""

    def __init__(self, delay=0.0):
        self.delay, self.gate, self.begun, self.seen = delay, threading.Event(), threading.Event(), []

    def solve(self, request, now):
        self.begun.set()
        if self.delay:
            time.sleep(self.delay)
        else:
            self.gate.wait(10)
        self.seen.append(request.frame_id)
        return Solved(Pose.zero(), request.cameras)


def test_others_are_drawn_while_a_sample_is_solved(serve, fake_backend, cameras):
    solvers = []

    def make(height, span):
        solvers.append(Gated())
        return solvers[-1]

    async def main():
        async with serve(fake_backend(), offered=[Offered(name="default", solver=make)]) as server:
            async with Client(server.url) as slow, Client(server.url) as other:
                await slow.send(tracking=HEAD)
                await asyncio.to_thread(solvers[0].begun.wait, 5)
                for _ in range(5):
                    async with asyncio.timeout(2):
                        await other.render(cameras)
                solvers[0].gate.set()
                async with asyncio.timeout(5):
                    return (await slow.receive()).reply.frame_id

    assert asyncio.run(main()) == 1


def test_a_stream_of_samples_that_is_faster_than_the_solver_is_drawn_all_the_same(serve, fake_backend):
    """The newest sample is never solved when its turn comes, so the one that was newest when a picture was due is."""
    solver = Gated(delay=0.03)

    async def main():
        limits = Limits(samples=0.0, samples_burst=1.0)  # all others are put off until their picture is due
        async with serve(
            fake_backend(),
            ServerConfig(port=0, limits=limits),
            offered=[Offered(name="default", solver=lambda height, span: solver)],
        ) as server:
            async with Client(server.url) as client:

                async def stream():
                    for i in range(100):
                        await client.send(tracking={"head": [i / 100, 1.6, 0, 0, 0, 0, 1]})
                        await asyncio.sleep(0.005)

                sending, arrived = asyncio.create_task(stream()), []
                while not arrived or arrived[-1] != 100:
                    async with asyncio.timeout(5):
                        arrived.append((await client.receive()).reply.frame_id)
                await sending
                return arrived, server.stats()["clients"][0]

    arrived, stats = asyncio.run(main())
    assert len(arrived) >= 5 and arrived == sorted(arrived)
    assert set(arrived) <= set(solver.seen) and solver.seen == sorted(solver.seen)
    assert stats["accepted"] == 100 == stats["dropped"] + stats["sent"] and stats["waiting"] == 0


def test_dropped_requests_are_solved_while_the_renderer_is_busy(serve, fake_backend):
    """The poses do not depend on what was drawn: the solver sees the same samples in the same order."""
    made = []

    def make(height, span):
        made.append(Solver())
        return made[-1]

    async def main(delay):
        backend = fake_backend(delay=delay)
        async with (
            serve(backend, offered=[Offered(name="default", solver=make)]) as server,
            Client(server.url) as client,
        ):
            last = 0
            for i in range(24):
                last = await client.send(tracking={"head": [i / 100, 1.6, 0, 0, 0, 0, 1]})
                await asyncio.sleep(0.004)
            seen = list(made[-1].seen)  # before the last picture is drawn
            while (arrived := await client.receive()).reply.frame_id != last:
                pass
            return seen, arrived.reply.info["times"], [r.frame_id for r in backend.drawn]

    for delay in (0.0, 0.08):
        early, times, drawn = asyncio.run(main(delay))
        assert made[-1].seen == list(range(1, 25))
        assert len(early) > len(drawn) or delay == 0
        assert times["ik"] >= 0 and times["wait"] >= 0
    assert len(drawn) < 8  # most were dropped
    assert (np.diff(made[-1].now) > 0).all()
