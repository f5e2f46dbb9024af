"""LinkControl: when a client's next picture starts, and its size and quality for the link. No I/O, no clock.

The spent rate rises and falls as in TCP (additive increase, multiplicative decrease: Chiu and Jain, 1989), below the
estimated rate: so two clients of one link reach equal shares, which BBR's model alone does not achieve.
AdaptiveQuality limits the time of drawing. The smaller of both sizes is drawn.
"""

from __future__ import annotations

import os
from collections import deque
from math import inf, isfinite
from statistics import median

from glsplat.extras.far_links.link import LinkEstimator
from glsplat.net.pace.ladder import MAX_SMOOTH_LPIPS, REDUCED_FPS, Rung, ladder, visible_loss

USE = 0.93
"""Most of the link's rate that is spent; the rest drains the queue."""
AHEAD = 0.5
"""Part of a picture that may still be queued on the link when the next is written; then one and a half are."""

_GENTLE, _QUICK = 0.04, 0.7  # rise of the spent rate a second, of the link's rate: soon after a cut, and later
_SOON = 3.0  # seconds after a cut
_CUT, _PAUSE = 0.85, 0.4  # factor of a cut; seconds between cuts, or two round trips
_QUEUE, _QUEUED = 0.008, 0.3  # standing delay that causes a cut: the longer of seconds and parts of a picture's time
_BESIDE = 2  # pictures under way up to which full quality starts whatever the link
_SPARE = 1.0  # pictures under way beyond those that the link holds
_LATE, _TRIPS = 0.02, 1.25  # seconds plus round trips by which a picture is overdue; one lost packet takes less
_AGAIN = 0.05  # seconds until the next check while a picture is overdue
_LEARN = 0.15  # weight of a new picture in running means
_EXCESS, _GAIN = 1.05, 1.04  # bytes over the budget that lower the rung at once; least factor of bytes of a better rung
_HOLD, _LONGEST, _EARLY = 1.0, 30.0, 5.0  # seconds before a better rung: first, longest; it failed if lost this early
_PINGS, _OFTEN, _RARE = 4, 0.25, 1.0  # number of first pings; seconds between them, and between later ones
_LATEST = 60.0  # longest time accepted from a client, seconds
_PAYLOAD = 8  # random bytes of a ping: its answer proves that the picture before it arrived
_FOLLOWED = 64  # pictures whose pings may still be answered


class LinkControl:
    """Controls one connection, whose client reports arrived pictures. ``cap``: most bits a second; None: no limit."""

    def __init__(self, cap: float | None = None) -> None:
        self.link: LinkEstimator = LinkEstimator()
        self._cap = inf if cap is None else cap
        self._spend = inf  # bits a second
        self._cut_at, self._updated = -inf, -inf
        self._begun: dict[int, float] = {}  # start times of the pictures in the making
        self._making = 0.0  # mean time of making one, seconds
        self._interval = 0.0  # mean seconds between pictures that the link does not hold back
        self._last, self._held = -inf, inf  # start of the last picture; since when the next is held back
        self._asked: dict[int, float] = {}  # by number: pixels of the whole picture, times the bits of its rung
        self._bytes = 0.0  # of a pixel in full quality
        self._rungs: tuple[Rung, ...] = ()
        self._index = 0
        self._least = 0.0  # seconds between pictures that give each enough bytes
        self._since, self._better, self._hold = -inf, -inf, _HOLD
        self._pings, self._pinged = 0, -inf
        self._behind: dict[bytes, int] = {}  # unanswered pings, and the picture before each
        self._ages: deque[float] = deque(maxlen=32)

    @property
    def known(self) -> bool:
        """Whether the link's rate and round trip are known."""
        return self.link.known

    # ----------------------------------------------------------------------------------------------------------- events

    def rung(self, number: int, pixels: int, quality: int, crop: bool, now: float) -> Rung:
        """Start a picture requested with ``pixels`` and JPEG ``quality``; return the rung to make it with."""
        self._begin(number, now)
        rungs = ladder(quality, crop)
        if rungs is not self._rungs:  # another request: the rung of as many bits as before
            bits = self._rungs[self._index].bits if self._rungs else 1.0
            self._rungs = rungs
            self._index = next((i for i, one in enumerate(rungs) if one.bits <= bits), len(rungs) - 1)
        self._choose(self._bytes * pixels, now)
        chosen = self._rungs[self._index]
        self._asked[number] = pixels * chosen.bits
        return chosen

    def written(self, number: int, nbytes: int, now: float) -> None:
        """Record a reply written to the socket."""
        began = self._begun.pop(number, None)
        if began is not None:
            self._making = _moved(self._making, now - began)
        asked = self._asked.pop(number, None)
        if asked:
            self._bytes = _moved(self._bytes, nbytes / asked)
        self.link.written(number, nbytes, now)

    def failed(self, number: int) -> None:
        """Remove a picture that could not be made."""
        self._begun.pop(number, None)
        self._asked.pop(number, None)

    def acknowledged(self, number: int, age: float, held: float, now: float) -> None:
        """Record a picture that arrived ``age`` seconds after its request and was reported ``held`` seconds later.

        Mostly the ping behind the picture was answered before; then this adds nothing to the link's estimate.
        """
        if isfinite(age):
            self._ages.append(min(max(age, 0.0), _LATEST))
        self._arrived(number, min(held, _LATEST), now)

    def _arrived(self, number: int, held: float, now: float) -> None:
        before = self.link.newest
        self.link.acknowledged(number, held, now)
        if self.link.known and self.link.newest is not before:
            self._adjust(now)

    def forget(self, number: int) -> None:
        """Expect no report of pictures up to ``number``."""
        self.link.forget(number)

    def lost(self, number: int, now: float) -> None:
        """Remove a picture that will not arrive, and cut the spent rate, as for a queue."""
        self.link.forget(number)
        self._cut(now)

    def ping(self, now: float) -> bytes | None:
        """Return the payload of a ping to send before a picture; None: no ping now."""
        if now - self._pinged < (_OFTEN if self._pings < _PINGS else _RARE):
            return None
        self._pings += 1
        self._pinged = now
        payload = os.urandom(_PAYLOAD)
        self.link.pinged(payload, now)
        return payload

    def follow(self, number: int) -> bytes:
        """Return the payload of a ping to send right behind a picture.

        A browser's network process answers it, so the answer dates the picture's arrival however busy the page is.
        The random payload cannot be answered earlier.
        """
        payload = os.urandom(_PAYLOAD)
        self._behind[payload] = number
        while len(self._behind) > _FOLLOWED:
            del self._behind[next(iter(self._behind))]
        return payload

    def ponged(self, payload: bytes, now: float) -> None:
        """Record the answer to a ping; ignore one that is not under way."""
        number = self._behind.get(payload)
        if number is None:
            self.link.ponged(payload, now)
            return
        for old in [old for old, of in self._behind.items() if of <= number]:  # RFC 6455, 5.5.3: the newest may do
            del self._behind[old]
        self._arrived(number, 0.0, now)

    def rest(self, now: float) -> float:
        """Return the seconds to wait before the next picture, so that at most ``AHEAD`` of one is queued before it."""
        wait = max(self._rest(now), self._last + self._least - now, 0.0)
        self._held = min(self._held, now) if wait > 0 else self._held
        return wait

    # -------------------------------------------------------------------------------------------------------- decisions

    @property
    def age(self) -> float | None:
        """Median of the ages that the client reported lately, seconds; None: no reports."""
        return median(self._ages) if self._ages else None

    @property
    def spend(self) -> float:
        """Most bits a second to send."""
        return min(self._spend, USE * self.link.rate, self._cap)

    def status(self) -> dict[str, float | None]:
        """Return the link's part of /stats: rates in Mbit/s; round trip, queue and age in ms; scale and quality."""

        def known(value: float, digits: int = 2) -> float | None:
            return round(value, digits) if isfinite(value) else None

        age, rung = self.age, self._rungs[self._index] if self._rungs else None
        return {
            "rate": known(self.link.rate / 1e6),
            "spend": known(self.spend / 1e6),
            "round_trip": known(self.link.base * 1e3, 1),
            "queue": known(self.link.standing * 1e3, 1),
            "age": None if age is None else known(age * 1e3, 1),
            "scale": None if rung is None else rung.scale,
            "quality": None if rung is None else rung.quality,
        }

    def _rest(self, now: float) -> float:
        """Return the seconds until the queue on the link is short enough."""
        link = self.link
        if not link.known or (self._index == 0 and link.on_the_way + len(self._begun) < _BESIDE):
            return 0.0
        if link.overdue(now) > _LATE + _TRIPS * link.base:
            return _AGAIN
        rate = min(link.rate, self._cap)
        own = 8 * self._bytes_of_one() / rate
        pace = max(self._interval, self._least)
        if pace > 0 and link.on_the_way + len(self._begun) > _SPARE + (link.base + own + self._making) / pace:
            return _AGAIN  # more than such a link holds: another delay
        free = link.clear(now)
        for began in self._begun.values():
            free = max(free, began + self._making) + own
        return max(0.0, free - AHEAD * own - self._making - now)

    def _bytes_of_one(self) -> float:
        newest = self.link.newest
        return newest.nbytes if newest is not None else 0.0

    def _begin(self, number: int, now: float) -> None:
        self._begun[number] = now
        spent = min(self._held, now) - self._last  # until it could have started
        if isfinite(spent):
            self._interval = _moved(self._interval, min(spent, _LATEST))
        self._last, self._held = now, inf

    def _adjust(self, now: float) -> None:
        """Lower the spent rate while a queue stands, else raise it."""
        link, rate = self.link, self.link.rate
        newest = link.newest
        assert newest is not None
        soon = now - self._cut_at < _SOON
        passed = min(max(0.0, now - self._updated), 0.5)
        self._updated = now
        if link.standing > max(_QUEUE, _QUEUED * 8 * newest.nbytes / rate):
            self._cut(now)
        else:
            self._spend = min(self._spend, USE * rate) + (_GENTLE if soon else _QUICK) * rate * passed
        self._spend = min(self._spend, USE * rate)

    def _cut(self, now: float) -> None:
        if self.link.known and now - self._cut_at > max(_PAUSE, 2 * self.link.base):
            self._spend = _CUT * self.spend
            self._cut_at = now

    def _choose(self, full: float, now: float) -> None:
        """Choose the best rung within the byte budget. A worse one is taken at once, a better one after a hold."""
        if full <= 0 or self._interval <= 0 or self.spend == inf:
            return
        wanted, self._least = self._fitting(full)
        bits, budget = self._rungs[self._index].bits, self.spend / 8 * max(self._interval, self._least)
        if full * bits > _EXCESS * budget:
            if now - self._better < _EARLY:
                self._hold = min(2 * self._hold, _LONGEST)
            self._better = -inf
        elif now - self._since < self._hold:
            return
        if wanted == self._index or (0 < wanted < self._index and self._rungs[wanted].bits < _GAIN * bits):
            return
        if wanted < self._index:
            if now - self._since > _EARLY:
                self._hold = max(_HOLD, self._hold / 2)
            self._better = now
        self._index, self._since = wanted, now

    def _fitting(self, full: float) -> tuple[int, float]:
        """Return the best rung for ``full`` bytes a picture, and the interval in seconds that it needs."""
        rungs, calm = self._rungs, max(self._interval, 1 / REDUCED_FPS)
        needs = [8 * full * one.bits / self.spend for one in rungs]
        good = [index for index, one in enumerate(rungs) if not index or visible_loss(one) <= MAX_SMOOTH_LPIPS]
        for index in good:
            if needs[index] <= self._interval:
                return index, 0.0
        worst = good[-1]
        if needs[worst] <= calm:
            return worst, needs[worst]
        for index in range(worst + 1, len(rungs)):
            if needs[index] <= calm:
                return index, calm
        return len(rungs) - 1, needs[-1]


def _moved(mean: float, value: float) -> float:
    """Return the running mean after ``value``; a mean of 0 is unset and becomes ``value``."""
    return mean + _LEARN * (value - mean) if mean else value
