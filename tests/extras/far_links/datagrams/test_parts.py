"""What needs no socket: secrets, the window, and a session that hears of lost pictures."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from glsplat.extras.far_links.datagrams.offers import LASTS, Offers

pytest.importorskip("aioquic", reason="aioquic (glsplat[webtransport]) is not installed")

from glsplat.extras.far_links.datagrams.congestion import PictureWindow
from glsplat.extras.far_links.datagrams.way import SecondWay
from glsplat.extras.far_links.link_control import LinkControl
from glsplat.net.messages import Decoder, Request
from glsplat.net.session import Session, SessionConfig
from tests.net.wire import native


@pytest.fixture
def now() -> list[float]:
    return [0.0]


@pytest.fixture
def offers(now: list[float]) -> Offers[object]:
    return Offers(lambda: now[0])


def test_a_secret_is_for_one_use_its_address_and_seconds(offers: Offers[object], now: list[float]) -> None:
    secret = offers.make("1.2.3.4", whose := object())
    assert offers.take(secret, "1.2.3.5") is None and offers.take("", "1.2.3.4") is None
    assert offers.take(secret, "1.2.3.4") is whose and offers.take(secret, "1.2.3.4") is None
    secret = offers.make("1.2.3.4", whose)
    assert offers.knock("1.2.3.4") and not offers.knock("1.2.3.5") and offers.open()
    now[0] = LASTS + 0.01
    assert offers.take(secret, "1.2.3.4") is None and not offers.knock("1.2.3.4") and not offers.open()
    assert offers.take(offers.make("1.2.3.4", whose), "1.2.3.4") is whose


def test_a_client_has_one_and_takes_it_along(offers: Offers[object]) -> None:
    whose = object()
    first, second = offers.make("a", whose), offers.make("a", whose)
    assert first != second and len(second) >= 32
    assert offers.take(first, "a") is None and offers.knock("a")
    offers.withdraw(whose)
    assert offers.take(second, "a") is None and not offers.knock("a")


def test_few_packets_of_an_address_are_looked_at_for_each_offer(offers: Offers[object]) -> None:
    one, other = object(), object()
    offers.make("a", one)
    most = sum(offers.knock("a") for _ in range(1000))
    assert 8 <= most <= 64 and not offers.knock("a")
    offers.make("b", other)
    assert not offers.knock("a") and offers.knock("b")
    offers.make("a", object())
    assert sum(offers.knock("a") for _ in range(1000)) == most


def packet(number: int, nbytes: int = 1200) -> Any:
    return SimpleNamespace(packet_number=number, sent_bytes=nbytes)


def test_lost_packets_do_not_close_the_window() -> None:
    window = PictureWindow(max_datagram_size=1200)
    window.allow(20e6, 70_000)
    before = window.congestion_window
    for number in range(100):
        window.on_packet_sent(packet=packet(number))
    assert window.bytes_in_flight == 120_000 and not window.settled(99) and not window.settled(0)
    for number in range(0, 100, 10):
        window.on_packets_lost(now=1.0, packets=[packet(number)])
    for number in range(100):
        if number % 10:
            window.on_packet_acked(now=1.0, packet=packet(number))
    assert window.congestion_window == before and window.bytes_in_flight == 0
    assert window.settled(99) and window.lost_of(0, 99) == 10 and window.lost_of(11, 19) == 0
    assert 0.03 < window.loss < 0.1


def test_the_window_holds_what_the_link_does_and_a_picture() -> None:
    window = PictureWindow(max_datagram_size=1200)
    for _ in range(100):
        window.on_rtt_measurement(now=0.0, rtt=0.06)
    window.allow(20e6, 70_000)
    assert 2 * 150_000 + 70_000 <= window.congestion_window <= 4 * 150_000 + 70_000
    window.allow(float("inf"), 1)
    assert window.congestion_window < 10e6
    window.on_persistent_congestion()
    assert window.congestion_window == 2 * 1200


def test_a_lost_picture_makes_room_and_says_that_too_much_is_spent() -> None:
    session, now = Session(Decoder(), SessionConfig(adapt=True), now=0.0), 0.0
    for number in range(1, 60):
        now += 0.05
        told = {"arrival": {"age": 60}, "ack": number - 1} if number > 1 else {"ack": 0}
        assert isinstance(session.receive(native(number, **told), now), Request)
        assert session.link is None or isinstance(session.link, LinkControl)
        if session.link is not None:
            session.link.ponged(session.link.ping(now) or b"", now + 0.02)
        taken = session.next_request(now)
        assert taken is not None
        session.rung(taken[0], now)
        session.sending(taken[0], 20_000, now)
        session.sent(taken[0], 20_000)
    link = session.link
    assert link is not None and link.link.known
    spend = link.spend
    assert session.status()["unacknowledged"] == 1 and link.link.on_the_way == 1
    session.lost(59, now + 0.1)
    assert session.status()["unacknowledged"] == 0 and link.link.on_the_way == 0
    assert link.spend < spend


def test_an_unknown_picture_that_is_lost_changes_nothing() -> None:
    session = Session(Decoder(), SessionConfig(adapt=True), now=0.0)
    session.lost(7, 0.0)
    session.receive(native(1, arrival={"age": 60}), 0.1)
    session.lost(2**32 - 1, 0.2)
    assert session.link is not None and not session.link.link.known


class Way:
    """A path that takes pictures of up to 5000 bytes."""

    loss = 0.0

    def overhead(self, nbytes: int) -> float:
        return 1.25

    def takes(self, nbytes: int) -> bool:
        return nbytes <= 5000


def test_what_a_picture_takes_of_the_link_is_known_before_it_goes() -> None:
    """By datagrams it counts with its parity."""
    way = SecondWay(Nobody(), Session(Decoder(), now=0.0), "a", lambda: 0.0, lambda: None)
    assert way.link_bytes(1000) == 1000
    way.opened(Way())  # type: ignore[arg-type]
    assert way.link_bytes(1000) == 1250 and way.link_bytes(6000) == 6000
    way.closed()
    assert way.link_bytes(1000) == 1000


async def test_of_too_many_requests_the_newest_are_kept() -> None:
    session = Session(Decoder(), SessionConfig(adapt=True), now=0.0)
    way = SecondWay(Nobody(), session, "a", lambda: 0.0, lambda: None)
    for number in range(200):
        way.heard(b"%d" % number)
    found = [await way.message() for _ in range(3)]
    first, second, third = map(int, found)
    assert 100 < first == second - 1 == third - 2


class Nobody:
    """A host that lets nobody in."""

    def offer(self, address: str, user: object) -> dict[str, str] | None:
        return None

    def withdraw(self, user: object) -> None:
        pass
