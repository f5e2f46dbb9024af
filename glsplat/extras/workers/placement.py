"""Assigns clients to workers. No I/O, no clock.

The load of a worker is the time in which each of its clients gets one picture: the sum of their pictures' times, over
its share of a GPU. Clients of one room stay together. Others go where their avatar is loaded already, as long as that
worker is quick enough, or not much slower than the quickest one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

__all__ = ["PlacedClient", "PlacedWorker", "better", "choose"]

QUICK = 1 / 90
"""Seconds: a worker with a smaller load is quick enough."""

MUCH = 1.5
"""Times as slow as the quickest worker: then the avatar is loaded there instead."""

_GAIN = 0.8  # of the slower worker's load: at most that has to be left after a move
_UNKNOWN_S = 0.02  # time of a picture where none was drawn yet


@dataclass(frozen=True, slots=True)
class PlacedClient:
    """A client, for placement."""

    number: int
    key: str  # "avatar:NAME", or of clients that stay together, such as "room:NAME"
    cost: float = 0.0  # seconds a picture; 0: not known

    @property
    def together(self) -> bool:
        """Whether all clients with its key have to be on one worker."""
        return not self.key.startswith("avatar:")


@dataclass(frozen=True, slots=True)
class PlacedWorker:
    """A worker, for placement."""

    clients: tuple[PlacedClient, ...] = ()
    has: frozenset[str] = frozenset()  # keys of the avatars that it has loaded
    share: float = 1.0  # of a GPU, or any measure of its speed


def choose(client: PlacedClient, workers: Sequence[PlacedWorker]) -> int | None:
    """Return the index of the worker for a client; None where there are none."""
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
    """Return the best move: the numbers of clients that stay together, and the index of their worker; None: no gain."""
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
    return sum(known) / len(known) if known else _UNKNOWN_S
