"""Pictures by datagrams: a QUIC connection with one WebTransport session, tied to a client by a secret."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from aioquic.h3.connection import H3Connection
from aioquic.h3.events import DatagramReceived, DataReceived, H3Event, HeadersReceived
from aioquic.quic.events import ConnectionTerminated, QuicEvent, StreamDataReceived

from glsplat.extras.far_links.datagrams.aioquic_internals import ConnectionProtocol
from glsplat.extras.far_links.datagrams.congestion import PictureWindow
from glsplat.extras.far_links.datagrams.packets import (
    HEAD,
    LARGEST,
    NONCE,
    PIECE,
    PING,
    REQUEST,
    Assembler,
    groups_of,
    packets_of,
)
from glsplat.extras.far_links.datagrams.redundancy import parity_for
from glsplat.extras.far_links.datagrams.roles import PathUser
from glsplat.net.guard.limits import Bucket
from glsplat.net.messages import MAX_MESSAGE_BYTES

__all__ = ["DatagramPath"]

_HANDSHAKE = 5.0  # seconds from the first packet to an accepted session
_GRACE = 0.05  # seconds that a client's answer may come after QUIC's own acknowledgement
_SILENT = 1.0  # seconds, and four round trips, for which nothing is heard of a picture: no path any more
_UNANSWERED = 2.0  # seconds, and eight round trips, without an answer of a client to a picture that QUIC says it has
_SILENCES = 3  # such pictures in a row: no path any more
_LOST = 6  # pictures in a row
_PACKETS, _BURST = 600.0, 2000.0  # a second, and at once, that a client may send, and one for each that it was sent
_USUAL = 0.25e-3  # seconds that a packet takes; one of many small frames counts as several
_STREAMED = 32 * 1024  # bytes of all streams together: settings, a CONNECT and what means nothing
_HEADERS = 60  # bytes of a datagram beside its piece: UDP, IP, QUIC, this protocol


@dataclass(slots=True)
class _UnderWay:
    """A picture whose client has not answered."""

    nonce: bytes
    written: float  # seconds
    first: int  # packet
    parity: int
    last: int = -1  # packet; -1: some wait to be sent
    settled: float = 0.0  # when it was known of each packet whether it arrived


class DatagramPath(ConnectionProtocol):
    """``admit`` gives the user of a secret that a client named, or None. ``clock`` is the server's."""

    def __init__(self, quic: Any, stream_handler: Any = None, *, admit: Callable[[str], PathUser | None]) -> None:
        super().__init__(quic, stream_handler)
        self._admit = admit
        self._http: H3Connection | None = None
        self._user: PathUser | None = None
        self._session: int | None = None
        assert isinstance(self.congestion_control, PictureWindow)
        self._window = self.congestion_control
        self._under_way: dict[int, _UnderWay] = {}  # by frame_id, oldest first
        self._lost_in_a_row = 0
        self._awaited: dict[int, tuple[bytes, float]] = {}  # by frame_id: what QUIC alone says is there
        self._silences = 0  # in a row
        self._check: asyncio.TimerHandle | None = self.loop.call_later(_HANDSHAKE, self._too_late)
        self._received = Bucket.full(_PACKETS, _BURST, self.loop.time())
        self._requests = Assembler(
            REQUEST, MAX_MESSAGE_BYTES, parity=0
        )  # to restore one takes longer than to draw for it
        self._streamed = 0
        self._ended = False

    @property
    def accepted(self) -> bool:
        """Whether it belongs to a client."""
        return self._user is not None

    @property
    def loss(self) -> float:
        """Share of the packets that is lost."""
        return self._window.loss

    def overhead(self, nbytes: int) -> float:
        """Bytes on the way for each byte of a picture of that size."""
        pieces, groups = groups_of(max(1, nbytes))
        each = -(-pieces // groups)
        return (1 + parity_for(each, self.loss) / each) * (1 + _HEADERS / PIECE)

    def takes(self, nbytes: int) -> bool:
        """Whether a picture of so many bytes can go this way now."""
        return self._session is not None and not self._ended and 0 < nbytes + NONCE <= LARGEST

    def send(self, frame_id: int, nonce: bytes, picture: bytes, rate: float) -> None:
        """A picture, over a link that takes ``rate`` bits a second. What is unsent of an older one is left out."""
        assert self._http is not None and self._session is not None
        message = nonce + picture
        pieces, groups = groups_of(len(message))
        parity = parity_for(-(-pieces // groups), self.loss)
        if self.has_unsent:
            self.drop_unsent()
            for one in self._under_way.values():
                if one.last < 0:
                    one.last, one.parity = self._window.newest, -1  # lost, unless its client says otherwise
        self._window.allow(rate, round(len(message) * self.overhead(len(message))))
        now = self.loop.time()
        self._under_way[frame_id] = _UnderWay(nonce, now, self._window.newest + 1, parity)
        for packet in packets_of(frame_id, message, parity):
            self._http.send_datagram(self._session, packet)
        self.transmit()
        if self._check is None:
            self._look_later()

    def probe(self, payload: bytes) -> None:
        """A small message that the client sends back."""
        if self._http is not None and self._session is not None and not self._ended:
            self._http.send_datagram(self._session, HEAD.pack(PING, 0, 0, 0, len(payload)) + payload)
            self.transmit()

    def end(self) -> None:
        """Close it; what is under way is lost."""
        if self._ended:
            return
        self._ended = True
        if self._check is not None:
            self._check.cancel()
        self.close()
        self._forget()

    # ----------------------------------------------------------------------------------------------- of the connection

    def datagram_received(self, data: bytes | str, addr: Any) -> None:
        """A UDP datagram of this connection. A client that sends more than it has a reason to is cut off."""
        now = self.loop.time()
        if self._ended:
            super().datagram_received(data, addr)
        elif self._received.take(now):
            begun = time.thread_time()
            super().datagram_received(data, addr)
            self._received.charge(now, max(0.0, (time.thread_time() - begun) / _USUAL - 1))
            self._look(now)
        else:
            self.end()

    def transmit(self) -> None:
        """Send what may be sent now, and note which packets a picture ended with."""
        before = self._window.newest
        super().transmit()
        sent = self._window.newest - before
        if sent > 0:
            self._received.charge(self.loop.time(), -sent)
        if not self.has_unsent:
            for one in self._under_way.values():
                if one.last < 0:
                    one.last = self._window.newest

    def quic_event_received(self, event: QuicEvent) -> None:
        """aioquic's hook."""
        if isinstance(event, ConnectionTerminated):
            self._ended = True
            if self._check is not None:
                self._check.cancel()
            self._forget()
            return
        if isinstance(event, StreamDataReceived):
            self._streamed += len(event.data)
            if self._streamed > _STREAMED:
                self.end()
                return
        if self._http is None:
            self._http = H3Connection(self.quic, enable_webtransport=True)
        for heard in self._http.handle_event(event):
            self._heard(heard)

    def _heard(self, event: H3Event) -> None:
        if isinstance(event, HeadersReceived):
            self._open(event)
        elif isinstance(event, DatagramReceived) and event.stream_id == self._session and self._user is not None:
            payload = event.data
            if len(payload) != NONCE:
                if (request := self._requests.add(payload)) is not None:
                    self._user.heard(request[1])
                return
            nonces = {one.nonce: frame_id for frame_id, one in self._under_way.items()}
            nonces |= {nonce: frame_id for frame_id, (nonce, _) in self._awaited.items()}
            if payload in nonces:
                self._arrived(nonces[payload])
                self._awaited = {other: one for other, one in self._awaited.items() if other > nonces[payload]}
                self._silences = 0
            self._user.answered(payload)
        elif isinstance(event, DatagramReceived) or (isinstance(event, DataReceived) and not event.stream_ended):
            return  # of no session, or a capsule: Chromium sends some that mean nothing (grease)
        else:
            self.end()  # it closes its session, or opens streams, for which there is no use here

    def _open(self, event: HeadersReceived) -> None:
        headers = dict(event.headers)
        wanted = headers.get(b":method") == b"CONNECT" and headers.get(b":protocol") == b"webtransport"
        path = headers.get(b":path", b"").decode("ascii", "replace")
        user = self._admit(path.rpartition("/")[2]) if wanted and self._session is None else None
        if user is None:
            self.end()
            return
        assert self._http is not None
        self._http.send_headers(event.stream_id, [(b":status", b"200"), (b"sec-webtransport-http3-draft", b"draft02")])
        self._user, self._session = user, event.stream_id
        if self._check is not None:
            self._check.cancel()
            self._check = None
        user.opened(self)

    # ------------------------------------------------------------------------------------------------ of the pictures

    def _arrived(self, frame_id: int) -> None:
        self._lost_in_a_row = 0
        for old in [old for old in self._under_way if old <= frame_id]:
            del self._under_way[old]

    def _look(self, now: float) -> None:
        """At pictures of which all packets are known to have arrived or not, and at those that nobody answers."""
        for frame_id, (_, since) in list(self._awaited.items()):
            if self._user is None or now - since <= max(_UNANSWERED, 8 * self._window.trip):
                break
            del self._awaited[frame_id]
            self._user.unanswered(frame_id)
            self._silences += 1
            if self._silences >= _SILENCES:  # a browser whose line of datagrams is full throws them away
                self.end()
                return
        for frame_id, one in list(self._under_way.items()):
            if self._user is None:
                return
            if one.last < 0 or not self._window.settled(one.last):
                if now - one.written > max(_SILENT, 4 * self._window.trip):
                    self.end()
                return
            if self._window.lost_of(one.first, one.last) > one.parity:
                del self._under_way[frame_id]
                self._user.lost(frame_id)
                self._lost_in_a_row += 1
                if self._lost_in_a_row >= _LOST:
                    self.end()
                continue
            one.settled = one.settled or now
            if now - one.settled < _GRACE:
                return
            self._arrived(frame_id)  # its browser has it, whatever keeps the answer
            self._awaited[frame_id] = one.nonce, now
            self._user.answered(one.nonce)

    def _look_later(self) -> None:
        def look() -> None:
            self._check = None
            self._look(self.loop.time())
            if (self._under_way or self._awaited) and not self._ended:
                self._look_later()

        self._check = self.loop.call_later(_GRACE, look)

    def _too_late(self) -> None:
        self._check = None
        self.end()

    def _forget(self) -> None:
        under_way, user = list(self._under_way), self._user
        self._under_way, self._user = {}, None
        if user is not None:
            for frame_id in under_way:
                user.lost(frame_id)
            user.closed()
