"""IceServers: the STUN and TURN servers that pages use to reach each other, and passwords for them."""

from __future__ import annotations

import base64
import hashlib
import hmac
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from glsplat.errors import GlsplatError

_ADDRESS = re.compile(r"(?:stuns?|turns?):(?:[\w.-]+|\[[0-9A-Fa-f:]+\])(?::\d{1,5})?(?:\?transport=(?:udp|tcp))?")
_PASSWORD_S = 12 * 3600  # seconds for which a password is valid; a call that lasts longer goes on


@dataclass(frozen=True, slots=True)
class IceServers:
    """Addresses such as stun:HOST:3478 and turn:HOST:3478, none by default.

    ``secret`` is shared with the TURN servers (coturn: use-auth-secret). ``relay_only``: sound goes through TURN alone,
    so that pages do not see each other's IP addresses. Raises GlsplatError for options that do not fit together.
    """

    urls: Sequence[str] = ()
    secret: str = field(default="", repr=False)
    relay_only: bool = False

    def __post_init__(self) -> None:
        for url in self.urls:
            if not _ADDRESS.fullmatch(url):
                raise GlsplatError(f"an ICE server needs stun:HOST[:PORT] or turn:HOST[:PORT], not {url!r:.60}")
        if bool(self._turn) != bool(self.secret):
            found = "no secret" if self._turn else "no turn: address"
            raise GlsplatError(f"a TURN server needs its address and the secret shared with it; there is {found}")
        if self.relay_only and not self._turn:
            raise GlsplatError("voice by relay only needs a TURN server; there is none")

    @property
    def _turn(self) -> list[str]:
        return [url for url in self.urls if url.startswith("turn")]

    def configuration(self, now: float) -> dict[str, Any]:
        """Return an RTCConfiguration (WebRTC, 4.2.1) for one page, with a password of its own from ``now`` on.

        ``now`` are seconds since 1970. The password is that of "A REST API for access to TURN services"
        (draft-uberti-behave-turn-rest-00), which coturn and others implement.
        """
        servers: list[dict[str, Any]] = [{"urls": url} for url in self.urls if url not in self._turn]
        if self._turn:
            user = f"{int(now) + _PASSWORD_S}:glsplat"
            digest = hmac.new(self.secret.encode(), user.encode(), hashlib.sha1).digest()
            servers.append({"urls": self._turn, "username": user, "credential": base64.b64encode(digest).decode()})
        return {"iceServers": servers, "iceTransportPolicy": "relay" if self.relay_only else "all"}
