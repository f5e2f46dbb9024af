"""Rooms in which clients meet, as a feature of a server."""

from __future__ import annotations

from glsplat.extras.rooms.rooms import Rooms
from glsplat.net.feature import Feature
from glsplat.net.options import ServerConfig


def features(config: ServerConfig) -> list[Feature]:
    """Return the rooms that ``config`` names."""
    return [Rooms(config.rooms, config.furnished)] if config.rooms else []
