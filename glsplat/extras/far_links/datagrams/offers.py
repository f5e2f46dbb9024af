"""Secrets that tie a datagram path to a client: each is valid once, for seconds. No I/O."""

from __future__ import annotations

import secrets
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

LASTS = 10.0
"""Seconds for which a secret is valid."""

_KNOCKS = 48  # packets of unknown connections parsed for each offer: a client needs 2 to 4, and repeats lost ones

T = TypeVar("T")


@dataclass(slots=True)
class _Offer(Generic[T]):
    address: str
    until: float
    whose: T
    knocks: int = _KNOCKS


class Offers(Generic[T]):
    """Open offers, one for each client: a new one replaces the old."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._open: dict[str, _Offer[T]] = {}  # by secret

    def make(self, address: str, whose: T) -> str:
        """Return a new secret for a client of that address (``address_key``)."""
        self.withdraw(whose)
        secret = secrets.token_urlsafe(24)
        self._open[secret] = _Offer(address, self._clock() + LASTS, whose)
        return secret

    def take(self, secret: str, address: str) -> T | None:
        """Return a secret's owner, once; None if the secret is unknown, used, expired or of another address."""
        self._expire()
        offer = self._open.get(secret)
        if offer is None or offer.address != address:
            return None
        del self._open[secret]
        return offer.whose

    def withdraw(self, whose: T) -> None:
        """Remove a client's offer."""
        self._open = {secret: offer for secret, offer in self._open.items() if offer.whose is not whose}

    def open(self) -> bool:
        """Return whether there is an open offer."""
        self._expire()
        return bool(self._open)

    def knock(self, address: str) -> bool:
        """Return whether to parse a packet of an unknown connection: few for each offer, as addresses can be forged."""
        now = self._clock()
        for offer in self._open.values():
            if offer.address == address and offer.until > now and offer.knocks > 0:
                offer.knocks -= 1
                return True
        return False

    def _expire(self) -> None:
        now = self._clock()
        self._open = {secret: offer for secret, offer in self._open.items() if offer.until > now}
