"""Configuration of a server, and a client's options in its address: /ws?avatar=ann&mirror=1&window=3&room=lab."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf, radians
from pathlib import Path

from glsplat.errors import ProtocolError
from glsplat.net.guard.access import Access
from glsplat.net.guard.limits import Limits
from glsplat.net.messages import WireOptions
from glsplat.net.rights import Consent, Rights, User
from glsplat.net.session import SessionConfig

DEFAULT_SEATS = 8
"""Seats of a room that configures none."""

MAX_WINDOW = 8
_MAX_ROOM_DISTANCE_M = 100.0  # metres from a room's centre
NOT_ALLOWED = "not_allowed"
"""Error code for an option that this account may not have, whether or not it exists."""

NAME = re.compile(r"[^\W_](?:[\w .'-]{0,30}[\w.])?")
"""Names of rooms and of people in them: up to 32 letters and digits of any script, blanks and _ . ' - between them."""


class RoomError(ProtocolError):
    """A client cannot enter its room; ``status`` is the HTTP status of the answer."""

    def __init__(self, message: str, status: int) -> None:
        super().__init__(message, "bad_request")
        self.status = status


@dataclass(frozen=True, slots=True, kw_only=True)
class ServerConfig:
    """Configuration of a server."""

    access: Access = field(default_factory=Access)
    port: int = 8000  # 0: any free one
    tls: tuple[Path, Path] | None = None  # certificate and key, PEM
    wire: WireOptions = field(default_factory=WireOptions)
    session: SessionConfig = field(default_factory=SessionConfig)
    limits: Limits = field(default_factory=Limits)
    max_clients: int = 8
    heartbeat: float = 15.0  # seconds between pings; half of it without a pong ends the connection
    write_timeout: float = 2.0  # seconds that a client may leave a reply unread
    drain_timeout: float = 3.0  # seconds for pictures under way when the server stops
    scene: str = "avatar"  # for the status page
    rooms: Mapping[str, int] = field(default_factory=dict)  # seats by room
    furnished: frozenset[str] = frozenset()  # rooms that have scenery
    consent: Consent | None = None  # of the people who are shown; None: it is not checked
    fps: float | None = None  # pictures a second for each client, by less detail where needed; None: no target
    private: bool = False  # hide the clients' identities and avatars from everybody
    video: bool = False  # send video instead of JPEGs to clients that accept it (extras/far_links/video.py)
    webtransport: bool = False  # send pictures by datagrams over long links to clients that accept them
    fit: bool = False  # offer the largest pictures that this machine draws often enough (internal_client.py)


_ALL = Rights()
_NO_AVATAR = "there is no avatar here that you may drive"


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RequestedOptions:
    """The server's options with one client's requested options in them."""

    wire: WireOptions
    session: SessionConfig
    avatar: str  # an offered one
    height: float | None  # metres, of the user whose tracking is sent; None: unknown
    span: float | None  # metres from wrist to wrist with the arms stretched; None: unknown
    room: str | None = None
    name: str = ""  # of the user: the account's name, else the requested one, or ""
    resume: str = ""  # token of the person in the room that this client continues; "": a new one
    label: bool = False  # write who drives into the pictures
    place: tuple[float, float, float] | None = None  # x and z in metres, radians about y; None: the room chooses


def client_options(
    query: Mapping[str, str],
    wire: WireOptions,
    session: SessionConfig,
    avatars: Sequence[str],
    rights: Rights = _ALL,
    user: User | None = None,
) -> RequestedOptions:
    """Return the options in ``query``; the default avatar is the first of ``avatars`` that ``user`` may drive.

    Raises ProtocolError for an invalid option, with the code NOT_ALLOWED for one that the account may not have. The
    error does not reveal whether something exists that the account may not see.
    """
    if "mirror" in query:
        wire = replace(wire, mirror=_flag(query, "mirror"))
    if (window := query.get("window")) is not None:
        if window not in map(str, range(1, MAX_WINDOW + 1)):
            raise ProtocolError(f"window needs 1 to {MAX_WINDOW}")
        session = replace(session, window=int(window), max_window=int(window))
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
    return RequestedOptions(
        wire=wire,
        session=session,
        avatar=avatar,
        height=_metres(query, "height", 0.5, 2.8),
        span=_metres(query, "span", 0.3, 2.5),
        room=query.get("room"),
        name=_name(query.get("name"), user),
        resume=query.get("resume", ""),
        label=_flag(query, "label", "1" if "room" in query else "0"),
        place=_place(query.get("at")),
    )


def _flag(query: Mapping[str, str], name: str, default: str = "0") -> bool:
    given = query.get(name, default)
    if given not in ("0", "1"):
        raise ProtocolError(f"{name} needs 0 or 1")
    return given == "1"


def _name(given: str | None, user: User | None) -> str:
    """Return the user's name. Raises ProtocolError."""
    if user is not None:
        if given not in (None, user.name):
            raise ProtocolError("this account goes by its own name only: leave name out", NOT_ALLOWED)
        return user.name
    if given is not None and not NAME.fullmatch(given):
        raise ProtocolError("name needs 1 to 32 letters, digits, blanks or _.'- between them")
    return given or ""


def _place(given: str | None) -> tuple[float, float, float] | None:
    """Parse "x,z,degrees" to x and z in metres and radians about y. Raises ProtocolError."""
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
