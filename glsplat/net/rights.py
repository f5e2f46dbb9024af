"""Who may be shown what: the accounts' lists and the consent of those who are shown, asked at every request."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from aiohttp import web

if TYPE_CHECKING:
    from glsplat.consent.policy import ConsentPolicy
    from glsplat.net.accounts.users import Accounts, User

__all__ = ["USER", "Rights", "user_of"]

USER: web.RequestKey[Any] = web.RequestKey("user", object)
"""Of a request: the account whose token came with it."""


@dataclass(frozen=True, slots=True)
class Rights:
    """Of one server; None: it has no accounts, or nobody asks for consent. A user of None may do everything."""

    accounts: Accounts | None = None
    consent: ConsentPolicy | None = None

    def may_drive(self, user: User | None, avatar: str) -> bool:
        """By the account's list; whoever had an avatar made may drive it, too."""
        return user is None or user.may_drive(avatar) or self._maker(avatar) == user.name

    def may_delete(self, user: User | None, avatar: str) -> bool:
        """Where it is known who had an avatar made, nobody else may."""
        return user is None or ((self._maker(avatar) or user.name) == user.name and self.may_drive(user, avatar))

    def drivable(self, user: User | None, avatars: Iterable[str]) -> tuple[str, ...]:
        """Those of ``avatars`` that the account may be shown now, in their order."""
        return tuple(name for name in avatars if not self.refusal(user, name))

    def refusal(self, user: User | None, avatar: str) -> str:
        """Why ``avatar`` may not be shown to the account now; "" while it may. Takes microseconds."""
        if user is not None and self.accounts is not None and not self.accounts.holds(user):
            return "this account, or what it may do, was changed; connect again"
        if not self.may_drive(user, avatar):
            return "this account may not drive this avatar"
        if self.consent is None:
            return ""
        return self.consent.refusal(avatar, "" if user is None else user.name, time.time()) or ""

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
        return tuple(name for name in rooms if user is None or user.may_enter(name))

    def _maker(self, avatar: str) -> str:
        return "" if self.consent is None else self.consent.maker(avatar)


def user_of(request: web.BaseRequest) -> User | None:
    """Who asks; None on a server without accounts, and for what needs none."""
    user: User | None = request.get(USER)
    return user
