"""Rights: which account may see, drive and delete an avatar, by its lists, consent and privacy."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Literal, Protocol

from aiohttp import web

USER: web.RequestKey[Any] = web.RequestKey("user", object)
"""Key of a request's account."""

Thing = Literal["avatar", "room", "people", "client", "identity", "job"]
"""Subjects of ``Rights.sees``: an avatar (name, picture, splats); a room; the names of people in a room; the figures of
a connection; its identity (avatar, room, last picture, watermark); a job that makes an avatar."""


class User(Protocol):
    """One account (extras/accounts)."""

    @property
    def name(self) -> str:
        """The account's name."""

    def may_drive(self, avatar: str) -> bool:
        """Return whether the account may be shown, and drive, the avatar of that name."""

    def may_enter(self, room: str) -> bool:
        """Return whether the account may enter the room of that name."""


class Accounts(Protocol):
    """The accounts of a running server (extras/accounts)."""

    def known(self, token: str) -> User | None:
        """Return the account of a token that was verified before; None for any other."""

    async def verified(self, token: str) -> User | None:
        """Verify a token by its hash; return its account, or None."""

    def holds(self, user: Any) -> bool:
        """Return False once the account was removed, or its token or rights were changed."""


class Consent(Protocol):
    """The recorded consent of people whose avatars are shown (extras/consent)."""

    def refusal(self, avatar: str, driver: str, now: float) -> str | None:
        """Return why the avatar may not be shown to that account now; None while it may."""

    def lets(self, avatar: str, driver: str) -> bool:
        """Return whether the consent lets the account drive the avatar."""

    def withheld(self, avatar: str, now: float) -> str | None:
        """Return why the avatar's splats are not handed out; None where they are."""

    def label(self, avatar: str, driver: str = "") -> str:
        """Return the text that every picture of the avatar has to contain; "" for none."""

    def maker(self, avatar: str) -> str:
        """Return the account that made the avatar; "" for none."""


@dataclass(frozen=True, slots=True)
class Rights:
    """The rights on one server. All methods take microseconds.

    The user None is everybody on a server without accounts, and nobody on a server with them.
    """

    accounts: Accounts | None = None  # None: the server has none
    consent: Consent | None = None  # None: it is not checked
    private: bool = False  # without accounts: hide the identity of clients, and the people in rooms
    unseen: str = ""  # replaces every reason of a refusal, where a reason would reveal an avatar's name

    def sees(self, user: User | None, thing: Thing, of: str) -> bool:
        """Return whether ``user`` may see a ``thing``. Every page that shows other people's things calls this.

        ``of`` is the name of the avatar or the room; of a client, an identity or a job it is the account. An avatar
        whose consent names other drivers is not seen, as if it did not exist.
        """
        if user is None:
            return self.accounts is None and not (self.private and thing in ("people", "identity"))
        if thing == "avatar":
            return self._may_drive(user, of) and (self.consent is None or self.consent.lets(of, user.name))
        if thing == "room":
            return user.may_enter(of)
        return thing != "people" and user.name == of  # only people in the room see who else is there

    def may_delete(self, user: User | None, avatar: str) -> bool:
        """Return whether ``user`` may delete an avatar: only its maker, where that is known."""
        if user is None:
            return self.accounts is None
        return (self._maker(avatar) or user.name) == user.name and self._may_drive(user, avatar)

    def drivable(self, user: User | None, avatars: Iterable[str]) -> tuple[str, ...]:
        """Return those of ``avatars`` that may be shown to the account now, in their order."""
        return tuple(name for name in avatars if not self.refusal(user, name))

    def refusal(self, user: User | None, avatar: str) -> str:
        """Return why ``avatar`` may not be shown to the account now; "" while it may."""
        why = self._refusal(user, avatar)
        return (self.unseen or why) if why else ""

    def withheld(self, avatar: str) -> str:
        """Return why the splats of ``avatar`` are not handed out to its viewers; "" where they are."""
        if self.consent is None:
            return "this server hands out no splats"
        return self.consent.withheld(avatar, time.time()) or ""

    def label(self, user: User | None, avatar: str) -> str:
        """Return the text that every picture of ``avatar`` has to contain; "" for none."""
        return "" if self.consent is None else self.consent.label(avatar, "" if user is None else user.name)

    def enterable(self, user: User | None, rooms: Iterable[str]) -> tuple[str, ...]:
        """Return those of ``rooms`` that the account may enter, in their order."""
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
        """Return whether the account's list has the avatar, or the account made it."""
        return user.may_drive(avatar) or self._maker(avatar) == user.name

    def _maker(self, avatar: str) -> str:
        return "" if self.consent is None else self.consent.maker(avatar)


def user_of(request: web.BaseRequest) -> User | None:
    """Return the account of a request; None on a server without accounts, and for public pages."""
    user: User | None = request.get(USER)
    return user
