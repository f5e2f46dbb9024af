"""Time for reading and solving: divided by address and client, and what is left out when it is spent."""

from __future__ import annotations

from concurrent.futures import Executor, Future

import numpy as np
import pytest

from glsplat.net.backend import Solved
from glsplat.net.guard.limits import ClientQuota, CpuBudget, Limits
from glsplat.net.guard.reading import Reading
from glsplat.net.messages import Request
from glsplat.net.pose_queue import PoseQueue
from glsplat.skinning.pose import Pose
from glsplat.tracking.sample import Sample


def test_beyond_its_part_of_the_time_only_the_newest_message_is_read():
    """Two clients, one that sends what takes all the time there is; the other's messages are all read."""
    budget, now = CpuBudget(0.2, 0.0), 0.0
    greedy, good = Reading(budget.open(0.0)), Reading(budget.open(0.0))
    read = {greedy: [], good: []}
    for i in range(2000):  # 20 s
        now += 0.01
        for reading, cost in ((greedy, 0.03), (good, 0.0009)):
            text = reading.take() if reading.wait(now) == 0 else None
            text = reading.offer(f"{i:070d}", now) or text
            if text is not None:
                read[reading].append(int(text))
                reading.share.spend(cost)
        assert reading.offer("{}", now) == "{}"  # what is short is always read
    assert len(read[good]) == 2000 and good.left_out == 0
    assert 60 < len(read[greedy]) < 150 and greedy.left_out > 1800  # 0.2 s - 0.09 s a second over 0.03 s, and the start
    assert read[greedy] == sorted(set(read[greedy]))
    greedy.offer("x" * 100, now)
    assert greedy.offer("{}", now) == "{}"  # although nothing is left of its part
    assert greedy.wait(now) > 0 and greedy.take() == "x" * 100 and greedy.wait(now) == float("inf")


def test_the_time_is_divided_by_address_and_then_by_client():
    budget = CpuBudget(0.3, 0.0)
    mine, others = budget.open(0.0, "a"), [budget.open(0.0, "b") for _ in range(3)]
    assert mine.part.rate == pytest.approx(0.15) and [s.part.rate for s in others] == pytest.approx([0.05] * 3)
    spent = dict.fromkeys([mine, *others], 0.0)
    now = 0.0
    for _ in range(2000):  # 20 s, in which all want more than there is
        now += 0.01
        for share in others + [mine]:
            if share.left(now):
                share.spend(0.004)
                spent[share] += 0.004
    assert sum(spent.values()) < 0.3 * 20 * 1.15
    assert spent[mine] > 0.14 * 20 and all(0.04 * 20 < spent[share] < 0.08 * 20 for share in others)
    for share in others:
        budget.close(share)
    assert mine.part.rate == pytest.approx(0.3)


# tracking


LIMITS = Limits()


class Stepped(Executor):
    """One job after another, when told."""

    def __init__(self):
        self.jobs = []

    def submit(self, fn, /, *args, **kwargs):
        self.jobs.append(fn)
        return Future()

    def step(self):
        self.jobs.pop(0)()


class Timed:
    """Takes ``cost`` seconds of a clock that it moves itself."""

    def __init__(self, clock, cost):
        self.clock, self.cost, self.seen = clock, cost, []

    def solve(self, request, now):
        self.clock[0] += self.cost
        self.seen.append((request.frame_id, now))
        return Solved(Pose.zero())


def clients(rates, cost, seconds, limits=LIMITS):
    """Samples solved of each client, at its own rate, on one thread whose samples take ``cost`` seconds."""
    clock, thread = [0.0], Stepped()
    budget = CpuBudget(limits.work, 0.0)
    solvers = [Timed(clock, cost) for _ in rates]
    each = []
    for solver in solvers:
        solving = PoseQueue(solver, thread, lambda: clock[0], lambda: clock[0])
        solving.share, solving.samples = budget.open(0.0), ClientQuota(limits, 0.0).samples
        each.append(solving)
    sent = [0] * len(rates)
    while clock[0] < seconds:
        for i, rate in enumerate(rates):
            while sent[i] < clock[0] * rate:
                sent[i] += 1
                each[i].add(Request(frame_id=sent[i], cameras=(), tracking=Sample(0.0)))
        if thread.jobs:
            thread.step()
        else:
            clock[0] += 0.0005
    for solver in solvers:
        ids = [frame_id for frame_id, _ in solver.seen]
        assert ids == sorted(set(ids)), "samples are solved in order, none twice"
        arrived = [now for _, now in solver.seen]
        assert arrived == sorted(arrived)
    return [len(solver.seen) / seconds for solver in solvers], each


def test_tracking_is_solved_sample_by_sample_up_to_the_rate_of_one_client():
    solved, each = clients([120.0, 90.0, 72.0], cost=0.001, seconds=5.0)
    assert np.allclose(solved, [120, 90, 72], atol=2) and [s.merged for s in each] == [0, 0, 0]
    solved, each = clients([500.0], cost=0.0001, seconds=10.0)
    assert 145 < solved[0] < 160 and each[0].merged > 3000


@pytest.mark.check
def test_six_clients_at_220_samples_a_second_leave_a_good_one_its_own():
    limits = Limits(work=0.35)
    solved, _ = clients([72.0] + [220.0] * 6, cost=0.0006, seconds=10.0, limits=limits)
    assert sum(solved) * 0.0006 < limits.work * 1.15  # of the thread, with what may be spent at once
    assert abs(solved[0] - 72) < 3  # within its seventh: 72 * 0.6 ms = 4.3 % of the time
    assert all(50 < rate < 140 for rate in solved[1:])


def test_what_samples_will_cost_is_spent_before_they_are_solved():
    """A thread that lags behind leaves nobody room to queue more than the budget; what is not solved costs nothing."""
    clock, thread = [0.0], Stepped()
    budget, solver = CpuBudget(0.25, 0.0), Timed(clock, 0.01)
    solving = PoseQueue(solver, thread, lambda: clock[0], lambda: clock[0])
    solving.share = budget.open(0.0)

    def sent(first):
        for frame_id in range(first, first + 30):
            solving.add(Request(frame_id=frame_id, cameras=(), tracking=Sample(0.0)))

    sent(1)
    while thread.jobs:
        thread.step()  # now it knows that a sample takes about 10 ms
    assert not solving.share.left(clock[0])
    clock[0] = 10.0
    before = len(solver.seen)
    sent(31)
    while thread.jobs:
        thread.step()
    assert 20 <= len(solver.seen) - before <= 27  # a quarter of a second's worth
    solving.share.left(clock[0])
    clock[0] = 20.0  # the bucket is full again
    sent(61)
    solving.clear()
    while thread.jobs:
        thread.step()
    assert solving.share.left(clock[0]) and budget.all.level == pytest.approx(0.25)


def test_what_was_put_off_is_solved_when_its_picture_is_due():
    clock, thread = [0.0], Stepped()
    solver = Timed(clock, 0.001)
    solving = PoseQueue(solver, thread, lambda: clock[0])
    limits = Limits(samples=0.0, samples_burst=2.0)
    solving.samples = ClientQuota(limits, 0.0).samples
    for frame_id in range(1, 8):
        clock[0] = frame_id * 0.01
        solving.add(Request(frame_id=frame_id, cameras=(), tracking=Sample(0.0)))
    solution = solving.take(7)
    while thread.jobs:
        thread.step()
    assert solution.result(0)[1] == pytest.approx(1.0)
    assert [frame_id for frame_id, _ in solver.seen] == [1, 2, 7]
    assert solver.seen[-1][1] == pytest.approx(0.07)  # when it arrived, not when it was solved
