"""Fair turns on a simulated clock."""

from __future__ import annotations

from dataclasses import dataclass, field

import pytest

from glsplat.net.pace.fair_queue import FairQueue


@dataclass(eq=False)
class Client:
    """Asks for pictures of ``length`` seconds: always, or every ``period`` seconds."""

    address: str
    length: float
    period: float = 0.0
    drawn: list[float] = field(default_factory=list)  # when
    asked: float = -1.0

    def ready(self, now: float) -> bool:
        return self.period == 0 or now // self.period > self.asked

    @property
    def time(self) -> float:
        return len(self.drawn) * self.length


class World:
    def __init__(self, *clients: Client) -> None:
        self.turns: FairQueue[Client] = FairQueue()
        self.now, self.idle = 0.0, 0.0
        for client in clients:
            self.turns.add(client.address, client)

    def run(self, seconds: float) -> None:
        end = self.now + seconds
        while self.now < end:
            client = self.turns.next(lambda c: c.ready(self.now), self.now)
            if client is None:
                step = self.turns.rest(self.now) or 0.01
                self.now += min(step, 0.01)
                self.idle += min(step, 0.01)
                continue
            assert client.ready(self.now)
            client.asked = self.now // client.period if client.period else 0
            self.now += client.length
            client.drawn.append(self.now)
            self.turns.charge(client.address, client, client.length, self.now)


def test_addresses_share_first_then_their_clients() -> None:
    many, one = [Client("a", 0.02) for _ in range(7)], Client("b", 0.03)
    World(*many, one).run(60)
    assert one.time == pytest.approx(30, rel=0.05)
    assert [c.time for c in many] == pytest.approx([30 / 7] * 7, rel=0.05)


def test_a_small_client_keeps_its_rate_beside_seven_big_ones() -> None:
    small, big = Client("s", 0.01, period=0.1), [Client(f"b{i}", 0.3) for i in range(7)]
    world = World(small, *big)
    world.run(60)
    # one picture each in turn: 0.48 a second
    assert len(small.drawn) / 60 >= 4.5
    assert min(c.time for c in big) == pytest.approx(max(c.time for c in big), rel=0.1)
    assert sum(c.time for c in big) > 0.4 * 60


def test_pictures_of_seconds_leave_the_others_five_sixths_of_the_time() -> None:
    good, slow = Client("g", 0.06, period=0.2), [Client(f"b{i}", 4.5) for i in range(15)]
    World(good, *slow).run(600)
    assert len(good.drawn) >= 0.8 * 600 / 0.2
    assert sum(c.time for c in slow) > 0.15 * 600 and min(len(c.drawn) for c in slow) > 0


def test_a_rest_begins_also_when_short_pictures_come_later() -> None:
    slow, good = Client("b", 5.0), Client("g", 0.06, period=0.2)
    world = World(slow)
    world.run(5)
    world.turns.add("g", good)
    world.run(15)
    assert len(slow.drawn) == 1 and len(good.drawn) >= 70


def test_without_short_pictures_nothing_rests() -> None:
    world = World(Client("a", 1.0), Client("b", 2.0))
    world.run(60)
    assert world.idle == 0
    left = Client("c", 0.01, period=0.1)
    world.turns.add("c", left)
    world.run(10)
    world.turns.remove("c", left)
    world.run(10)  # what is left of a rest
    idle = world.idle
    world.run(60)
    assert world.idle == idle


def test_idle_and_new_clients_have_no_credit() -> None:
    a, b = Client("a", 0.05), Client("b", 0.05)
    world = World(a)
    world.run(100)
    world.turns.add("b", b)
    before = len(a.drawn)
    world.run(2)
    assert len(a.drawn) - before == pytest.approx(20, abs=2)
    b.period = 1000.0  # idle for long, then back
    world.run(100)
    b.period = 0.0
    before = len(a.drawn), len(b.drawn)
    world.run(2)
    assert len(a.drawn) - before[0] == pytest.approx(len(b.drawn) - before[1], abs=2)


def test_a_stream_of_new_clients_starves_nobody() -> None:
    old = Client("old", 0.05)
    world = World(old)

    def stream(address: str, count: int) -> float:
        """Clients come and go; return what the old one gets of the time."""
        clients, before, began = [Client(address.format(i), 0.05) for i in range(count)], old.time, world.now
        for i, client in enumerate(clients):
            world.turns.add(client.address, client)
            world.run(0.05)
            if i >= 4:
                world.turns.remove(clients[i - 4].address, clients[i - 4])
        return (old.time - before) / (world.now - began)

    assert stream("n{}", 400) > 0.2
    assert stream("old", 200) > 0.3 / 5  # of the fifth of the time that its address has


def test_leaving_and_coming_back_wipes_out_no_debt() -> None:
    good, bad = Client("g", 0.1), Client("b", 0.39)
    world = World(good, bad)
    for _ in range(100):
        before = len(bad.drawn)
        while len(bad.drawn) == before:
            world.run(0.01)
        world.turns.remove("b", bad)
        assert ("b", bad) not in world.turns
        world.turns.add("b", bad)
    assert good.time == pytest.approx(bad.time, rel=0.1)
    world.turns.remove("b", bad)
    world.run(5)
    world.turns.add("x", Client("x", 1))
    world.turns.remove("x", good)  # harmless
    assert "b" not in world.turns._addresses  # forgotten once the others have caught up


def test_who_is_known_for_short_pictures_does_not_rest_when_it_comes() -> None:
    """A client that comes from another worker, after somebody's long picture here."""
    for length, chosen in ((None, "short"), (0.01, "come")):
        turns: FairQueue[str] = FairQueue()
        turns.add("a", "short", 0.01)
        turns.add("b", "long", 1.0)
        for _ in range(5):
            assert turns.next({"short"}.__contains__, 1.0) == "short"
            turns.charge("a", "short", 0.01, 1.0)
        turns.charge("b", "long", 1.0, 2.0)
        turns.add("c", "come", length)
        turns.charge("a", "short", 0.5, 2.0)
        turns.charge("a", "short", 0.01, 2.5)
        assert turns.next({"come", "short"}.__contains__, 2.1) == chosen
