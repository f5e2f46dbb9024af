"""Fields of a client in /stats."""

from __future__ import annotations

from typing import Any

from glsplat.net.client_stream import ClientStream

__all__ = ["client_fields"]


def client_fields(number: int, client: ClientStream, status: dict[str, Any], seen: bool) -> dict[str, Any]:
    """Return the figures of a client, with the ``status`` of its session; its identity where it may be ``seen``."""
    session = client.session
    return status | {
        "id": number,
        "form": session.last_form,
        "size": "x".join(map(str, session.last_size)),
        "datagrams": None if client.datagrams is None else client.datagrams.status(),
        "avatar": client.shown.name if seen else None,
        "room": client.room or None if seen else None,
        "mark": status["mark"] if seen else None,
    }
