"""What a client asks for in the address it connects to: /ws?mirror=1&window=3&height=1.75."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from glsplat.errors import ProtocolError
from glsplat.net.messages import WireOptions
from glsplat.net.session import SessionConfig

__all__ = ["MAX_WINDOW", "client_options"]

MAX_WINDOW = 8


def client_options(
    query: Mapping[str, str], wire: WireOptions, session: SessionConfig
) -> tuple[WireOptions, SessionConfig, float | None]:
    """The server's options with the client's wishes in them, and the user's height in metres if it was given.

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
    return wire, session, _metres(query.get("height"))


def _metres(height: str | None) -> float | None:
    if height is None:
        return None
    try:
        metres = float(height)
    except ValueError:
        metres = 0.0
    if not 0.5 <= metres <= 2.8:
        raise ProtocolError("height needs 0.5 to 2.8 metres")
    return metres
