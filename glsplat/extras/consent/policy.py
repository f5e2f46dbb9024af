"""Who of those that a server offers may be shown, and who may drive them, asked at every picture. No I/O."""

from __future__ import annotations

import time
from collections.abc import Collection, Sequence

from glsplat.errors import GlsplatError
from glsplat.extras.consent.file import NONE, OnFile
from glsplat.extras.consent.keys import short

__all__ = ["ConsentPolicy"]


class ConsentPolicy:
    """What is on file for each avatar of a server, by the name that clients choose it by.

    ``trusted`` are the public keys (hexadecimal digits) whose signatures count; None: everybody's, as long as they fit.
    ``without``: everything is shown, and ``label`` says in its pictures what has no consent that holds.
    """

    def __init__(self, *, trusted: Collection[str] | None = None, without: bool = False) -> None:
        self.trusted: frozenset[str] | None = None if trusted is None else frozenset(trusted)
        self.without = without
        self._own: str | None = None
        self._people: dict[str, tuple[OnFile, ...]] = {}
        self._driven: dict[str, bool] = {}

    def trust_own(self, key: str) -> None:
        """Trust the server's own key as well: what clients have made here is signed with it."""
        self._own = key

    def add(self, avatar: str, people: Sequence[OnFile], *, driven: bool = True) -> None:
        """``people`` are all that the avatar, or the scene of that name, shows; none for scenery.

        ``driven`` is false for scenes in which clients pose nobody: then the drivers are not asked for.
        """
        self._people[avatar], self._driven[avatar] = tuple(people), driven

    def refusal(self, avatar: str, driver: str, now: float) -> str | None:
        """Why ``avatar`` may not be shown to the account ``driver`` ("": without one) at ``now``; None where it may.

        ``now`` is in seconds since 1970. Takes about a microsecond a person.
        """
        return None if self.without else self._refusal(avatar, driver, now)

    def lets(self, avatar: str, driver: str) -> bool:
        """Whether the records of ``avatar`` let the account ``driver`` drive it, whoever signed them and until when."""
        consents = [one.consent for one in self._people.get(avatar, ()) if one.consent is not None]
        return self.without or not self._driven.get(avatar) or all(one.lets(driver) for one in consents)

    def withheld(self, avatar: str, now: float) -> str | None:
        """Why the splats of ``avatar`` may not be given to those who are shown it; None where they may.

        That is a right of its own, which ``without`` does not give.
        """
        if why := self._refusal(avatar, None, now):
            return why
        if not all(one.hands_out for one in self._people[avatar]):
            return f'"{avatar}": its consent is to be shown, not to hand out its splats'
        return None

    def label(self, avatar: str, driver: str = "", now: float | None = None) -> str:
        """What has to stand in every picture of ``avatar``; "" for nothing."""
        if not self.without:
            return ""
        return NONE if self._refusal(avatar, driver, time.time() if now is None else now) else ""

    def check(self, avatar: str, now: float) -> None:
        """Raises GlsplatError in one line where nobody may be shown ``avatar``, whoever drives."""
        if not self.without and (why := self._refusal(avatar, None, now)):
            raise GlsplatError(
                f"{why}; sign one (glsplat avatar consent), or serve it with without-consent = true, which says so in "
                "every picture"
            )

    def doubts(self, avatar: str, *, accounts: bool) -> list[str]:
        """What an operator should know of the records of ``avatar``, a line each."""
        said = []
        for consent in [one.consent for one in self._people.get(avatar, ()) if one.consent is not None]:
            if self.trusted is None and consent.key != self._own:
                said.append(
                    f'"{avatar}": its consent is signed by {short(consent.key)}, which nobody told this server to '
                    "trust (trust = KEY.pub)"
                )
            if self._driven[avatar] and not accounts and not consent.lets(""):
                said.append(f'"{avatar}": its consent names who may drive it, and without --users nobody has a name')
        return said

    def maker(self, avatar: str) -> str:
        """The account that had it made here, by the record that this server signed; "" where there is none."""
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
            if why := consent.late(now):
                return f'"{avatar}": {why}'
            if driver is not None and self._driven[avatar] and not consent.lets(driver):
                return f'"{avatar}": its consent names who may drive it, and that is not you'
        return None
