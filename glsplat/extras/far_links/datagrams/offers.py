"""Secrets that tie a client's second way to its first: each is for one use, and for seconds. No I/O, no clock."""

from __future__ import annotations

import secrets
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

LASTS = 10.0
"""Seconds for which a secret is good."""

_KNOCKS = 48  # packets of connections that are not there yet, for each offer: a client needs 2 to 4, and lost ones anew

T = TypeVar("T")


@dataclass(slots=True)
class _Offer(Generic[T]):
    address: str
    until: float
    whose: T
    knocks: int = _KNOCKS


class Offers(Generic[T]):
    """One offer a client at most: a later one takes the place of the one before."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._open: dict[str, _Offer[T]] = {}  # by secret

    def make(self, address: str, whose: T) -> str:
        """A secret for a client of that address (``address_key``)."""
        self.withdraw(whose)
        secret = secrets.token_urlsafe(24)
        self._open[secret] = _Offer(address, self._clock() + LASTS, whose)
        return secret

    def take(self, secret: str, address: str) -> T | None:
        """Whose it is; None where it is nobody's, was taken, is too old, or was given to another address."""
        self._expire()
        offer = self._open.get(secret)
        if offer is None or offer.address != address:
            return None
        del self._open[secret]
        return offer.whose

    def withdraw(self, whose: T) -> None:
        """The client has left."""
        self._open = {secret: offer for secret, offer in self._open.items() if offer.whose is not whose}

    def open(self) -> bool:
        """Whether anybody may come now."""
        self._expire()
        return bool(self._open)

    def knock(self, address: str) -> bool:
        """Whether a packet of an unknown connection from that address may be looked at: few are, for each offer.

        Addresses are easily made up, and what a packet seems to be costs time to find out.
        """
        now = self._clock()
        for offer in self._open.values():
            if offer.address == address and offer.until > now and offer.knocks > 0:
                offer.knocks -= 1
                return True
        return False

    def _expire(self) -> None:
        now = self._clock()
        self._open = {secret: offer for secret, offer in self._open.items() if offer.until > now}
