"""One client in /stats."""

from __future__ import annotations

from typing import Any

from glsplat.net.client_stream import ClientStream

__all__ = ["client_fields"]


def client_fields(number: int, channel: ClientStream, status: dict[str, Any], seen: bool) -> dict[str, Any]:
    """The figures of a client, with the ``status`` of its session; who it is only where that may be ``seen``."""
    session = channel.session
    return status | {
        "id": number,
        "form": session.last_form,
        "size": "x".join(map(str, session.last_size)),
        "datagrams": None if channel.way is None else channel.way.status(),
        "avatar": channel.shown.name if seen else None,
        "room": channel.room or None if seen else None,
        "mark": status["mark"] if seen else None,
    }
