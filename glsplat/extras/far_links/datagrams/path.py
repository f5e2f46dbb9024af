"""Pictures by datagrams: a QUIC connection with one WebTransport session, tied to a client by a secret."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

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
    parity_for,
)
from glsplat.net.guard.limits import Bucket
from glsplat.net.messages import MAX_MESSAGE_BYTES

_HANDSHAKE_S = 5.0  # from the first packet to an accepted session
_GRACE_S = 0.05  # from QUIC's acknowledgement to the client's answer
_SILENT_S = 1.0  # longest time without news of a picture, or four round trips; then the path is closed
_UNANSWERED_S = 2.0  # longest wait for the client's answer to an acknowledged picture, or eight round trips
_MAX_UNANSWERED = 3  # unanswered pictures in a row that close a path
_MAX_LOST = 6  # lost pictures in a row that close a path
_PACKETS_PER_S, _PACKET_BURST = 600.0, 2000.0  # limits for a client, plus one for each packet sent to it
_PACKET_S = 0.25e-3  # usual time to process a packet; a slower packet counts as several
_MAX_STREAM_BYTES = 32 * 1024  # of all streams: settings and a CONNECT
_HEADER_BYTES = 60  # of a datagram beside its piece: UDP, IP, QUIC, this protocol


@dataclass(slots=True)
class _SentPicture:
    """A picture that the client has not answered yet."""

    nonce: bytes
    written: float  # seconds
    first: int  # number of its first packet
    parity: int
    last: int = -1  # number of its last packet; -1: some are unsent
    settled: float = 0.0  # when every packet was known to have arrived or to be lost


class PathUser(Protocol):
    """Callbacks of a path, called on the event loop."""

    def opened(self, path: DatagramPath) -> None:
        """Start sending pictures."""

    def answered(self, payload: bytes) -> None:
        """Record the answer to a ping, or the nonce of a picture that arrived."""

    def heard(self, message: bytes) -> None:
        """Accept a message of the client, as over the WebSocket."""

    def lost(self, frame_id: int) -> None:
        """Record a picture that will not arrive."""

    def unanswered(self, frame_id: int) -> None:
        """Record a picture that QUIC acknowledged and the client did not."""

    def closed(self) -> None:
        """Send nothing more."""


class DatagramPath(ConnectionProtocol):
    """One client's connection for pictures; ``admit`` returns the owner of a secret, or None."""

    def __init__(self, quic: Any, stream_handler: Any = None, *, admit: Callable[[str], PathUser | None]) -> None:
        super().__init__(quic, stream_handler)
        self._admit = admit
        self._http: H3Connection | None = None
        self._user: PathUser | None = None
        self._session: int | None = None
        assert isinstance(self.congestion_control, PictureWindow)
        self._window = self.congestion_control
        self._sent: dict[int, _SentPicture] = {}  # by frame_id, oldest first
        self._lost_in_a_row = 0
        self._awaited: dict[int, tuple[bytes, float]] = {}  # by frame_id: pictures that only QUIC acknowledged
        self._unanswered_in_a_row = 0
        self._timer_handle: asyncio.TimerHandle | None = self.loop.call_later(_HANDSHAKE_S, self._handshake_timed_out)
        self._received = Bucket.full(_PACKETS_PER_S, _PACKET_BURST, self.loop.time())
        # without parity: restoring a request takes longer than drawing for it
        self._requests = Assembler(REQUEST, MAX_MESSAGE_BYTES, parity=0)
        self._streamed = 0
        self._ended = False

    @property
    def accepted(self) -> bool:
        """Whether the path belongs to a client."""
        return self._user is not None

    @property
    def loss(self) -> float:
        """Lost share of the packets."""
        return self._window.loss

    def overhead(self, nbytes: int) -> float:
        """Return the bytes sent for each byte of a picture of that size."""
        pieces, groups = groups_of(max(1, nbytes))
        each = -(-pieces // groups)
        return (1 + parity_for(each, self.loss) / each) * (1 + _HEADER_BYTES / PIECE)

    def takes(self, nbytes: int) -> bool:
        """Return whether a picture of ``nbytes`` can be sent now."""
        return self._session is not None and not self._ended and 0 < nbytes + NONCE <= LARGEST

    def send(self, frame_id: int, nonce: bytes, picture: bytes, rate: float) -> None:
        """Send a picture over a link of ``rate`` bits a second; drop unsent datagrams of older pictures."""
        assert self._http is not None and self._session is not None
        message = nonce + picture
        pieces, groups = groups_of(len(message))
        parity = parity_for(-(-pieces // groups), self.loss)
        if self.has_unsent:
            self.drop_unsent()
            for one in self._sent.values():
                if one.last < 0:
                    one.last, one.parity = self._window.newest, -1  # lost, unless its client answers
        self._window.allow(rate, round(len(message) * self.overhead(len(message))))
        now = self.loop.time()
        self._sent[frame_id] = _SentPicture(nonce, now, self._window.newest + 1, parity)
        for packet in packets_of(frame_id, message, parity):
            self._http.send_datagram(self._session, packet)
        self.transmit()
        if self._timer_handle is None:
            self._check_later()

    def probe(self, payload: bytes) -> None:
        """Send a small message that the client returns."""
        if self._http is not None and self._session is not None and not self._ended:
            self._http.send_datagram(self._session, HEAD.pack(PING, 0, 0, 0, len(payload)) + payload)
            self.transmit()

    def end(self) -> None:
        """Close the connection; pictures on the way are lost."""
        if self._ended:
            return
        self._ended = True
        if self._timer_handle is not None:
            self._timer_handle.cancel()
        self.close()
        self._give_up_pictures()

    # ----------------------------------------------------------------------------------------------- connection

    def datagram_received(self, data: bytes | str, addr: Any) -> None:
        """Process a UDP datagram of this connection. A client that sends too many is disconnected."""
        now = self.loop.time()
        if self._ended:
            super().datagram_received(data, addr)
        elif self._received.take(now):
            begun = time.thread_time()
            super().datagram_received(data, addr)
            self._received.charge(now, max(0.0, (time.thread_time() - begun) / _PACKET_S - 1))
            self._check_pictures(now)
        else:
            self.end()

    def transmit(self) -> None:
        """Send what the window allows, and record the last packet of each picture."""
        before = self._window.newest
        super().transmit()
        sent = self._window.newest - before
        if sent > 0:
            self._received.charge(self.loop.time(), -sent)
        if not self.has_unsent:
            for one in self._sent.values():
                if one.last < 0:
                    one.last = self._window.newest

    def quic_event_received(self, event: QuicEvent) -> None:
        """Handle an event of aioquic."""
        if isinstance(event, ConnectionTerminated):
            self._ended = True
            if self._timer_handle is not None:
                self._timer_handle.cancel()
            self._give_up_pictures()
            return
        if isinstance(event, StreamDataReceived):
            self._streamed += len(event.data)
            if self._streamed > _MAX_STREAM_BYTES:
                self.end()
                return
        if self._http is None:
            self._http = H3Connection(self.quic, enable_webtransport=True)
        for parsed in self._http.handle_event(event):
            self._handle(parsed)

    def _handle(self, event: H3Event) -> None:
        if isinstance(event, HeadersReceived):
            self._open(event)
        elif isinstance(event, DatagramReceived) and event.stream_id == self._session and self._user is not None:
            payload = event.data
            if len(payload) != NONCE:
                if (request := self._requests.add(payload)) is not None:
                    self._user.heard(request[1])
                return
            nonces = {one.nonce: frame_id for frame_id, one in self._sent.items()}
            nonces |= {nonce: frame_id for frame_id, (nonce, _) in self._awaited.items()}
            if payload in nonces:
                self._arrived(nonces[payload])
                self._awaited = {other: one for other, one in self._awaited.items() if other > nonces[payload]}
                self._unanswered_in_a_row = 0
            self._user.answered(payload)
        elif isinstance(event, DatagramReceived) or (isinstance(event, DataReceived) and not event.stream_ended):
            return  # no session, or an empty capsule of Chromium (grease)
        else:
            self.end()  # the client closes its session, or opens a stream

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
        if self._timer_handle is not None:
            self._timer_handle.cancel()
            self._timer_handle = None
        user.opened(self)

    # ----------------------------------------------------------------------------------------------- pictures

    def _arrived(self, frame_id: int) -> None:
        self._lost_in_a_row = 0
        for old in [old for old in self._sent if old <= frame_id]:
            del self._sent[old]

    def _check_pictures(self, now: float) -> None:
        """Report pictures whose packets all arrived or are lost; close a path that is no longer answered."""
        for frame_id, (_, since) in list(self._awaited.items()):
            if self._user is None or now - since <= max(_UNANSWERED_S, 8 * self._window.trip):
                break
            del self._awaited[frame_id]
            self._user.unanswered(frame_id)
            self._unanswered_in_a_row += 1
            if self._unanswered_in_a_row >= _MAX_UNANSWERED:  # a browser with a full queue drops datagrams
                self.end()
                return
        for frame_id, one in list(self._sent.items()):
            if self._user is None:
                return
            if one.last < 0 or not self._window.settled(one.last):
                if now - one.written > max(_SILENT_S, 4 * self._window.trip):
                    self.end()
                return
            if self._window.lost_of(one.first, one.last) > one.parity:
                del self._sent[frame_id]
                self._user.lost(frame_id)
                self._lost_in_a_row += 1
                if self._lost_in_a_row >= _MAX_LOST:
                    self.end()
                continue
            one.settled = one.settled or now
            if now - one.settled < _GRACE_S:
                return
            self._arrived(frame_id)  # QUIC acknowledged it; the answer is late
            self._awaited[frame_id] = one.nonce, now
            self._user.answered(one.nonce)

    def _check_later(self) -> None:
        def look() -> None:
            self._timer_handle = None
            self._check_pictures(self.loop.time())
            if (self._sent or self._awaited) and not self._ended:
                self._check_later()

        self._timer_handle = self.loop.call_later(_GRACE_S, look)

    def _handshake_timed_out(self) -> None:
        self._timer_handle = None
        self.end()

    def _give_up_pictures(self) -> None:
        under_way, user = list(self._sent), self._user
        self._sent, self._user = {}, None
        if user is not None:
            for frame_id in under_way:
                user.lost(frame_id)
            user.closed()
