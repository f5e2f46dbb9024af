"""LinkEstimator: rate, round trip and queue of the link to a client. No I/O: times are arguments.

The model is BBR's (Cardwell, Cheng, Gunn, Yeganeh, Jacobson: BBR, Congestion-Based Congestion Control, ACM Queue 14(5),
2016): a windowed maximum of the delivery rate and a windowed minimum of the round trip. It suits TCP, where a lost
packet delays a picture: late pictures do not change a maximum, while a gradient of delays (GCC) takes each for
congestion. Pings replace BBR's ProbeRTT, since a picture's own round trip includes the time of its bytes.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import inf, isfinite

RATE_WINDOW, ROUNDS = 1.0, 10
"""Window of the best rate: the longer of these seconds and round trips."""
BASE_WINDOW = 10.0
"""Window of the shortest round trip, seconds."""

_FEWEST, _MOST = 5, 64  # deliveries kept at least, whatever their age, and at most
_CHAIN = 8  # deliveries that may arrive in one burst: a delayed picture releases those behind it
_BEST = 0.9  # quantile of the rates that counts as their maximum: a single rate may be luck, or a lie
_FALL = 0.6  # of the rate: several deliveries in a row below it mean a slower link
_FALLEN, _FELL, _FELL_ROUNDS = 3, 0.25, 2.0  # slow deliveries, seconds, round trips: more than one lost packet causes
_STANDING = 0.5  # window of the standing queueing delay, seconds (Copa's RTTstanding)
_INSTANT = 1e-4  # shortest time that is measured, seconds
_SUBJECTS = 64  # remembered pictures and pings under way


@dataclass(frozen=True, slots=True)
class Delivered:
    """An acknowledged picture. Times in seconds."""

    written: float
    arrived: float  # when its acknowledgement would have come, had it been sent at once
    nbytes: int


class LinkEstimator:
    """Estimates a link from the times at which pictures and pings are written and acknowledged.

    A client's delay (``held``) is limited by what the server measures: a false one affects that client alone.
    """

    def __init__(self) -> None:
        self.newest: Delivered | None = None
        self._way: dict[int, tuple[float, int]] = {}  # by picture: time written, bytes
        self._pings: dict[bytes, float] = {}
        self._delivered: deque[Delivered] = deque(maxlen=_CHAIN)
        self._rates: deque[tuple[float, float]] = deque(maxlen=_MOST)  # time, bits a second
        self._trips: deque[tuple[float, float]] = deque()  # time, seconds; rising, so that the first is the least
        self._delays: deque[tuple[float, float]] = deque(maxlen=_MOST)  # time, seconds beyond base and own bytes
        self._slow: list[float] = []  # times of successive deliveries far below the rate
        self._ponged = False

    # ----------------------------------------------------------------------------------------------------------- events

    def written(self, number: int, nbytes: int, now: float) -> None:
        """Record a picture written to the socket. Numbers grow."""
        self._way[number] = now, nbytes
        while len(self._way) > _SUBJECTS:
            del self._way[next(iter(self._way))]

    def pinged(self, ping: bytes, now: float) -> None:
        """Record a ping written to the socket."""
        self._pings[ping] = now
        while len(self._pings) > _SUBJECTS:
            del self._pings[next(iter(self._pings))]

    def ponged(self, ping: bytes, now: float) -> None:
        """Record the answer to a ping; ignore an unknown one."""
        asked = self._pings.pop(ping, None)
        if asked is not None:
            self._ponged = True
            self._trip(now - asked, now)

    def acknowledged(self, number: int, held: float, now: float) -> None:
        """Record that the picture and all before it arrived; the client reports it ``held`` seconds late."""
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
        """Remove a picture and all before it, without a time of arrival."""
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
        """Measure the newest delivery's rate: the least over deliveries that may have come in one burst with it."""
        base, sample, nbytes = self.base, inf, 0
        delivered = list(self._delivered)
        end = delivered[-1].arrived
        for index in range(len(delivered) - 1, -1, -1):
            one = delivered[index]
            nbytes += one.nbytes
            before = delivered[index - 1].arrived if index else -inf
            sample = min(sample, 8 * nbytes / max(end - max(one.written + base, before), _INSTANT))
            if before <= one.written + base:  # the link was empty before it
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

    # -------------------------------------------------------------------------------------------------------- estimates

    @property
    def known(self) -> bool:
        """Whether there is an estimated rate."""
        return bool(self._rates)

    @property
    def rate(self) -> float:
        """Estimated bits a second; infinite before the first measurement."""
        return self._rate() if self._rates else inf

    @property
    def base(self) -> float:
        """Round trip of a ping on an empty link, seconds."""
        return self._trips[0][1] if self._trips else 0.0

    @property
    def standing(self) -> float:
        """Standing queueing delay, seconds: the least wait of recent pictures beyond the time of their own bytes."""
        return min((delay for _, delay in self._delays), default=0.0)

    @property
    def on_the_way(self) -> int:
        """Number of pictures written and not acknowledged."""
        return len(self._way)

    def clear(self, now: float) -> float:
        """Return when all written pictures will have passed the link at the estimated rate; at least ``now``.

        An overdue acknowledgement of the first picture puts the time off by as much.
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
        """Return the seconds by which the first unacknowledged picture is late."""
        if not self._rates or not self._way:
            return 0.0
        written, nbytes = next(iter(self._way.values()))
        before = self._delivered[-1].arrived if self._delivered else -inf
        return max(0.0, now - max(written + self.base, before) - 8 * nbytes / self.rate)
