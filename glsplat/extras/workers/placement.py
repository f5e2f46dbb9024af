"""Assigns clients to workers. No I/O, no clock.

A worker's load is the sum of its clients' picture times. Clients of one room stay together. Others go where their
avatar is loaded already, if that worker is fast enough or not much slower than the fastest one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

QUICK = 1 / 90
"""Seconds; a worker with a smaller load is fast enough."""

MUCH = 1.5
"""Largest load relative to the fastest worker's; beyond it the avatar is loaded there instead."""

_GAIN = 0.8  # largest load after a move, relative to the slower worker's before
_UNKNOWN_S = 0.02  # picture time before the first picture


@dataclass(frozen=True, slots=True)
class PlacedClient:
    """A client as placement sees it."""

    number: int
    key: str  # "avatar:NAME", or a key of clients that stay together, such as "room:NAME"
    cost: float = 0.0  # seconds per picture; 0: unknown

    @property
    def together(self) -> bool:
        """Whether all clients with this key have to share a worker."""
        return not self.key.startswith("avatar:")


@dataclass(frozen=True, slots=True)
class PlacedWorker:
    """A worker as placement sees it."""

    clients: tuple[PlacedClient, ...] = ()
    loaded: frozenset[str] = frozenset()  # keys of its loaded avatars


def choose(client: PlacedClient, workers: Sequence[PlacedWorker]) -> int | None:
    """Return the index of the worker for a client; None without workers."""
    if not workers:
        return None
    if client.together:
        for index, worker in enumerate(workers):
            if any(other.key == client.key for other in worker.clients):
                return index
    typical = _typical(workers)
    loads = [_load(worker, typical, (client,)) for worker in workers]
    least = min(range(len(workers)), key=lambda index: (loads[index], client.key not in workers[index].loaded))
    ready = [index for index, worker in enumerate(workers) if client.key in worker.loaded]
    best = min(ready, key=lambda index: loads[index], default=least)
    return best if loads[best] <= max(QUICK, MUCH * loads[least]) else least


def better(workers: Sequence[PlacedWorker]) -> tuple[tuple[int, ...], int] | None:
    """Return the best move, numbers of clients that stay together and the index of their new worker, or None."""
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
        left = PlacedWorker(tuple(one for one in workers[slow].clients if one not in group))
        after = max(_load(left, typical), _load(workers[quick], typical, group))
        if after < best:
            best, found = after, (tuple(one.number for one in group), quick)
    return found


def _load(worker: PlacedWorker, typical: float, more: Sequence[PlacedClient] = ()) -> float:
    return sum(one.cost or typical for one in (*worker.clients, *more))


def _typical(workers: Sequence[PlacedWorker]) -> float:
    known = [one.cost for worker in workers for one in worker.clients if one.cost]
    return sum(known) / len(known) if known else _UNKNOWN_S
