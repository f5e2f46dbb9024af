"""Voice between the pages of a room, peer to peer; the server relays their offers and nothing else (docs/vr.md).

`Voice` is a `Feature` of the server; `glsplat serve --room NAME --voice` adds it.
"""

from __future__ import annotations

from glsplat.extras.voice.relay import IceServers, Voice

__all__ = ["REQUIRES", "IceServers", "Voice"]

REQUIRES = ("rooms",)
