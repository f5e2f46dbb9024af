"""Make tables of simulated streams for ``python -m tools.docs.measured links``, without sockets, in seconds of CPU."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from statistics import median

from glsplat.extras.far_links.link_control import LinkControl
from tools.net.simulated_link import FULL, Fixed, Link, Oracle, Outcome, Policy, play

RATES = (20, 5, 2)  # Mbit/s
TRIPS = (20, 60, 150)  # ms
LOSSES = (0, 1, 3)  # percent
FALL = 20.0, 3.0, 20.0, 40.0  # Mbit/s before, and during a fall; its start and end, seconds after the warm-up


def goal(trip: float) -> float:
    """Return the goal for the 95th percentile of the age of the shown picture, ms; ``trip``: round trip in ms."""
    return 1.3 * (trip + 120)


def steady(rate: float, trip: float, loss: float = 0) -> Link:
    """Return a link of constant rate (Mbit/s), round trip (ms) and loss (percent)."""
    return Link(lambda now: rate, trip / 1e3, loss / 100)


def _cells(outcome: Outcome, rate: float) -> str:
    used = 8e-6 * outcome.nbytes / outcome.seconds / rate
    return (
        f"{outcome.shown / outcome.seconds:.1f} | {outcome.age(0.5) * 1e3:.0f} | {outcome.age(0.95) * 1e3:.0f} "
        f"| {used:.2f} | {median(outcome.losses):.3f}"
    )


def alone() -> Iterator[str]:
    """Yield the table of one client for 60 s: link control, and an oracle that knows the link."""
    names = "shown/s | age | 95 % | used | LPIPS"
    yield f"| Mbit/s | ms | loss | {names} | {names} | goal, ms | met by |"
    yield "|" + "--:|" * 14 + "---|"
    for loss, rate, trip in product(LOSSES, RATES, TRIPS):
        link = steady(rate, trip, loss)
        policies: dict[str, Policy] = {"server": LinkControl(), "oracle": Oracle(link)}
        found = {name: play(link, [policy])[0] for name, policy in policies.items()}
        met = [name for name, one in found.items() if one.age(0.95) * 1e3 <= goal(trip)]
        cells = " | ".join(_cells(one, rate) for one in found.values())
        yield f"| {rate} | {trip} | {loss} % | {cells} | {goal(trip):.0f} | {', '.join(met) or 'none'} |"


def falling() -> Iterator[str]:
    """Yield the table of a rate that falls and recovers: seconds for which ages miss the goal afterwards."""
    before, then, start, end = FALL
    yield "| ms | | beyond the goal after the fall, s | 95 % from 2 s on, ms | oldest, ms | after it came back, s |"
    yield "|--:|---|--:|--:|--:|--:|"
    for trip in TRIPS:
        # now includes the warm-up of 5 s
        link = Link(lambda now: then if start <= now - 5.0 < end else before, trip / 1e3)
        policies: dict[str, Policy] = {"fixed": Fixed(), "server": LinkControl(), "oracle": Oracle(link)}
        policies["server, datagrams"] = LinkControl()
        for name, policy in policies.items():
            outcome = play(link, [policy], datagrams="datagrams" in name)[0]
            late = [at for at, age in outcome.ages if age * 1e3 > goal(trip)]
            fallen = max((at - start for at in late if start <= at < end), default=0.0)
            back = max((at - end for at in late if at >= end), default=0.0)
            steady = outcome.age(0.95, start + 2, end) * 1e3
            oldest = max(age for _, age in outcome.ages) * 1e3
            yield f"| {trip} | {name} | {fallen:.1f} | {steady:.0f} | {oldest:.0f} | {back:.1f} |"


def shared() -> Iterator[str]:
    """Yield the table of two clients behind one bottleneck; the second starts at once, or 8 s after the first."""
    yield "| Mbit/s | ms | second after, s | parts of what is sent | of the rate | 95 %, ms | goal, ms |"
    yield "|--:|--:|--:|--:|--:|--:|--:|"
    for rate, trip, later in product(RATES, TRIPS, (0.0, 8.0)):
        both = play(steady(rate, trip), [LinkControl(), LinkControl()], starts=(0.0, later + 0.003))
        sent = sum(one.nbytes for one in both)
        parts = ", ".join(f"{one.nbytes / sent:.2f}" for one in both)
        late = ", ".join(f"{one.age(0.95) * 1e3:.0f}" for one in both)
        used = 8e-6 * sent / both[0].seconds / rate
        yield f"| {rate} | {trip} | {later:.0f} | {parts} | {used:.2f} | {late} | {goal(trip):.0f} |"


class Unanswered(LinkControl):
    """Link control without pings behind pictures: only the client reports arrivals."""

    def follow(self, number: int) -> bytes:
        return b""


def busy() -> Iterator[str]:
    """Yield the table of a client on a fast link that reads its socket only every ``every`` ms."""
    yield "| the client looks every, ms | arrivals from | as asked for | LPIPS | shown/s |"
    yield "|--:|---|--:|--:|--:|"
    for every in (0, 100, 150, 300, 400):
        for name, policy in (("the client", Unanswered()), ("pings", LinkControl())):
            outcome = play(steady(100, 1), [policy], busy=every / 1e3)[0]
            share, shown = outcome.full / outcome.arrived, outcome.shown / outcome.seconds
            yield f"| {every} | {name} | {share:.0%} | {median(outcome.losses):.3f} | {shown:.1f} |"


VIDEO = 6400
"""Bytes of a pair in VP9, as good as JPEG of quality 80 (docs/measured/codec.md, the held-out motion)."""


def video() -> Iterator[str]:
    """Yield the table of pictures of a tenth of the bytes; key frames and a ladder for video are not modelled."""
    yield "| Mbit/s | ms | loss | JPEG: shown/s | 95 % | LPIPS | video: shown/s | 95 % | LPIPS | goal, ms |"
    yield "|" + "--:|" * 10
    for rate, trip, loss in ((2, 20, 0), (2, 150, 0), (20, 60, 1), (5, 60, 1), (20, 150, 1), (5, 150, 1), (20, 150, 3)):
        cells = []
        for full in (FULL, VIDEO):
            one = play(steady(rate, trip, loss), [LinkControl()], full=full)[0]
            cells.append(f"{one.shown / one.seconds:.1f} | {one.age(0.95) * 1e3:.0f} | {median(one.losses):.3f}")
        yield f"| {rate} | {trip} | {loss} % | {' | '.join(cells)} | {goal(trip):.0f} |"


def datagrams() -> Iterator[str]:
    """Yield the table of pictures by datagrams and over TCP."""
    names = "shown/s | age | 95 % | LPIPS"
    yield f"| Mbit/s | ms | loss | {names} | {names} | goal, ms | met by |"
    yield "|" + "--:|" * 12 + "---|"
    for loss, rate, trip in product(LOSSES, RATES, TRIPS):
        cells, met = [], []
        for name in ("TCP", "datagrams"):
            one = play(steady(rate, trip, loss), [LinkControl()], datagrams=name == "datagrams")[0]
            late, seen = one.age(0.95) * 1e3, median(one.losses)
            cells.append(f"{one.shown / one.seconds:.1f} | {one.age(0.5) * 1e3:.0f} | {late:.0f} | {seen:.3f}")
            met += [name] * (late <= goal(trip))
        by = ", ".join(met) or "none"
        yield f"| {rate} | {trip} | {loss} % | {' | '.join(cells)} | {goal(trip):.0f} | {by} |"
