"""Tracking solved on arrival: every sample, in order, whatever is drawn."""

from __future__ import annotations

import asyncio
import threading
import time
from concurrent.futures import CancelledError, ThreadPoolExecutor, wait
from dataclasses import replace

import numpy as np
import pytest

from glsplat.errors import PoseError
from glsplat.net.backend import AvatarInfo, Solved
from glsplat.net.client import Client
from glsplat.net.messages import Request
from glsplat.net.pose_queue import PoseQueue
from glsplat.skinning.pose import Pose
from glsplat.tracking.sample import Sample
from tests.net.wire import HANG, until

HEAD = {"head": [0, 1.6, 0, 0, 0, 0, 1]}


def request(frame_id):
    return Request(frame_id=frame_id, cameras=(), tracking=Sample.from_json(HEAD, frame_id / 100), t=frame_id * 10.0)


class Solver:
    def __init__(self, wait=None):
        self.seen, self.now, self.wait = [], [], wait
        self.begun = threading.Event()

    def solve(self, request, now):
        self.begun.set()
        if self.wait is not None:
            self.wait.wait(HANG)
        self.seen.append(request.frame_id)
        self.now.append(now)
        if request.frame_id == 3 and not request.cameras:
            raise PoseError("three")
        return Solved(Pose.zero(), (str(request.frame_id),))


@pytest.fixture
def thread():
    with ThreadPoolExecutor(1) as pool:
        yield pool


def test_samples_are_solved_in_order_and_the_one_that_is_drawn_is_taken(thread):
    solver = Solver()
    solving = PoseQueue(solver, thread, time.perf_counter)
    for frame_id in range(1, 7):
        solving.add(request(frame_id))
    solved, ms = solving.take(5).result(HANG)  # the failure of a request that is not drawn is nobody's
    assert solved.notes == ("5",) and ms >= 0
    assert solving.take(6).result(HANG)[0].notes == ("6",)
    assert solver.seen == [1, 2, 3, 4, 5, 6] and solver.now == sorted(solver.now)
    assert solving.take(7) is None
    solving.add(request(3))
    with pytest.raises(PoseError, match="three"):
        solving.take(3).result(HANG)


def test_a_solution_that_cannot_be_passed_on_costs_its_own_answer(thread):
    def heard(request, solved, at):
        if request.frame_id == 1:
            raise PoseError("nobody can stand there")

    solving = PoseQueue(Solver(), thread, time.perf_counter)
    solving.on_solved = heard
    solving.add(request(1))
    with pytest.raises(PoseError, match="nobody can stand there"):
        solving.take(1).result(HANG)
    solving.add(request(2))
    assert solving.take(2).result(HANG)[0].notes == ("2",)


def test_what_waits_is_bounded_and_the_newest_are_kept(thread):
    gate = threading.Event()
    solver = Solver(gate)
    solving = PoseQueue(solver, thread, time.perf_counter)
    solving.add(request(4))
    assert solver.begun.wait(HANG)
    for frame_id in range(5, 104):
        solving.add(request(frame_id))
    gate.set()
    solving.take(103).result(HANG)
    assert solver.seen[0] == 4 and solver.seen[1:] == list(range(72, 104))  # the first had begun; then the newest 32


def test_of_who_draws_itself_only_a_few_wait_and_the_newest_is_next(thread):
    gate = threading.Event()
    solver = Solver(gate)
    solving = PoseQueue(solver, thread, time.perf_counter)
    told = threading.Event()
    solving.add(replace(request(4), poses=True))
    assert solver.begun.wait(HANG)
    for frame_id in range(5, 104):
        solving.add(replace(request(frame_id), poses=True))
    assert not solving.solved(103)
    solving.begin(103, told.set)
    gate.set()
    assert told.wait(HANG) and solving.take(103).result(HANG)[0].notes == ("103",)
    assert solver.seen == [4, 5, 6, 103] and solving.merged == 96


def test_samples_are_queued_between_two_looks_of_the_solving_thread(thread):
    """Else the thread ends for want of samples just when one is queued, which nobody solves then."""
    solving = PoseQueue(Solver(), thread, time.perf_counter)
    with ThreadPoolExecutor(1) as loop:
        with solving._lock:
            adding = loop.submit(solving.add, request(4))
            done = wait([adding], 0.2).done
        adding.result(HANG)
    assert not done
    assert solving.take(4).result(HANG)[0].notes == ("4",)


def test_a_client_that_left_is_not_solved_for(thread):
    gate = threading.Event()
    solver = Solver(gate)
    solving = PoseQueue(solver, thread, time.perf_counter)
    for frame_id in range(4, 20):
        solving.add(request(frame_id))
    solving.clear()
    gate.set()
    thread.submit(lambda: None).result(HANG)
    assert solver.seen in ([], [4])


def test_samples_that_wait_when_the_server_stops_are_cancelled():
    gate, thread = threading.Event(), ThreadPoolExecutor(1)
    solving = PoseQueue(Solver(gate), thread, time.perf_counter)
    for frame_id in (4, 5):
        solving.add(request(frame_id))
    thread.shutdown(wait=False)
    gate.set()
    with pytest.raises(CancelledError):
        solving.take(5).result(HANG)


class Spent(list):
    """A share that has always something left."""

    def left(self, now):
        return True

    def spend(self, seconds):
        self.append(seconds)


def test_samples_that_were_left_out_cost_nothing(thread):
    """What they were expected to take is spent when they come, and given back."""
    gate = threading.Event()
    solver = Solver(gate)
    solving = PoseQueue(solver, thread, time.perf_counter, cpu=lambda: 0.0)
    solving.share = share = Spent()
    for frame_id in range(4, 104):
        solving.add(request(frame_id))
    gate.set()
    solving.take(103).result(HANG)
    thread.submit(lambda: None).result(HANG)
    assert len(solver.seen) < 40 and sum(share) == pytest.approx(0, abs=1e-9) and max(share) > 0


async def test_others_are_drawn_while_a_sample_is_solved(serve, cameras):
    gate = threading.Event()
    solver = Solver(gate)
    offered = [AvatarInfo(name="default", solver=lambda height, span: solver)]
    async with serve(offered=offered) as server, Client(server.url) as slow, Client(server.url) as other:
        await slow.send(tracking=HEAD)
        await asyncio.to_thread(solver.begun.wait, HANG)
        for _ in range(5):
            await other.render(cameras)
        gate.set()
        assert (await slow.receive()).reply.frame_id == 1


async def test_dropped_requests_are_solved_while_the_renderer_is_busy(serve, fake_backend):
    """The solver sees every sample in order, whatever is drawn."""
    solver, backend = Solver(), fake_backend()
    backend.gate.clear()
    offered = [AvatarInfo(name="default", solver=lambda height, span: solver)]
    async with serve(backend, offered=offered) as server, Client(server.url) as client:
        for i in range(24):
            last = await client.send(tracking={"head": [i / 100, 1.6, 0, 0, 0, 0, 1]})
        await until(lambda: len(solver.seen) == 24)
        assert len(backend.drawn) <= 1
        backend.gate.set()
        while (arrived := await client.receive()).reply.frame_id != last:
            pass
    times = arrived.reply.info["times"]
    assert solver.seen == list(range(1, 25)) and (np.diff(solver.now) > 0).all()
    assert times["ik"] >= 0 and times["wait"] >= 0 and len(backend.drawn) <= 2  # all others were dropped
