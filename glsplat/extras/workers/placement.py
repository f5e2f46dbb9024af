"""Which worker draws for whom. Only reckoning: no I/O, no clock.

A worker's load is the time in which everybody on it gets one picture: the sum of what its clients' pictures take, over
its share of a GPU. Clients of one room stay together. Others go where their avatar lies already, as long as that
worker is quick enough, or not much slower than the quickest would be.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

__all__ = ["PlacedClient", "PlacedWorker", "better", "choose"]

QUICK = 1 / 90
"""Seconds: a worker whose clients all get their picture within that is not looked at for load."""

MUCH = 1.5
"""Times as slow as the quickest: then an avatar is loaded there rather."""

_GAIN = 0.8  # what a move has to bring the slower of two workers down to
_UNKNOWN = 0.02  # seconds of a picture where none was drawn yet


@dataclass(frozen=True, slots=True)
class PlacedClient:
    """One that is drawn for."""

    number: int
    key: str  # "avatar:NAME" or anything that is to stay together, such as "room:NAME"
    cost: float = 0.0  # seconds a picture; 0: not known

    @property
    def together(self) -> bool:
        """Whether all of its key have to be on one worker."""
        return not self.key.startswith("avatar:")


@dataclass(frozen=True, slots=True)
class PlacedWorker:
    """One that draws."""

    clients: tuple[PlacedClient, ...] = ()
    has: frozenset[str] = frozenset()  # keys of what it has loaded
    share: float = 1.0  # of a GPU, or any measure of its speed


def choose(client: PlacedClient, workers: Sequence[PlacedWorker]) -> int | None:
    """The place in ``workers`` of the one that is to draw for ``client``; None where there are none."""
    if not workers:
        return None
    if client.together:
        for index, worker in enumerate(workers):
            if any(other.key == client.key for other in worker.clients):
                return index
    typical = _typical(workers)
    loads = [_load(worker, typical, (client,)) for worker in workers]
    least = min(range(len(workers)), key=lambda index: (loads[index], client.key not in workers[index].has))
    ready = [index for index, worker in enumerate(workers) if client.key in worker.has]
    best = min(ready, key=lambda index: loads[index], default=least)
    return best if loads[best] <= max(QUICK, MUCH * loads[least]) else least


def better(workers: Sequence[PlacedWorker]) -> tuple[tuple[int, ...], int] | None:
    """The move that helps most: the numbers of clients that belong together, and where to; None where none helps."""
    typical = _typical(workers)
    loads = [_load(worker, typical) for worker in workers]
    if len(workers) < 2:
        return None
    slow = max(range(len(workers)), key=loads.__getitem__)
    quick = min(range(len(workers)), key=loads.__getitem__)
    if loads[slow] <= QUICK:
        return None
    groups: dict[str | int, list[PlacedClient]] = {}
    for client in workers[slow].clients:
        groups.setdefault(client.key if client.together else client.number, []).append(client)
    best, found = _GAIN * loads[slow], None
    for group in groups.values():
        left = PlacedWorker(tuple(one for one in workers[slow].clients if one not in group), share=workers[slow].share)
        after = max(_load(left, typical), _load(workers[quick], typical, group))
        if after < best:
            best, found = after, (tuple(one.number for one in group), quick)
    return found


def _load(worker: PlacedWorker, typical: float, more: Sequence[PlacedClient] = ()) -> float:
    return sum(one.cost or typical for one in (*worker.clients, *more)) / worker.share


def _typical(workers: Sequence[PlacedWorker]) -> float:
    known = [one.cost for worker in workers for one in worker.clients if one.cost]
    return sum(known) / len(known) if known else _UNKNOWN
