"""Estimate a link and spend it, on simulated links (tools/net/simulated_link.py)."""

from __future__ import annotations

from itertools import pairwise
from math import inf, nan

import pytest

from glsplat.extras.far_links.link import LinkEstimator
from glsplat.extras.far_links.link_control import AHEAD, LinkControl
from glsplat.net.pace.ladder import REDUCED_FPS, SCALES, ladder, visible_loss
from tools.net.simulated_link import DRAW, FULL, Link, Oracle, Outcome, play

SECONDS = 20.0
SEED = 7  # the figures of the docs are of another


def goal(round_trip: float) -> float:
    """Seconds that a picture on show may be old."""
    return 1.3 * (round_trip + 0.12)


def used(outcome: Outcome, rate: float) -> float:
    return outcome.nbytes * 8e-6 / outcome.seconds / rate


def alone(rate: float, round_trip: float, **options: float) -> Outcome:
    return play(Link(lambda now: rate, round_trip), [LinkControl(**options)], SECONDS, SEED)[0]


@pytest.mark.parametrize(
    ("rate", "round_trip"), [(100.0, 0.02), (100.0, 0.15), (20.0, 0.06), (10.0, 0.15), (5.0, 0.02), (2.0, 0.06)]
)
def test_pictures_are_fresh_and_the_link_is_used(rate: float, round_trip: float) -> None:
    now = alone(rate, round_trip)
    assert now.age(0.95) <= goal(round_trip)
    assert now.most_waiting <= 1 + AHEAD + 0.1  # sizes vary by a tenth
    if 8e-6 * FULL * 0.62 / DRAW > rate:
        assert used(now, rate) >= 0.85
    if (rate, round_trip) == (100.0, 0.02):
        assert now.changes == 0 and set(now.losses) == {visible_loss(ladder(80, False)[0])}


@pytest.mark.check
@pytest.mark.parametrize("rate", [20.0, 5.0])
def test_lost_packets_are_not_taken_for_a_thin_link(rate: float) -> None:
    """One packet in a hundred is lost: as fresh as a policy that knows the link."""
    link = Link(lambda now: rate, 0.02, 0.01)
    outcome, knows = (play(link, [policy], 40.0, SEED)[0] for policy in (LinkControl(), Oracle(link)))
    assert outcome.age(0.95) <= 1.1 * max(knows.age(0.95), goal(0.02))
    if rate == 20:
        assert sorted(outcome.losses)[len(outcome.losses) // 2] == visible_loss(ladder(80, False)[0])
    else:
        assert used(outcome, rate) >= 0.85


def test_a_rate_that_falls_and_comes_back() -> None:
    link = Link(lambda now: 3.0 if 15 <= now < 30 else 20.0, 0.06)
    outcome = play(link, [LinkControl()], 40.0, SEED)[0]
    assert outcome.age(1.0, 12.0, 25.0) <= goal(0.06)  # from two seconds after the fall
    assert outcome.age(1.0, 25.5, 40.0) <= goal(0.06)
    assert outcome.losses[-1] == visible_loss(ladder(80, False)[0])


@pytest.mark.check
@pytest.mark.parametrize(("rate", "round_trip", "starts"), [(20.0, 0.02, (0.0, 0.003)), (5.0, 0.06, (0.0, 7.0))])
def test_two_clients_share_a_link(rate: float, round_trip: float, starts: tuple[float, float]) -> None:
    both = play(Link(lambda now: rate, round_trip), [LinkControl(), LinkControl()], 40.0, SEED, starts)
    sent = sorted(outcome.nbytes for outcome in both)
    assert sent[1] <= 0.6 * sum(sent)


def test_a_cap_holds() -> None:
    outcome = alone(100.0, 0.02, cap=4e6)
    assert 0.85 * 4 <= outcome.nbytes * 8e-6 / outcome.seconds <= 4.0


@pytest.mark.parametrize("busy", [0.15, 0.4])
def test_a_client_that_is_busy_is_no_slow_link(busy: float) -> None:
    """Pings behind pictures are answered although the page acknowledges late."""
    fast, thin = (
        play(Link(lambda now, rate=rate: rate, trip), [LinkControl()], SECONDS, SEED, busy=busy)[0]
        for rate, trip in ((100.0, 0.001), (3.0, 0.02))
    )
    assert fast.full == fast.arrived > 0
    assert thin.full < 0.1 * thin.arrived


def test_pongs_tell_when_pictures_arrived() -> None:
    """The newest pong stands for those before it; a guessed or repeated one says nothing."""
    control = LinkControl()
    assert control.link.known is False
    control.ponged(control.ping(0.0) or b"", 0.02)
    pings = []
    for number in (1, 2, 3):
        control.written(number, 10_000, 1.0 + number)
        pings.append(control.follow(number))
    assert len({*pings}) == 3 and all(len(ping) >= 8 for ping in pings)
    for guess in (b"", b"\0\0\0\1", bytes(8), pings[0][:-1], pings[1] + b"x"):
        control.ponged(guess, 4.1)
    assert control.link.on_the_way == 3
    control.ponged(pings[1], 4.1)
    assert control.link.on_the_way == 1 and control.link.newest is not None
    newest = control.link.newest
    for ping in pings[:2]:
        control.ponged(ping, 9.0)
    control.acknowledged(2, 5.0, 0.0, 9.0)  # later than the pong: nothing new, but for the age
    assert control.link.newest is newest and control.age == 5.0
    control.acknowledged(3, 1.0, 0.0, 9.1)  # of one whose pong never came
    assert control.link.on_the_way == 0 and control.link.newest is not newest


def test_pings_that_nobody_answers_are_forgotten() -> None:
    control = LinkControl()
    pings = [control.follow(number) for number in range(10_000)]
    control.ponged(pings[0], 1.0)
    assert len(control._behind) <= 64


def test_nothing_swings() -> None:
    """On a steady link sizes stay."""

    class Watched(LinkControl):
        scales: list[tuple[float, float]] = []  # noqa: RUF012

        def rung(self, *args):
            found = super().rung(*args)
            self.scales.append((args[-1], found.scale))
            return found

    control = Watched()
    play(Link(lambda now: 3.0, 0.04), [control], 60.0, SEED)
    late = [scale for now, scale in control.scales if now > 15]
    assert sum(one != other for one, other in pairwise(late)) <= 4 and len({*late}) <= 2


def test_fast_renderers_are_slowed_down_before_pictures_are_ugly() -> None:
    control = LinkControl()
    control.link.pinged(b"1", 0.0)
    control.link.ponged(b"1", 0.02)
    now, number, rests = 1.0, 0, 0
    for _ in range(600):  # a renderer of 72 a second on 2 Mbit/s
        now += 1 / 72
        if control.rest(now) > 0:
            rests += 1
            continue
        number += 1
        rung = control.rung(number, 1024 * 1024, 80, True, now)
        control.written(number, round(40_000 * rung.bits), now)
        control.acknowledged(number, 0.1, 0.0, now + 0.02 + 8 * 40_000 * rung.bits / 2e6)
    assert rests > 100 and number < 600 / 72 * (REDUCED_FPS + 5)


def delivered(link: LinkEstimator, rate: float, base: float, start: float, count: int, nbytes: int = 10_000) -> float:
    """Pictures one after the other, each alone on the way."""
    now = start
    for number in range(int(start * 1000), int(start * 1000) + count):
        link.written(number, nbytes, now)
        now += base + 8 * nbytes / rate
        link.acknowledged(number, 0.0, now)
        now += 0.02
    return now


def known(base: float = 0.04) -> LinkEstimator:
    link = LinkEstimator()
    link.pinged(b"p", 0.0)
    link.ponged(b"p", base)
    return link


def test_rate_and_round_trip_are_found() -> None:
    link = known()
    delivered(link, 4e6, 0.04, 1.0, 10)
    assert link.rate == pytest.approx(4e6) and link.base == pytest.approx(0.04) and link.standing < 1e-6


def test_one_late_picture_changes_nothing_three_do() -> None:
    link = known()
    now = delivered(link, 4e6, 0.04, 1.0, 20)
    link.written(90_000, 10_000, now)
    link.acknowledged(90_000, 0.0, now + 0.3)
    assert link.rate == pytest.approx(4e6)
    delivered(link, 5e5, 0.04, 100.0, 4)
    assert link.rate == pytest.approx(5e5)


def test_pictures_that_were_released_together_are_not_taken_for_a_fast_link() -> None:
    link = known()
    now = delivered(link, 4e6, 0.04, 1.0, 20)
    for number in range(90_000, 90_004):
        link.written(number, 10_000, now + 0.05 * (number - 90_000))
    for number in range(90_000, 90_004):
        link.acknowledged(number, 0.0, now + 0.3)
    assert link.rate == pytest.approx(4e6)


def test_nothing_is_known_without_an_answer_to_a_ping() -> None:
    link = LinkEstimator()
    delivered(link, 4e6, 0.04, 1.0, 10)
    assert not link.known and link.rate == inf


@pytest.mark.parametrize("held", [nan, inf, -inf, -1.0, 1e300, 59.0])
def test_lies_stay_within_what_is_measured(held: float) -> None:
    link = known()
    for number in range(50):
        link.written(number, 10_000, 1.0 + 0.1 * number)
        link.acknowledged(number, held, 1.05 + 0.1 * number)
    assert 0 < link.rate < inf and 0 < link.base <= 0.04 and 0 <= link.standing <= 0.1
    link.acknowledged(7, 0.0, 9.0)  # again, and what was never written
    link.acknowledged(10**9, 0.0, 9.0)
    link.ponged(b"never asked", 9.0)
    assert link.on_the_way == 0


@pytest.mark.parametrize("quality", [1, 10, 35, 80, 87, 100])
@pytest.mark.parametrize("crop", [False, True])
def test_rungs_take_ever_fewer_bits(quality: int, crop: bool) -> None:
    rungs = ladder(quality, crop)
    assert rungs[0].full and rungs[0].quality == quality and rungs[0].crop == crop
    bits = [rung.bits for rung in rungs]
    assert bits == sorted(bits, reverse=True) and len(set(bits)) == len(bits)
    assert all(rung.quality <= quality and rung.scale in SCALES for rung in rungs)
    losses = [visible_loss(rung) for rung in rungs]
    assert losses == sorted(losses)
