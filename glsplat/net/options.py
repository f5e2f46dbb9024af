"""What a client asks for in the address it connects to: /ws?avatar=ann&mirror=1&window=3&height=1.75&room=lab."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf, radians

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import ProtocolError
from glsplat.net.messages import WireOptions
from glsplat.net.rooms.seats import place_at
from glsplat.net.session import SessionConfig

__all__ = ["MAX_WINDOW", "Asked", "client_options"]

MAX_WINDOW = 8
_FARTHEST = 100.0  # metres from a room's centre


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Asked:
    """The server's options with one client's wishes in them."""

    wire: WireOptions
    session: SessionConfig
    avatar: str  # one of those offered
    height: float | None  # metres, of the user whose tracking is sent; None: not told
    span: float | None  # metres from wrist to wrist with the arms stretched; None: not told
    room: str | None = None
    name: str | None = None  # of the user, in the room
    place: NDArray[np.float64] | None = None  # [4, 4] room from user; None: the room chooses


def client_options(
    query: Mapping[str, str], wire: WireOptions, session: SessionConfig, avatars: Sequence[str]
) -> Asked:
    """What ``query`` asks for; of ``avatars``, the names offered, the first where it says nothing.

    Raises ProtocolError naming the option that has no such value.
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
    avatar = query.get("avatar", avatars[0])
    if avatar not in avatars:
        raise ProtocolError(f"avatar needs a name of those offered here: {', '.join(avatars)}")
    return Asked(
        wire=wire,
        session=session,
        avatar=avatar,
        height=_metres(query, "height", 0.5, 2.8),
        span=_metres(query, "span", 0.3, 2.5),
        room=query.get("room"),
        name=query.get("name"),
        place=_place(query.get("at")),
    )


def _place(given: str | None) -> NDArray[np.float64] | None:
    """[4, 4] of x, z in metres and degrees about y."""
    if given is None:
        return None
    try:
        x, z, degrees = map(float, given.split(","))
    except ValueError:
        x = z = degrees = inf
    if not (max(abs(x), abs(z)) <= _FARTHEST and abs(degrees) <= 360):
        raise ProtocolError(f"at needs x,z,degrees: metres up to {_FARTHEST:g} and an angle up to 360")
    return place_at(x, z, radians(degrees))


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
