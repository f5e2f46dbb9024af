"""Decide which avatars may be shown, and who may drive them; called for every picture. No I/O."""

from __future__ import annotations

import time
from collections.abc import Collection, Sequence

from glsplat.errors import GlsplatError
from glsplat.extras.consent.file import NONE, OnFile
from glsplat.extras.consent.keys import short


class ConsentPolicy:
    """Consents of a server's avatars, by name.

    ``trusted`` are the public keys (hexadecimal) of accepted signatures; None: any valid signature. ``without`` shows
    every avatar, with a ``label`` in the pictures of those without a valid consent.
    """

    def __init__(self, *, trusted: Collection[str] | None = None, without: bool = False) -> None:
        self.trusted: frozenset[str] | None = None if trusted is None else frozenset(trusted)
        self.without = without
        self._own: str | None = None
        self._people: dict[str, tuple[OnFile, ...]] = {}
        self._driven: dict[str, bool] = {}

    def trust_own(self, key: str) -> None:
        """Trust also the server's own key, which signs the avatars that clients make."""
        self._own = key

    def add(self, avatar: str, people: Sequence[OnFile], *, driven: bool = True) -> None:
        """Set the consents of all people that an avatar or scene shows; empty for scenery.

        ``driven`` is false for scenes that clients do not pose: their drivers are not checked.
        """
        self._people[avatar], self._driven[avatar] = tuple(people), driven

    def refusal(self, avatar: str, driver: str, now: float) -> str | None:
        """Return why ``avatar`` may not be shown to the account ``driver`` ("": none); None if it may.

        ``now`` is in seconds since 1970. Takes about a microsecond per person.
        """
        return None if self.without else self._refusal(avatar, driver, now)

    def lets(self, avatar: str, driver: str) -> bool:
        """Return whether the account may drive ``avatar``, regardless of signer and dates."""
        consents = [one.consent for one in self._people.get(avatar, ()) if one.consent is not None]
        return self.without or not self._driven.get(avatar) or all(one.lets(driver) for one in consents)

    def withheld(self, avatar: str, now: float) -> str | None:
        """Return why viewers may not receive the splats of ``avatar``; None if they may. Ignores ``without``."""
        if why := self._refusal(avatar, None, now):
            return why
        if not all(one.hands_out for one in self._people[avatar]):
            return f'"{avatar}": its consent is to be shown, not to hand out its splats'
        return None

    def label(self, avatar: str, driver: str = "", now: float | None = None) -> str:
        """Return the text for every picture of ``avatar``; "" for none."""
        if not self.without:
            return ""
        return NONE if self._refusal(avatar, driver, time.time() if now is None else now) else ""

    def check(self, avatar: str, now: float) -> None:
        """Raise GlsplatError if ``avatar`` may not be shown at all."""
        if not self.without and (why := self._refusal(avatar, None, now)):
            raise GlsplatError(
                f"{why}; sign one (glsplat avatar consent, or --mine of avatar photo), or serve it with "
                "without-consent = true, which says so in every picture"
            )

    def doubts(self, avatar: str, *, accounts: bool) -> list[str]:
        """Return warnings for the operator about the consents of ``avatar``, one line each."""
        lines = []
        for consent in [one.consent for one in self._people.get(avatar, ()) if one.consent is not None]:
            if self.trusted is None and consent.key != self._own:
                lines.append(
                    f'"{avatar}": its consent is signed by {short(consent.key)}, which nobody told this server to '
                    "trust (trust = KEY.pub)"
                )
            if self._driven[avatar] and not accounts and not consent.lets(""):
                lines.append(f'"{avatar}": its consent names who may drive it, and without --users nobody has a name')
        return lines

    def maker(self, avatar: str) -> str:
        """Return the account that ordered an avatar from this server; "" if another key signed it."""
        consents = [one.consent for one in self._people.get(avatar, ())]
        return next((c.given_by for c in consents if c is not None and c.key == self._own), "")

    def _refusal(self, avatar: str, driver: str | None, now: float) -> str | None:
        people = self._people.get(avatar)
        if people is None:
            return f'"{avatar}": {NONE}'
        for one in people:
            if one.nobody:
                continue
            if one.consent is None:
                return f'"{avatar}": {one.fault or NONE}'
            consent = one.consent
            if self.trusted is not None and consent.key not in self.trusted and consent.key != self._own:
                return f'"{avatar}": its consent is signed by {short(consent.key)}, which this server does not trust'
            if why := consent.reason_invalid(now):
                return f'"{avatar}": {why}'
            if driver is not None and self._driven[avatar] and not consent.lets(driver):
                return f'"{avatar}": its consent names who may drive it, and that is not you'
        return None
