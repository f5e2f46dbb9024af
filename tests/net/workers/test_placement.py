"""Who is drawn for where."""

from __future__ import annotations

import numpy as np
import pytest

from glsplat.net.workers.placement import PlacedClient, PlacedWorker, better, choose


def worker(*costs: float, has: tuple[str, ...] = (), key: str = "avatar:ann", share: float = 1.0) -> PlacedWorker:
    return PlacedWorker(tuple(PlacedClient(i, key, cost) for i, cost in enumerate(costs)), frozenset(has), share)


ANN = PlacedClient(99, "avatar:ann", 0.03)


@pytest.mark.parametrize(
    ("workers", "chosen"),
    [
        ([], None),
        ([worker(), worker()], 0),
        ([worker(0.03), worker()], 1),
        ([worker(), worker(has=("avatar:ann",))], 1),
        ([worker(0.03), worker(0.03, has=("avatar:ann",))], 1),
        ([worker(0.03), worker(0.03, 0.03, 0.03, has=("avatar:ann",))], 0),  # twice as slow there
        ([worker(0.03, 0.03), worker(0.03, 0.03, 0.001, has=("avatar:ann",))], 1),  # hardly slower
        ([worker(0.03, share=0.25), worker(0.03, 0.03)], 1),  # a quarter of a GPU
        ([worker(0.0, 0.0), worker(0.0)], 1),  # nobody knows how long their pictures take
    ],
)
def test_the_quickest_or_one_that_has_the_avatar(workers, chosen):
    assert choose(ANN, workers) == chosen


def test_avatars_are_shared_while_that_is_quick_enough():
    quick = PlacedClient(99, "avatar:ann", 0.002)
    has = worker(0.002, 0.002, 0.002, has=("avatar:ann",))
    assert choose(quick, [worker(), has]) == 1  # 8 ms for all four, 90 a second
    has = worker(*[0.002] * 5, has=("avatar:ann",))
    assert choose(quick, [worker(), has]) == 0


def test_rooms_stay_together():
    full, empty = worker(*[0.03] * 9, key="room:lab"), worker()
    assert choose(PlacedClient(99, "room:lab"), [empty, full]) == 1
    assert choose(PlacedClient(99, "room:other"), [empty, full]) == 0


def test_what_moves():
    assert better([worker(0.03)]) is None
    assert better([worker(0.03), worker()]) is None  # as slow there
    assert better([worker(0.03, 0.03), worker(0.03)]) is None  # the other would be as slow
    assert better([worker(0.03, 0.03), worker()]) in (((0,), 1), ((1,), 1))
    assert better([worker(0.001, 0.001, 0.001), worker()]) is None  # quick enough as it is
    assert better([worker(0.03, 0.03, key="room:lab"), worker()]) is None  # one room
    mixed = PlacedWorker(
        (PlacedClient(1, "room:a", 0.03), PlacedClient(2, "room:a", 0.03), PlacedClient(3, "room:b", 0.04))
    )
    assert better([mixed, worker()]) == ((1, 2), 1)


def test_moves_come_to_an_end():
    """Whatever the clients are: nobody moves for ever, and the slowest worker is not slower than before."""
    rng = np.random.default_rng(0)
    for _ in range(50):
        clients = [
            PlacedClient(i, f"room:{i // 3}" if i % 2 else "avatar:x", float(c))
            for i, c in enumerate(rng.exponential(0.02, 20))
        ]
        places = [list(clients), [], []]
        first = sum(one.cost for one in clients)
        for _ in range(100):
            found = better([PlacedWorker(tuple(place)) for place in places])
            if found is None:
                break
            numbers, to = found
            for place in places:
                gone = [one for one in place if one.number in numbers]
                for one in gone:
                    place.remove(one)
                    places[to].append(one)
        loads = [sum(one.cost for one in place) for place in places]
        assert found is None and max(loads) <= first
        assert sorted(one.number for place in places for one in place) == list(range(20))
