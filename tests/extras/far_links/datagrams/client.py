"""A WebTransport session by aioquic, as the page's worker has one by its browser."""

from __future__ import annotations

import asyncio
import base64
import ssl
from collections.abc import Callable
from typing import Any
from urllib.parse import urlsplit

from aioquic.asyncio.client import connect
from aioquic.asyncio.protocol import QuicConnectionProtocol
from aioquic.h3.connection import H3_ALPN, H3Connection
from aioquic.h3.events import DatagramReceived, HeadersReceived
from aioquic.quic.configuration import QuicConfiguration
from aioquic.quic.events import ConnectionTerminated
from cryptography.hazmat.primitives import hashes

from glsplat.extras.far_links.datagrams.congestion import NAME
from glsplat.extras.far_links.datagrams.packets import HEAD, NONCE, PING, REQUEST, Assembler, packets_of
from tests.net.wire import HANG

__all__ = ["ClientPath", "open_path"]


class ClientPath(QuicConnectionProtocol):
    """``message`` gets what a binary message of the WebSocket is; ``keep`` says of a datagram whether it arrived."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.http = H3Connection(self._quic, enable_webtransport=True)
        self.whole, self.number = Assembler(), 0
        self.message: Callable[[bytes], None] = lambda data: None
        self.keep: Callable[[bytes], bool] = lambda datagram: True
        self.answers = True
        self.session: asyncio.Future[int] = asyncio.get_running_loop().create_future()
        self.ended: asyncio.Future[int] = asyncio.get_running_loop().create_future()
        self.manager: Any = None

    def ask(self, text: str | bytes) -> None:
        """A request."""
        self.number += 1
        for packet in packets_of(self.number, text.encode() if isinstance(text, str) else text, 0, REQUEST):
            self.send(packet)

    def send(self, datagram: bytes) -> None:
        """Any datagram of the session."""
        self.http.send_datagram(self.session.result(), datagram)
        self.transmit()

    def connect_session(self, authority: str, path: str) -> int:
        """Ask for a session; its stream."""
        stream = self._quic.get_next_available_stream_id()
        pseudo = [(b":method", b"CONNECT"), (b":protocol", b"webtransport"), (b":scheme", b"https")]
        self.http.send_headers(stream, [*pseudo, (b":authority", authority.encode()), (b":path", path.encode())])
        self.transmit()
        return stream

    def quic_event_received(self, event: Any) -> None:
        if isinstance(event, ConnectionTerminated) and not self.ended.done():
            self.ended.set_result(event.error_code)
        for one in self.http.handle_event(event):
            if isinstance(one, HeadersReceived) and not self.session.done():
                self.session.set_result(one.stream_id)
            elif isinstance(one, DatagramReceived) and self.keep(one.data):
                self._take(one.data)

    def _take(self, data: bytes) -> None:
        if data[0] == PING:
            self.send(data[HEAD.size :])
        elif (found := self.whole.add(data)) is not None:
            if self.answers:
                self.send(found[1][:NONCE])
            self.message(found[1][NONCE:])


async def open_quic(url: str) -> ClientPath:
    """A QUIC connection to where that WebSocket's address leads, without a session."""
    parts = urlsplit(url)
    configuration = QuicConfiguration(
        alpn_protocols=H3_ALPN,
        is_client=True,
        verify_mode=ssl.CERT_NONE,
        max_datagram_frame_size=65536,
        congestion_control_algorithm=NAME,
    )
    manager = connect(parts.hostname or "", parts.port or 0, configuration=configuration, create_protocol=ClientPath)
    path: Any = await manager.__aenter__()
    path.manager = manager  # which would close it
    return path


async def open_path(url: str, offer: dict[str, str], message: Callable[[bytes], None] | None = None) -> ClientPath:
    """A session as it was offered. Raises TimeoutError where it does not open."""
    path = await open_quic(url)
    peer = path._quic.tls._peer_certificate
    assert peer is not None
    assert base64.b64encode(peer.fingerprint(hashes.SHA256())).decode() == offer["sha256"]
    if message is not None:
        path.message = message
    path.connect_session(urlsplit(url).netloc, "/" + offer["path"])
    async with asyncio.timeout(HANG):
        await asyncio.wait([path.session, path.ended], return_when=asyncio.FIRST_COMPLETED)
    if path.ended.done():
        raise ConnectionError(f"the session was refused ({path.ended.result()})")
    return path
