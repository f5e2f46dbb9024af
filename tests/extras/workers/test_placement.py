"""Who is drawn for where."""

from __future__ import annotations

import numpy as np
import pytest

from glsplat.extras.workers.placement import PlacedClient, PlacedWorker, better, choose


def worker(*costs: float, has: tuple[str, ...] = (), key: str = "avatar:ann") -> PlacedWorker:
    return PlacedWorker(tuple(PlacedClient(i, key, cost) for i, cost in enumerate(costs)), frozenset(has))


ANN = PlacedClient(99, "avatar:ann", 0.03)


QUICK = PlacedClient(99, "avatar:ann", 0.002)
ROOM = [worker(), worker(*[0.03] * 9, key="room:lab")]


@pytest.mark.parametrize(
    ("client", "workers", "chosen"),
    [
        (ANN, [], None),
        (ANN, [worker(), worker()], 0),
        (ANN, [worker(0.03), worker()], 1),
        (ANN, [worker(), worker(has=("avatar:ann",))], 1),
        (ANN, [worker(0.03), worker(0.03, has=("avatar:ann",))], 1),
        (ANN, [worker(0.03), worker(0.03, 0.03, 0.03, has=("avatar:ann",))], 0),  # twice as slow there
        (ANN, [worker(0.03, 0.03), worker(0.03, 0.03, 0.001, has=("avatar:ann",))], 1),  # hardly slower
        (ANN, [worker(0.0, 0.0), worker(0.0)], 1),  # of unknown cost
        (QUICK, [worker(), worker(*[0.002] * 3, has=("avatar:ann",))], 1),  # 8 ms for all four, 90 a second
        (QUICK, [worker(), worker(*[0.002] * 5, has=("avatar:ann",))], 0),
        (PlacedClient(99, "room:lab"), ROOM, 1),
        (PlacedClient(99, "room:other"), ROOM, 0),
    ],
)
def test_the_quickest_or_one_that_has_the_avatar_or_room(client, workers, chosen):
    assert choose(client, workers) == chosen


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
    """And the slowest worker is not slower than before."""
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
