"""LinkEstimator: how fast the way to a client is, how long, and how much waits on it. No I/O: times are arguments.

The model is BBR's (Cardwell, Cheng, Gunn, Yeganeh, Jacobson: BBR, Congestion-Based Congestion Control, ACM Queue 14(5),
2016): a windowed maximum of the rate at which data is delivered, and a windowed minimum of the round trip. It fits what
a connection over TCP can tell, where a lost packet is a picture that comes late: a maximum does not mind those that are
late, while a gradient of delays (GCC) takes each for congestion. Round trips of small messages in between (pings) take
the place of BBR's ProbeRTT, since a picture's own round trip holds the time that its bytes take.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import inf, isfinite

RATE_WINDOW, ROUNDS = 1.0, 10
"""Seconds, and round trips, of which the best rate counts: the longer of both."""
BASE_WINDOW = 10.0
"""Seconds of which the shortest round trip counts."""

_FEWEST, _MOST = 5, 64  # deliveries that count, however long they took
_CHAIN = 8  # deliveries that may have come in one lump: a picture that was held back releases those behind it
_BEST = 0.9  # quantile of the rates that counts as their maximum: one alone may be luck, or a lie
_FALL = 0.6  # of the rate: a chain of so much less in a row is no bad luck, but another link
_FALLEN, _FELL, _FELL_ROUNDS = 3, 0.25, 2.0  # in a row, for seconds and round trips: longer than one lost packet takes
_STANDING = 0.5  # seconds of which the least queueing delay is what stands (Copa's RTTstanding)
_INSTANT = 1e-4  # seconds below which nothing is measured
_SUBJECTS = 64  # pictures and pings under way that are remembered


@dataclass(frozen=True, slots=True)
class Delivered:
    """A picture that was acknowledged. Seconds."""

    written: float
    arrived: float  # when its acknowledgement would have been here, had it been sent at once
    nbytes: int


class LinkEstimator:
    """Tell it what is ``written`` and what is ``acknowledged``, of pictures and of pings.

    What a client says of itself (``held``) is taken within what the server measures, so that a liar makes his own link
    look faster or slower than it is, and no other's.
    """

    def __init__(self) -> None:
        self.newest: Delivered | None = None
        self._way: dict[int, tuple[float, int]] = {}  # by number: when it was written, bytes
        self._pings: dict[bytes, float] = {}
        self._delivered: deque[Delivered] = deque(maxlen=_CHAIN)
        self._rates: deque[tuple[float, float]] = deque(maxlen=_MOST)  # when, bits a second
        self._trips: deque[tuple[float, float]] = deque()  # when, seconds; rising, so that the first is the least
        self._delays: deque[tuple[float, float]] = deque(maxlen=_MOST)  # when, seconds beyond base and own bytes
        self._slow: list[float] = []  # when deliveries were far below the rate, in a row
        self._ponged = False

    # ----------------------------------------------------------------------------------------------------- what happens

    def written(self, number: int, nbytes: int, now: float) -> None:
        """A picture is given to the socket. Numbers grow."""
        self._way[number] = now, nbytes
        while len(self._way) > _SUBJECTS:
            del self._way[next(iter(self._way))]

    def pinged(self, ping: bytes, now: float) -> None:
        """A small message is given to the socket, which the other end answers by itself."""
        self._pings[ping] = now
        while len(self._pings) > _SUBJECTS:
            del self._pings[next(iter(self._pings))]

    def ponged(self, ping: bytes, now: float) -> None:
        """Its answer is here. One that was never asked for says nothing."""
        asked = self._pings.pop(ping, None)
        if asked is not None:
            self._ponged = True
            self._trip(now - asked, now)

    def acknowledged(self, number: int, held: float, now: float) -> None:
        """The picture arrived, and with it all before; the client kept the news for ``held`` seconds, it says."""
        entry = self._way.get(number)
        self.forget(number)
        if entry is None:
            return
        written, nbytes = entry
        before = self._delivered[-1].arrived if self._delivered else -inf
        held = held if isfinite(held) and held > 0 else 0.0
        arrived = max(now - held, written + self.base if self._ponged else written, before)
        self.newest = Delivered(written, min(arrived, now), nbytes)
        self._delivered.append(self.newest)
        if self._ponged:
            self._measure(now)

    def forget(self, number: int) -> None:
        """A picture and all before it are no longer on the way; nobody says when they arrived."""
        for old in [old for old in self._way if old <= number]:
            del self._way[old]

    def _trip(self, seconds: float, now: float) -> None:
        seconds = max(seconds, _INSTANT)
        while self._trips and self._trips[-1][1] >= seconds:
            self._trips.pop()
        self._trips.append((now, seconds))
        while len(self._trips) > 1 and now - self._trips[0][0] > BASE_WINDOW:
            self._trips.popleft()

    def _measure(self, now: float) -> None:
        """The rate of the newest delivery: the least over those that it may have come in one lump with."""
        base, sample, nbytes = self.base, inf, 0
        delivered = list(self._delivered)
        end = delivered[-1].arrived
        for index in range(len(delivered) - 1, -1, -1):
            one = delivered[index]
            nbytes += one.nbytes
            before = delivered[index - 1].arrived if index else -inf
            sample = min(sample, 8 * nbytes / max(end - max(one.written + base, before), _INSTANT))
            if before <= one.written + base:  # the way was empty: what was before has nothing to do with it
                break
        self._slow = [*self._slow[-_MOST:], now] if self._rates and sample < _FALL * self._rate() else []
        if len(self._slow) >= _FALLEN and now - self._slow[0] > max(_FELL, _FELL_ROUNDS * base):
            self._rates = deque([entry for entry in self._rates if entry[0] >= self._slow[0]], _MOST)
            self._slow = []
        self._rates.append((now, sample))
        window = max(RATE_WINDOW, ROUNDS * base)
        while len(self._rates) > _FEWEST and now - self._rates[0][0] > window:
            self._rates.popleft()
        newest = delivered[-1]
        own = 8 * newest.nbytes / self._rate()
        self._delays.append((now, max(0.0, newest.arrived - newest.written - base - own)))
        while len(self._delays) > _FEWEST and now - self._delays[0][0] > _STANDING:
            self._delays.popleft()

    def _rate(self) -> float:
        ranked = sorted(rate for _, rate in self._rates)
        return ranked[min(len(ranked) - 1, int(_BEST * len(ranked)))]

    # -------------------------------------------------------------------------------------------------- what that means

    @property
    def known(self) -> bool:
        """Whether there is a rate at all."""
        return bool(self._rates)

    @property
    def rate(self) -> float:
        """Bits a second that arrive when there is enough to send; infinite before anything is known."""
        return self._rate() if self._rates else inf

    @property
    def base(self) -> float:
        """Seconds there and back of next to nothing, with nothing before it."""
        return self._trips[0][1] if self._trips else 0.0

    @property
    def standing(self) -> float:
        """Seconds that every picture lately had to wait on the way, beyond the time of its own bytes."""
        return min((delay for _, delay in self._delays), default=0.0)

    @property
    def on_the_way(self) -> int:
        """Pictures that were written and not acknowledged."""
        return len(self._way)

    def clear(self, now: float) -> float:
        """The time at which all that was written has passed, if it passes at the known rate; ``now`` at least.

        Once the first of it should have been acknowledged and is not, that is put off: nobody knows how long it takes.
        """
        if not self._rates or not self._way:
            return now
        passed = self._delivered[-1].arrived - self.base if self._delivered else -inf
        put_off = 0.0
        for written, nbytes in self._way.values():
            passed = max(passed, written) + 8 * nbytes / self.rate
            put_off = put_off or max(0.0, now - passed - self.base)
        return max(now, passed + put_off)

    def overdue(self, now: float) -> float:
        """Seconds by which the first picture on the way is late."""
        if not self._rates or not self._way:
            return 0.0
        written, nbytes = next(iter(self._way.values()))
        before = self._delivered[-1].arrived if self._delivered else -inf
        return max(0.0, now - max(written + self.base, before) - 8 * nbytes / self.rate)
