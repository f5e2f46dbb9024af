"""Simulate streams over links by a virtual clock, without sockets and sleeps; results are deterministic.

The server's control of a link (glsplat/net/pace) is real. The rest is a model:

- The display requests at 72 Hz; requests are small and take half of the round trip.
- The newest request is drawn when the renderer is free: 50 ms for a pair of full size, times (0.18 + 0.82 scale^2)
  for smaller ones, then 4 ms to encode. Sizes of pictures vary by a tenth.
- The bottleneck is one FIFO queue that never overflows. A lost packet (1,448 bytes) is sent again when three later
  ones of its picture have arrived, else after two round trips; if lost again, after 200 ms and the round trip.
  Everything behind it waits (TCP delivers in order). TCP's own window, which with loss would send less than the link
  takes, is not modelled.
- With datagrams (far_links/datagrams) a picture has additional bytes of headers and parity and waits for no other. It
  arrives unless more packets are lost than it has parity; the server hears of a lost picture a round trip later.
  Replies and requests are not lost in either model.
- The client's receiver answers pings at once, also those right behind pictures. The client acknowledges at once, or
  every ``busy`` seconds, decodes in 4 ms and shows the newest picture at its next refresh.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import count
from random import Random

from glsplat.extras.far_links.datagrams.packets import PIECE, parity_for
from glsplat.extras.far_links.link_control import LinkControl
from glsplat.net.pace.ladder import MAX_SMOOTH_LPIPS, REDUCED_FPS, Rung, ladder, visible_loss

REFRESH = 1 / 72
DRAW, ENCODE, DECODE = 0.050, 0.004, 0.004  # seconds
FULL = 63_000  # bytes of a whole pair at full size and quality 80
QUALITY = 80
PIXELS = 1024 * 1024
PACKET = 1448  # bytes
_HEADERS = 60  # bytes of a datagram besides its piece
WINDOW = 2  # pictures under way without control
WARM_UP = 5.0


@dataclass(frozen=True, slots=True)
class Link:
    """A link; ``rate`` returns Mbit/s at a time in seconds."""

    rate: Callable[[float], float]
    round_trip: float  # seconds
    loss: float = 0.0  # of the packets


class Fixed:
    """No control: full quality, two pictures under way."""

    window = WINDOW

    def rung(self, number: int, pixels: int, quality: int, crop: bool, now: float) -> Rung:
        return ladder(quality, crop)[0]

    def written(self, number: int, nbytes: int, now: float) -> None: ...

    def acknowledged(self, number: int, age: float, held: float, now: float) -> None: ...

    def lost(self, number: int, now: float) -> None: ...

    def ping(self, now: float) -> bytes | None:
        return None

    def follow(self, number: int) -> bytes:
        return b""

    def ponged(self, payload: bytes, now: float) -> None:
        return None

    def rest(self, now: float) -> float:
        return 0.0


class Oracle(Fixed):
    """Control that knows the current rate and the size of the next picture."""

    window = 8

    def __init__(self, link: Link) -> None:
        self._link = link
        self._free, self._own, self._begun, self._least = 0.0, 0.0, 0.0, 0.0

    def rung(self, number: int, pixels: int, quality: int, crop: bool, now: float) -> Rung:
        rungs = ladder(quality, crop)
        spend = 0.93 * self._link.rate(now) * 1e6
        for rung in rungs:
            calm = 0.0 if rung.full or visible_loss(rung) <= MAX_SMOOTH_LPIPS else 1 / REDUCED_FPS
            self._least = max(draw_time(rung.scale), calm)
            if 8 * FULL * rung.bits <= spend * self._least:
                break
        self._begun = now
        return rung

    def written(self, number: int, nbytes: int, now: float) -> None:
        self._own = 8 * nbytes / (self._link.rate(now) * 1e6)
        self._free = max(self._free, now) + self._own

    def rest(self, now: float) -> float:
        return max(0.0, self._free - now - DRAW - 0.5 * self._own, self._begun + self._least - now)


Policy = LinkControl | Fixed
"""A server's control of one client's link, or a baseline."""


@dataclass
class Outcome:
    """Results of one client after the warm-up."""

    ages: list[tuple[float, float]] = field(default_factory=list)  # time, age of the shown picture; seconds
    shown: int = 0
    nbytes: float = 0.0
    losses: list[float] = field(default_factory=list)  # LPIPS of shown pictures
    changes: int = 0  # of the rung
    arrived: int = 0  # pictures
    full: int = 0  # arrived pictures of the requested size and quality
    most_waiting: float = 0.0  # most pictures in the queue when one is written, including it
    seconds: float = 0.0

    def age(self, part: float, begin: float = 0.0, end: float = float("inf")) -> float:
        """Return the quantile ``part`` of ages between two times, seconds."""
        ages = sorted(age for at, age in self.ages if begin <= at < end)
        return ages[min(len(ages) - 1, int(part * len(ages)))] if ages else float("nan")


class _Client:
    def __init__(self, policy: Policy, window: int, seed: int) -> None:
        self.policy, self.window, self.chance = policy, window, Random(seed)
        self.mailbox: float | None = None  # time of the newest request
        self.drawing = self.resting = False
        self.under_way: set[int] = set()
        self.numbers = count(1)
        self.arrived = 0.0  # arrival of the newest picture
        self.decoded: tuple[float, Rung] | None = None
        self.on_show: float | None = None
        self.rung: Rung | None = None
        self.outcome = Outcome()


def play(
    link: Link,
    policies: Sequence[Policy],
    seconds: float = 60.0,
    seed: int = 1,
    starts: Sequence[float] = (),
    busy: float = 0.0,
    full: int = FULL,
    datagrams: bool = False,
) -> list[Outcome]:
    """Simulate a client per policy, all behind one bottleneck, for ``seconds`` after the warm-up.

    ``busy``: seconds between two reads of a client's socket. ``full``: bytes of a pair at full size and quality.
    ``datagrams``: replace TCP.
    """
    clients = [_Client(policy, getattr(policy, "window", 8), seed * 100 + i) for i, policy in enumerate(policies)]
    starts = starts or [0.003 * i for i in range(len(policies))]
    return _Simulation(link, clients, seconds, busy, full, datagrams).run(starts)


class _Simulation:
    def __init__(
        self, link: Link, clients: Sequence[_Client], seconds: float, busy: float, full: int, datagrams: bool
    ) -> None:
        self._link, self._clients, self._datagrams = link, clients, datagrams
        self._end, self._busy, self._full = WARM_UP + seconds, busy, full
        self._free = 0.0  # time when the bottleneck's queue is empty
        self._now = 0.0
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._order = count()

    def run(self, starts: Sequence[float]) -> list[Outcome]:
        for client, start in zip(self._clients, starts, strict=True):
            self._at(start, lambda client=client: self._refresh(client))
        while self._events and self._events[0][0] < self._end:
            self._now, _, act = heapq.heappop(self._events)
            act()
        for client in self._clients:
            client.outcome.seconds = self._end - WARM_UP
        return [client.outcome for client in self._clients]

    def _at(self, when: float, act: Callable[[], None]) -> None:
        heapq.heappush(self._events, (max(when, self._now), next(self._order), act))

    @property
    def _counts(self) -> bool:
        return self._now >= WARM_UP

    def _refresh(self, client: _Client) -> None:
        now = self._now
        if client.decoded is not None:
            client.on_show, rung = client.decoded
            client.decoded = None
            if self._counts:
                client.outcome.shown += 1
                client.outcome.losses.append(visible_loss(rung))
        if client.on_show is not None and self._counts:
            client.outcome.ages.append((now - WARM_UP, now - client.on_show))

        def received() -> None:
            client.mailbox = now
            self._draw(client)

        self._at(now + self._link.round_trip / 2, received)
        self._at(now + REFRESH, lambda: self._refresh(client))

    def _draw(self, client: _Client) -> None:
        if client.drawing or client.resting or client.mailbox is None or len(client.under_way) >= client.window:
            return
        rest = client.policy.rest(self._now)
        if rest > 0:
            client.resting = True

            def rested() -> None:
                client.resting = False
                self._draw(client)

            self._at(self._now + max(rest, 1e-4), rested)
            return
        asked, client.mailbox, client.drawing = client.mailbox, None, True
        number = next(client.numbers)
        client.under_way.add(number)
        rung = client.policy.rung(number, PIXELS, QUALITY, False, self._now)
        if self._counts and client.rung is not None:
            client.outcome.changes += rung != client.rung
        client.rung = rung

        def drawn() -> None:
            client.drawing = False
            self._at(self._now + ENCODE, lambda: self._write(client, number, asked, rung))
            self._draw(client)

        self._at(self._now + draw_time(rung.scale), drawn)

    def _write(self, client: _Client, number: int, asked: float, rung: Rung) -> None:
        now, trip = self._now, self._link.round_trip
        nbytes = round(self._full * rung.bits * (1 + 0.1 * client.chance.uniform(-1, 1)))
        packets = -(-nbytes // PIECE)
        parity = parity_for(packets, self._link.loss)
        if self._datagrams:
            nbytes += packets * _HEADERS + parity * (PIECE + _HEADERS)
        ping = client.policy.ping(now)
        if ping is not None:
            there = max(now, self._free) + trip
            self._at(there, lambda: client.policy.ponged(ping, there))
        client.policy.written(number, nbytes, now)
        behind = client.policy.follow(number)
        waiting = max(0.0, self._free - now)
        begin = max(now, self._free)
        self._free = self._sent(begin, nbytes)
        own = self._free - begin
        if self._counts:
            client.outcome.most_waiting = max(client.outcome.most_waiting, (waiting + own) / own)

        def lost() -> None:
            client.under_way.discard(number)
            client.policy.lost(number, self._now)
            self._draw(client)

        if self._datagrams:
            if sum(client.chance.random() < self._link.loss for _ in range(packets + parity)) > parity:
                self._at(self._free + trip, lost)
                return
            arrives = self._free + trip / 2
        else:
            arrives = max(self._through(client, begin, nbytes), client.arrived)
        client.arrived = arrives

        def arrived() -> None:
            if self._counts:
                client.outcome.nbytes += nbytes
                client.outcome.arrived += 1
                client.outcome.full += rung.full
            seen = arrives if not self._busy else self._busy * (arrives // self._busy + 1)
            self._at(arrives + trip / 2, ponged)
            self._at(seen + trip / 2, lambda: acknowledged(seen))
            self._at(seen + DECODE, decoded)

        def ponged() -> None:
            client.policy.ponged(behind, self._now)

        def acknowledged(seen: float) -> None:
            client.under_way.discard(number)
            client.policy.acknowledged(number, seen - asked, 0.0, self._now)
            self._draw(client)

        def decoded() -> None:
            client.decoded = asked, rung

        self._at(arrives, arrived)

    def _sent(self, begin: float, nbytes: float) -> float:
        """Return when the bottleneck has sent ``nbytes``, in steps of 2 ms, as its rate may change."""
        bits, now, step = 8.0 * nbytes, begin, 0.002
        while True:
            rate = self._link.rate(now) * 1e6
            if bits <= rate * step:
                return now + bits / rate
            bits -= rate * step
            now += step

    def _through(self, client: _Client, begin: float, nbytes: int) -> float:
        """Return when a whole picture has arrived, with lost packets sent again."""
        trip, loss = self._link.round_trip, self._link.loss
        done = self._free + trip / 2
        if not loss:
            return done
        packets = -(-nbytes // PACKET)
        each = (self._free - begin) / packets
        latest = done
        for index in range(packets):
            if client.chance.random() >= loss:
                continue
            at = begin + each * (index + 1) + trip / 2  # its arrival without loss
            again = at + (3 * each + trip if packets - index > 3 else 2 * trip + 0.01)
            while client.chance.random() < loss:
                again += 0.2 + trip
            self._free += each
            latest = max(latest, again)
        return latest


def draw_time(scale: float) -> float:
    """Return the seconds of drawing a pair at ``scale``."""
    return DRAW * (0.18 + 0.82 * scale**2)
