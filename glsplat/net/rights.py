"""Who may see, drive and delete what: accounts' lists, consent and privacy, checked at every request."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Literal, Protocol

from aiohttp import web

__all__ = ["USER", "Accounts", "Consent", "Rights", "Thing", "User", "user_of"]

USER: web.RequestKey[Any] = web.RequestKey("user", object)
"""Of a request: the account whose token came with it."""

Thing = Literal["avatar", "room", "people", "client", "identity", "job"]
"""What ``Rights.sees`` decides on: an avatar (name, picture, splats); a room; the names of the people in a room; a
connection's figures; its identity (avatar, room, last picture, session in the watermark); a job that makes an avatar.
"""


class User(Protocol):
    """One account (extras/accounts)."""

    @property
    def name(self) -> str:
        """The account's name."""
        ...

    def may_drive(self, avatar: str) -> bool:
        """Return whether the account may be shown, and drive, the avatar of that name."""
        ...

    def may_enter(self, room: str) -> bool:
        """Return whether the account may enter the room of that name."""
        ...


class Accounts(Protocol):
    """The accounts of a running server (extras/accounts)."""

    def known(self, token: str) -> User | None:
        """Return whose token it is, if it was verified before."""
        ...

    async def verified(self, token: str) -> User | None:
        """Return whose token it is, by its hash; None: nobody's."""
        ...

    def holds(self, user: Any) -> bool:
        """Return False once the account was removed, or its token or rights were changed."""
        ...


class Consent(Protocol):
    """Who agreed to be shown, to whom and how (extras/consent)."""

    def refusal(self, avatar: str, driver: str, now: float) -> str | None:
        """Return why the avatar may not be shown to that account now; None while it may."""
        ...

    def lets(self, avatar: str, driver: str) -> bool:
        """Return whether the account is among those who may drive the avatar."""
        ...

    def withheld(self, avatar: str, now: float) -> str | None:
        """Return why the avatar's splats are not given away; None where they are."""
        ...

    def label(self, avatar: str, driver: str = "") -> str:
        """Return what has to stand in every picture of the avatar; "" for nothing."""
        ...

    def maker(self, avatar: str) -> str:
        """Return the account that had the avatar made; "" where none did."""
        ...


@dataclass(frozen=True, slots=True)
class Rights:
    """The rights on one server. None: it has no accounts, or no consent is checked.

    The user None is everybody on a server without accounts, and nobody on a server with them.
    """

    accounts: Accounts | None = None
    consent: Consent | None = None
    private: bool = False  # without accounts: nobody sees the identity of a client, nor who is in a room
    unseen: str = ""  # said instead of why an avatar may not be shown, where nobody may hear its name

    def sees(self, user: User | None, thing: Thing, of: str) -> bool:
        """Whether ``user`` may see a ``thing``. Every endpoint that speaks of others asks this.

        ``of`` is the name of the avatar or of the room; for a client, an identity or a job the account it belongs to.
        An avatar whose consent names other drivers is not seen, as if it were not there. Takes microseconds.
        """
        if user is None:
            return self.accounts is None and not (self.private and thing in ("people", "identity"))
        if thing == "avatar":
            return self._may_drive(user, of) and (self.consent is None or self.consent.lets(of, user.name))
        if thing == "room":
            return user.may_enter(of)
        return thing != "people" and user.name == of  # whoever is in the room hears who else is, and is seen

    def may_delete(self, user: User | None, avatar: str) -> bool:
        """Where it is known who had an avatar made, nobody else may."""
        if user is None:
            return self.accounts is None
        return (self._maker(avatar) or user.name) == user.name and self._may_drive(user, avatar)

    def drivable(self, user: User | None, avatars: Iterable[str]) -> tuple[str, ...]:
        """Those of ``avatars`` that the account may be shown now, in their order."""
        return tuple(name for name in avatars if not self.refusal(user, name))

    def refusal(self, user: User | None, avatar: str) -> str:
        """Why ``avatar`` may not be shown to the account now; "" while it may. Takes microseconds."""
        why = self._refusal(user, avatar)
        return (self.unseen or why) if why else ""

    def withheld(self, avatar: str) -> str:
        """Why the splats of ``avatar`` are not given to those who are shown it; "" where they are. Microseconds."""
        if self.consent is None:
            return "this server hands out no splats"
        return self.consent.withheld(avatar, time.time()) or ""

    def label(self, user: User | None, avatar: str) -> str:
        """What has to stand in every picture of ``avatar``; "" for nothing."""
        return "" if self.consent is None else self.consent.label(avatar, "" if user is None else user.name)

    def enterable(self, user: User | None, rooms: Iterable[str]) -> tuple[str, ...]:
        """Those of ``rooms`` that the account may enter, in their order."""
        return tuple(name for name in rooms if self.sees(user, "room", name))

    def _refusal(self, user: User | None, avatar: str) -> str:
        if user is not None and self.accounts is not None and not self.accounts.holds(user):
            return "this account, or what it may do, was changed; connect again"
        if not self.sees(user, "avatar", avatar):
            return "this account may not drive this avatar"
        if self.consent is None:
            return ""
        return self.consent.refusal(avatar, "" if user is None else user.name, time.time()) or ""

    def _may_drive(self, user: User, avatar: str) -> bool:
        """By the account's list; whoever had an avatar made may drive it, too."""
        return user.may_drive(avatar) or self._maker(avatar) == user.name

    def _maker(self, avatar: str) -> str:
        return "" if self.consent is None else self.consent.maker(avatar)


def user_of(request: web.BaseRequest) -> User | None:
    """Who asks; None on a server without accounts, and for what needs none."""
    user: User | None = request.get(USER)
    return user
