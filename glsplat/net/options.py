"""What a client asks for in the address it connects to: /ws?avatar=ann&mirror=1&window=3&height=1.75&span=1.4."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from glsplat.errors import ProtocolError
from glsplat.net.guard.rights import Rights
from glsplat.net.guard.users import User
from glsplat.net.messages import WireOptions
from glsplat.net.session import SessionConfig

__all__ = ["MAX_WINDOW", "NOT_ALLOWED", "Asked", "client_options"]

MAX_WINDOW = 8
NOT_ALLOWED = "not_allowed"
"""The code of the error for what exists, or might, and is not for this account now."""


_ALL = Rights()
_NOTHING = "there is no avatar here that you may drive"


@dataclass(frozen=True, slots=True, kw_only=True)
class Asked:
    """The server's options with one client's wishes in them."""

    wire: WireOptions
    session: SessionConfig
    avatar: str  # one of those offered
    height: float | None  # metres, of the user whose tracking is sent; None: not told
    span: float | None  # metres from wrist to wrist with the arms stretched; None: not told


def client_options(
    query: Mapping[str, str],
    wire: WireOptions,
    session: SessionConfig,
    avatars: Sequence[str],
    rights: Rights = _ALL,
    user: User | None = None,
) -> Asked:
    """What ``query`` asks for; of ``avatars``, the names offered, the first that ``user`` may drive by default.

    Raises ProtocolError naming the option that has no such value, of code NOT_ALLOWED for what the account may not
    have; it names nothing that the account may not drive.
    """
    mirror, window = query.get("mirror"), query.get("window")
    if mirror is not None:
        if mirror not in ("0", "1"):
            raise ProtocolError("mirror needs 0 or 1")
        wire = replace(wire, mirror=mirror == "1")
    if window is not None:
        if window not in map(str, range(1, MAX_WINDOW + 1)):
            raise ProtocolError(f"window needs 1 to {MAX_WINDOW}")
        session = replace(session, window=int(window))
    listed = [name for name in avatars if rights.may_drive(user, name)]
    free = rights.drivable(user, listed)
    avatar = query.get("avatar", next(iter([*free, *listed]), ""))
    if avatar not in listed:
        text = f"avatar needs a name of those offered here: {', '.join(free)}" if free else _NOTHING
        raise ProtocolError(text, "bad_request" if rights.may_drive(user, avatar) else NOT_ALLOWED)
    if why := rights.refusal(user, avatar):
        raise ProtocolError(why, NOT_ALLOWED)
    if user is not None and "room" in query and not user.may_enter(query["room"]):
        raise ProtocolError("this account may not enter this room", NOT_ALLOWED)
    return Asked(
        wire=wire,
        session=session,
        avatar=avatar,
        height=_metres(query, "height", 0.5, 2.8),
        span=_metres(query, "span", 0.3, 2.5),
    )


def _metres(query: Mapping[str, str], name: str, low: float, high: float) -> float | None:
    given = query.get(name)
    if given is None:
        return None
    try:
        metres = float(given)
    except ValueError:
        metres = 0.0
    if not low <= metres <= high:
        raise ProtocolError(f"{name} needs {low:g} to {high:g} metres")
    return metres
