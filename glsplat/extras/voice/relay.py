"""Voice: who talks in which room, and the relay of their signals, which the server does not read."""

from __future__ import annotations

import base64
import hashlib
import hmac
import re
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import msgspec

from glsplat.errors import GlsplatError, ProtocolError
from glsplat.extras.rooms.feature import Member
from glsplat.net.client_stream import ClientStream
from glsplat.net.feature import Feature, ServerView
from glsplat.net.guard.limits import Bucket
from glsplat.net.options import RequestedOptions
from glsplat.net.rights import User
from glsplat.optional import has_extra, missing

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


MAX_TALKERS = 8  # in a room: each page sends its sound to each other one
MAX_MESSAGE_BYTES = 16 * 1024  # an offer of one audio track has 1 to 4 kB

# Entering a room of eight takes a page 7 offers and some 20 messages of candidates, 40 kB.
_MESSAGES_S, _MESSAGES_BURST = 10.0, 200.0
_BYTES_S, _BYTES_BURST = 16.0 * 1024, 512.0 * 1024
_JOIN = 20  # messages that joining counts as: each of the others prepares a connection

_PREFIX = re.compile(r'\s*\{\s*"talk"\s*:')


class _Talk(msgspec.Struct):
    join: bool | None = None
    to: int | None = None
    signal: str = ""


class _Message(msgspec.Struct):
    talk: _Talk


_decode = msgspec.json.Decoder(_Message).decode
_encode = msgspec.json.Encoder().encode


@dataclass(slots=True, eq=False)
class _Guest:
    """A client in a room, and what it may still send."""

    client: ClientStream
    key: int  # of its person, which no other connection has
    messages: Bucket
    bytes: Bucket

    def say(self, **talk: Any) -> None:
        self.client.say(_encode({"talk": talk}).decode())


class Voice(Feature):
    """Let the members of a room exchange signals (docs/protocol.md, 2.2). Needs a feature ``Rooms`` before it."""

    def __init__(self, ice: IceServers | None = None) -> None:
        self._ice = ice or IceServers()
        self._rooms: dict[str, dict[int, _Guest]] = {}  # those who talk, by room and key
        self._count, self._bytes = 0, 0  # relayed since the start

    async def start(self, server: ServerView) -> None:
        """Use the server's clock. Raises GlsplatError without extras/speech, which opens the microphone."""
        if not has_extra("speech"):
            raise GlsplatError(missing("speech", "voice"))
        self._clock = server.clock

    def client_opened(self, client: ClientStream, requested: RequestedOptions) -> None:
        """Take the messages of a client in a room."""
        if isinstance(client.member, Member):
            now = self._clock()
            messages = Bucket.full(_MESSAGES_S, _MESSAGES_BURST, now)
            guest = _Guest(client, client.member.person.key, messages, Bucket.full(_BYTES_S, _BYTES_BURST, now))
            client.relay = partial(self._receive, guest)

    def client_closed(self, client: ClientStream, goodbye: bool) -> None:
        """Tell the others that somebody left."""
        if isinstance(client.member, Member):
            self._leave(client.room, client.member.person.key)

    def session(self, user: User | None) -> Mapping[str, Any]:
        """Return ``talk`` of /session."""
        return {"talk": {"relay": self._ice.relay_only}}

    def stats(self, user: User | None) -> Mapping[str, Any]:
        """Return ``talk`` of /stats: how many talk, and the relayed signals with their bytes."""
        return {"talk": {"people": sum(map(len, self._rooms.values())), "signals": self._count, "bytes": self._bytes}}

    def _receive(self, guest: _Guest, text: str) -> bool:
        """Handle a message that begins with "talk". Raises ProtocolError."""
        if not _PREFIX.match(text) or guest.client.session.refusal():  # a refused client's next message closes it
            return False
        size = len(text.encode(errors="replace"))
        if size > MAX_MESSAGE_BYTES:
            raise ProtocolError(f"a message to others needs at most {MAX_MESSAGE_BYTES} bytes, not {size}", "too_big")
        self._charge(guest, 1, size)
        try:
            talk = _decode(text).talk
        except msgspec.ValidationError:
            raise ProtocolError('talk needs "join", or "to" and "signal"', "bad_field") from None
        except (msgspec.DecodeError, ValueError, RecursionError):
            raise ProtocolError("the message to others is no JSON", "bad_json") from None
        there = self._rooms.setdefault(guest.client.room, {})
        if talk.join is not None:
            self._leave(guest.client.room, guest.key)
            if talk.join:
                self._charge(guest, _JOIN, 0)
                self._join(guest, there)
        elif guest.key in there and talk.to in there:  # the other one may have left meanwhile
            self._count += 1
            self._bytes += size
            there[talk.to].say(**{"from": guest.key, "signal": talk.signal})
        return True

    def _charge(self, guest: _Guest, messages: int, size: int) -> None:
        """Take messages and bytes from what a guest may send. Raises ProtocolError where that is used up."""
        now = self._clock()
        if not (guest.messages.take(now, messages) and guest.bytes.take(now, size)):
            raise ProtocolError(f"at most {_MESSAGES_S:g} messages to others a second", "rate")

    def _join(self, guest: _Guest, there: dict[int, _Guest]) -> None:
        if len(there) >= MAX_TALKERS:
            raise ProtocolError(f"{MAX_TALKERS} people talk in this room already", "talk_full")
        guest.say(
            you=guest.key,
            peers=[{"id": key, "name": other.client.driver} for key, other in there.items()],
            **self._ice.configuration(time.time()),
        )
        for other in there.values():
            other.say(joined={"id": guest.key, "name": guest.client.driver})
        there[guest.key] = guest

    def _leave(self, room: str, key: int) -> None:
        there = self._rooms.get(room, {})
        if there.pop(key, None) is not None:
            for other in there.values():
                other.say(left=key)
