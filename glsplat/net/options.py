"""What a server is told before it starts, and what a client asks for in the address it connects to.

That is /ws?avatar=ann&mirror=1&window=3&height=1.75&room=lab.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf, radians
from pathlib import Path
from typing import TYPE_CHECKING

from glsplat.errors import ProtocolError
from glsplat.net.guard.access import Access
from glsplat.net.guard.limits import Limits
from glsplat.net.messages import WireOptions
from glsplat.net.rights import Rights
from glsplat.net.session import SessionConfig

if TYPE_CHECKING:
    from glsplat.net.rights import Consent, User

__all__ = ["MAX_WINDOW", "NAME", "NOT_ALLOWED", "RequestedOptions", "RoomError", "ServerConfig", "client_options"]

MAX_WINDOW = 8
_MAX_ROOM_DISTANCE_M = 100.0  # metres from a room's centre
NOT_ALLOWED = "not_allowed"
"""The code of the error for what exists, or might, and is not for this account now."""


NAME = re.compile(r"[^\W_](?:[\w .'-]{0,30}[\w.])?")
"""Names of rooms and of people in them: up to 32 letters and digits of any script, blanks and _ . ' - between them."""


class RoomError(ProtocolError):
    """A client cannot enter its room; ``status`` is the HTTP status of the answer."""

    def __init__(self, message: str, status: int) -> None:
        super().__init__(message, "bad_request")
        self.status = status


@dataclass(frozen=True, slots=True, kw_only=True)
class ServerConfig:
    """Everything a server is told before it starts."""

    access: Access = field(default_factory=Access)
    port: int = 8000  # 0: any free one
    tls: tuple[Path, Path] | None = None  # certificate and key, PEM
    wire: WireOptions = field(default_factory=WireOptions)
    session: SessionConfig = field(default_factory=SessionConfig)
    limits: Limits = field(default_factory=Limits)
    max_clients: int = 8
    heartbeat: float = 15.0  # seconds between pings; half of it without a pong ends the connection
    write_timeout: float = 2.0  # seconds a client may leave a reply unread
    drain_timeout: float = 3.0  # seconds that pictures under way get at the end
    scene: str = "avatar"  # for the status page
    rooms: Mapping[str, int] = field(default_factory=dict)  # seats of each
    furnished: frozenset[str] = frozenset()  # those of them in which more is to be seen than people
    consent: Consent | None = None  # of those who are shown; None: nobody asks for it
    fps: float | None = None  # pictures a second that each client gets, with less detail if need be; None: as it comes
    private: bool = False  # nobody sees who the clients are, and what they are shown
    video: bool = False  # clients that ask for it get video instead of JPEGs (codec/video.py)
    webtransport: bool = False  # pictures go by datagrams over long ways to clients that can have them so
    fit: bool = False  # offer pictures of the largest size that is drawn often enough here (pace/fitting.py)


_ALL = Rights()
_NO_AVATAR = "there is no avatar here that you may drive"


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RequestedOptions:
    """The server's options with one client's wishes in them."""

    wire: WireOptions
    session: SessionConfig
    avatar: str  # one of those offered
    height: float | None  # metres, of the user whose tracking is sent; None: not told
    span: float | None  # metres from wrist to wrist with the arms stretched; None: not told
    room: str | None = None
    name: str = ""  # of the user: the account's; else what the user says, or nothing
    resume: str = ""  # token of the person in the room that the user comes back as; "": a newcomer
    label: bool = False  # over the head of who is shown alone, too
    place: tuple[float, float, float] | None = None  # x and z in metres, radians about y; None: the room chooses


def client_options(
    query: Mapping[str, str],
    wire: WireOptions,
    session: SessionConfig,
    avatars: Sequence[str],
    rights: Rights = _ALL,
    user: User | None = None,
) -> RequestedOptions:
    """What ``query`` asks for; of ``avatars``, the names offered, the first that ``user`` may drive by default.

    Raises ProtocolError naming the option that has no such value, of code NOT_ALLOWED for what the account may not
    have; it is the same whether what the account may not see is there or not.
    """
    mirror, window = query.get("mirror"), query.get("window")
    if mirror is not None:
        if mirror not in ("0", "1"):
            raise ProtocolError("mirror needs 0 or 1")
        wire = replace(wire, mirror=mirror == "1")
    if window is not None:
        if window not in map(str, range(1, MAX_WINDOW + 1)):
            raise ProtocolError(f"window needs 1 to {MAX_WINDOW}")
        session = replace(session, window=int(window), widest=int(window))
    listed = [name for name in avatars if rights.sees(user, "avatar", name)]
    free = rights.drivable(user, listed)
    avatar = query.get("avatar", next(iter([*free, *listed]), ""))
    if avatar not in listed:
        text = f"avatar needs a name of those offered here: {', '.join(free)}" if free else _NO_AVATAR
        raise ProtocolError(rights.unseen or text, "bad_request" if user is None else NOT_ALLOWED)
    if why := rights.refusal(user, avatar):
        raise ProtocolError(why, NOT_ALLOWED)
    if "room" in query and not rights.sees(user, "room", query["room"]):
        raise ProtocolError("this account may not enter this room", NOT_ALLOWED)
    if query.get("label", "0") not in ("0", "1"):
        raise ProtocolError("label needs 0 or 1")
    return RequestedOptions(
        wire=wire,
        session=session,
        avatar=avatar,
        height=_metres(query, "height", 0.5, 2.8),
        span=_metres(query, "span", 0.3, 2.5),
        room=query.get("room"),
        name=_name(query.get("name"), user),
        resume=query.get("resume", ""),
        label=query.get("label") == "1",
        place=_place(query.get("at")),
    )


def _name(given: str | None, user: User | None) -> str:
    """What the user is called."""
    if user is not None:
        if given not in (None, user.name):
            raise ProtocolError("this account goes by its own name only: leave name out", NOT_ALLOWED)
        return user.name
    if given is not None and not NAME.fullmatch(given):
        raise ProtocolError("name needs 1 to 32 letters, digits, blanks or _.'- between them")
    return given or ""


def _place(given: str | None) -> tuple[float, float, float] | None:
    """Return x and z in metres and radians about y, of "x,z,degrees"."""
    if given is None:
        return None
    try:
        x, z, degrees = map(float, given.split(","))
    except ValueError:
        x = z = degrees = inf
    if not (
        abs(x) <= _MAX_ROOM_DISTANCE_M and abs(z) <= _MAX_ROOM_DISTANCE_M and abs(degrees) <= 360
    ):  # max() lets a NaN through
        raise ProtocolError(f"at needs x,z,degrees: metres up to {_MAX_ROOM_DISTANCE_M:g} and an angle up to 360")
    return x, z, radians(degrees)


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
