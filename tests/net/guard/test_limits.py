"""Budgets of clients and addresses, with a clock made of numbers."""

from __future__ import annotations

import json
import random
from concurrent.futures import Executor, Future

import numpy as np
import pytest

from glsplat.net.backend import Solved
from glsplat.net.guard.addresses import Addresses
from glsplat.net.guard.duplicates import has_duplicates
from glsplat.net.guard.limits import Bucket, ClientQuota, CpuBudget, Limits, Strikes, address_key
from glsplat.net.guard.meter import FrameMeter
from glsplat.net.guard.reading import Reading
from glsplat.net.messages import Decoder, Request
from glsplat.net.pose_queue import PoseQueue
from glsplat.net.session import Session
from glsplat.skinning.pose import Pose
from glsplat.tracking.sample import Sample
from tests.net.wire import frame, native

LIMITS = Limits()
PING, TEXT = frame(0x9, b""), 0x1


def meter(limits=LIMITS):
    return FrameMeter(ClientQuota(limits, 0.0), limits)


@pytest.mark.parametrize(
    ("host", "key"),
    [
        ("192.0.2.7", "192.0.2.7"),
        ("::ffff:192.0.2.7", "192.0.2.7"),
        ("2001:db8:1:2:3:4:5:6", "2001:db8:1:2::/64"),
        ("2001:db8:1:2:ffff::1", "2001:db8:1:2::/64"),
        ("fe80::1%eth0", "fe80::/64"),
        ("::1", "::/64"),
    ],
)
def test_what_counts_as_one_address(host, key):
    assert address_key(host) == key


def full_hands(frame_id):
    """The longest request a headset sends: two eyes, head, wrists and both hands with rotations, all digits."""
    rng = np.random.default_rng(frame_id)
    values = {name: rng.uniform(-1, 1, 7).tolist() for name in ("head", "left", "right", "left_grip", "right_grip")}
    values |= {name: rng.uniform(-1, 1, (25, 7)).tolist() for name in ("left_joints", "right_joints")}
    eye = {"viewmat": rng.uniform(-1, 1, 16).tolist(), "K": rng.uniform(500, 900, 4).tolist()}
    return json.dumps(
        {"v": 1, "frame_id": frame_id, "ack": frame_id, "t": 1e3 / 3, "eyes": [eye, eye], "tracking": values}
    )


def test_a_client_at_120_hz_with_full_hands_meets_no_limit():
    """Also with an acknowledgement a picture, a ping a second, and all that 20 s of a dead network held back."""
    client, now = meter(), 0.0
    text = frame(TEXT, full_hands(1).encode())
    assert 8_000 < len(text) < 12_000
    ack = frame(TEXT, b'{"v": 1, "ack": 7}')
    second = [text, ack] * 120 + [PING]
    for _ in range(3):
        held = b"".join(second * 20)  # arrives at once, in the pieces a socket gives
        for at in range(0, len(held), 65536):
            assert client.feed(held[at : at + 65536], now)[1] is None
        for i in range(60 * len(second)):
            now += 1 / len(second)
            assert client.feed(second[i % len(second)], now)[1] is None


@pytest.mark.parametrize("kind", ["control", "frames", "bytes"])
def test_a_flood_is_noticed_at_the_limit(kind):
    limits = Limits(frames=100, frames_burst=50, control=10, control_burst=20, bytes=1e6, bytes_burst=1e5)
    one = {"control": PING, "frames": frame(0x1, b"{}"), "bytes": frame(0x1, b"x" * 60_000)}[kind]
    client = meter(limits)
    allowed, breach = client.feed(one * 20, 0.0) if kind != "bytes" else client.feed(one, 0.0)
    assert breach is None and allowed == (20 if kind != "bytes" else 1) * len(one)
    if kind == "frames":
        assert client.feed(one * 30, 0.0) == (30 * len(one), None)
    allowed, breach = client.feed(one * 1000, 0.1)  # a tenth of a second brought some back
    assert breach.code == 1008 and "a second" in breach.reason
    assert allowed == {"control": 1, "frames": 10, "bytes": 0}[kind] * len(one)


def test_the_meter_counts_the_same_however_the_bytes_arrive():
    """Random frames of all kinds and lengths, cut at random: the frames that RFC 6455's layout says, and no others."""
    rng = random.Random(1)
    for _ in range(60):
        kinds = [rng.choice((0x0, 0x1, 0x2, 0x8, 0x9, 0xA)) for _ in range(40)]
        sizes = [rng.choice((0, 1, 5, 125)) if k & 8 else rng.choice((0, 7, 126, 300, 65536)) for k in kinds]
        data = b"".join(frame(k, bytes(rng.randbytes(n))) for k, n in zip(kinds, sizes, strict=True))
        limits = Limits(frames=0, control=0)
        client = meter(limits)
        at = 0
        while at < len(data):
            step = rng.choice((1, 1, 2, 3, 7, 100, 70_000))
            assert client.feed(data[at : at + step], 0.0) == (len(data[at : at + step]), None)
            at += step
        control = sum(k >= 8 for k in kinds)
        quota = client._quota
        assert quota.control.level == limits.control_burst - control
        assert quota.frames.level == limits.frames_burst - (len(kinds) - control)


def test_frames_without_a_mask_are_refused_at_once():
    for bare in (b"\x81\x02{}", b"\x89\x00", b"\x81\x7e\x01\x00" + b"x" * 256):
        for cut in (1, 2, len(bare)):
            client = meter()
            assert client.feed(frame(0x1, b"{}"), 0.0)[1] is None
            found = [client.feed(bare[:cut], 0.0)[1], client.feed(bare[cut:], 0.0)[1] if cut < 2 else None]
            assert [f.code for f in found if f is not None] == [1002]


def test_connecting_again_brings_no_fresh_budget():
    limits = Limits(frames=10, frames_burst=100, visits_burst=1e9)
    addresses, now, passed = Addresses(limits, per_address=2), 0.0, 0
    for _ in range(1000):  # a flooder that comes back as soon as it is thrown out, for 10 s
        quota = addresses.enter("a", now)
        allowed, breach = FrameMeter(quota, limits).feed(frame(0x1, b"") * 500, now)
        assert breach is not None
        passed += allowed // len(frame(0x1, b""))
        addresses.leave("a", quota, now)
        now += 0.01
    assert passed <= 2 * (limits.frames_burst + limits.frames * 10) + 2


def test_a_quiet_client_spends_from_its_own_purse():
    addresses = Addresses(Limits(), per_address=3)
    quiet = addresses.enter("a", 0.0)
    for _ in range(50):
        loud = addresses.enter("a", 0.0)
        while loud.frames.take(0.0):
            pass
        addresses.leave("a", loud, 0.0)
    assert quiet.fullness(0.0) == 1
    second = addresses.enter("a", 0.0)
    assert addresses.enter("a", 0.0) is not None and addresses.enter("a", 0.0) is None
    assert addresses.enter("b", 0.0) is not None
    addresses.leave("a", second, 0.0)
    assert addresses.enter("a", 0.0) is not None


def test_hold_offs_double_and_are_forgotten():
    strikes = Strikes(free=2, first=1.0, most=60.0, forget=600.0)
    waits = []
    for i in range(12):
        strikes.strike(i * 100.0)
        waits.append(strikes.wait(i * 100.0))
    assert waits == [0, 0, 1, 2, 4, 8, 16, 32, 60, 60, 60, 60]
    assert not strikes.forgotten(1700.0) and strikes.forgotten(1161.0 + 600.0)
    strikes.strike(5000.0)
    assert strikes.count == 1 and strikes.wait(5000.0) == 0


def test_the_table_of_addresses_is_bounded_and_keeps_those_that_matter():
    limits = Limits(addresses=100, guesses=0)
    addresses = Addresses(limits, per_address=4)
    quota = addresses.enter("client", 0.0)
    addresses.breach("bad", 0.0)
    for i in range(10_000):
        addresses.visit(f"stranger {i}", 1.0)
    assert len(addresses) == 100
    assert addresses.held_off("bad", 1.0) == 9.0 and addresses.held_off("stranger 3", 1.0) == 0
    for i in range(10_000):  # even if all of them are bad
        addresses.guess(f"guesser {i}", 2.0)
    assert len(addresses) == 100
    addresses.leave("client", quota, 3.0)


def test_a_bucket_takes_no_time_backwards():
    bucket = Bucket.full(10.0, 5.0, 100.0)
    assert all(bucket.take(100.0) for _ in range(5)) and not bucket.take(100.0)
    assert not bucket.take(90.0) and bucket.take(100.11)


# duplicate keys


def plain(text):
    """The same question answered by Python's own decoder alone."""
    found = []

    def pairs(items):
        found.append(len(items) != len(dict(items)))

    json.loads(text, object_pairs_hook=pairs)
    return any(found)


def test_duplicate_keys_are_found_wherever_they_are():
    for text in (
        '{"a": 1, "a": 1}',
        '{"a": 1, "\\u0061": 2}',
        '{"v": 1, "x": [1, {"b": 1, "b": 2}]}',
        '{"eyes": [{"K": 1}, {"K": 1, "K": 2}]}',
        '{"x": "a:b", "y": {"z": ":", "z": ":"}}',
        '{"x": [[[{"a": {}, "a": {}}]]]}',
    ):
        assert plain(text) and has_duplicates(text) and has_duplicates(text.encode())
    for text in (
        '{"a": {"a": {"a": ":::"}}}',
        '[{"a": 1}, {"a": 1}, [{"a": ":"}]]',
        '{"n": ":", "m": ' + "9" * 300 + "}",
        '":"',
    ):
        assert not has_duplicates(text)
    assert not has_duplicates(full_hands(3)) and not has_duplicates(native(1))


def test_duplicate_keys_in_random_texts():
    rng = random.Random(2)

    def value(depth):
        kind = rng.random()
        if depth and kind < 0.35:
            keys = [rng.choice(("a", "b", "\\u0061", "c:", "d")) for _ in range(rng.randrange(4))]
            return "{" + ", ".join(f'"{key}": {value(depth - 1)}' for key in keys) + "}"
        if depth and kind < 0.6:
            return "[" + ", ".join(value(depth - 1) for _ in range(rng.randrange(4))) + "]"
        return rng.choice(("1", "-2.5e3", "null", '"x"', '":"', '"{\\"a\\": 1}"', "true"))

    texts = [value(4) for _ in range(4000)]
    answers = [plain(text) for text in texts]
    assert 200 < sum(answers) < 3800
    assert [has_duplicates(text) for text in texts] == answers


def test_a_session_refuses_duplicates():
    session = Session(Decoder())
    for text in (native(1)[:-1] + ', "frame_id": 2}', native(1).replace('"K"', '"K": [1, 1, 1, 1], "K"')):
        assert "gives a key twice" in session.receive(text, 0.0).text
    assert session.receive(native(1), 0.0).frame_id == 1 and session.counts.accepted == 1


# the time for reading


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
        return Solved(Pose.zero(), (), ())


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


def test_normal_tracking_is_solved_sample_by_sample():
    solved, each = clients([120.0, 90.0, 72.0], cost=0.001, seconds=10.0)
    assert np.allclose(solved, [120, 90, 72], atol=2) and [s.merged for s in each] == [0, 0, 0]


def test_six_clients_at_220_samples_a_second_leave_a_good_one_its_own():
    limits = Limits(work=0.35)
    solved, _ = clients([72.0] + [220.0] * 6, cost=0.0006, seconds=20.0, limits=limits)
    busy = sum(solved) * 0.0006
    assert busy < limits.work * 1.1  # of the thread, with what may be spent at once
    assert abs(solved[0] - 72) < 3  # within its seventh: 72 * 0.6 ms = 4.3 % of the time
    assert all(50 < rate < 130 for rate in solved[1:])


def test_above_the_rate_of_one_client_only_the_newest_is_solved():
    solved, each = clients([500.0], cost=0.0001, seconds=10.0)
    assert 145 < solved[0] < 160 and each[0].merged > 3000


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
