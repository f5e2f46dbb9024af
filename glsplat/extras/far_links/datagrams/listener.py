"""The UDP port of a server. It answers only packets from addresses that were offered a connection."""

from __future__ import annotations

import asyncio
import base64
import logging
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Any

from aioquic.h3.connection import H3_ALPN
from aioquic.quic.configuration import QuicConfiguration
from cryptography.hazmat.primitives import hashes

from glsplat.extras.far_links.datagrams.aioquic_internals import SMALLEST_MAX_DATAGRAM_SIZE, ConnectionServer
from glsplat.extras.far_links.datagrams.congestion import NAME
from glsplat.extras.far_links.datagrams.offers import LASTS, Offers
from glsplat.extras.far_links.datagrams.path import DatagramPath, PathUser
from glsplat.extras.far_links.datagrams.udp import UdpSocket, bind_udp
from glsplat.extras.operations.certificate import short_lived_certificate
from glsplat.net.guard.limits import address_key
from glsplat.net.guard.notices import Notices

_CERTIFICATE_LIFE = timedelta(days=12)  # browsers accept 14, one of them in the past
_CERTIFICATE_RENEWAL = timedelta(days=5)
_IDLE_TIMEOUT_S = 30.0
_MAX_STREAM_BYTES = 16 * 1024  # of a client's stream: a CONNECT and its settings
_CONNECTION_ID_BYTES = 8
_LONG_HEADER = 0x80  # bit of a packet's first byte

for _name in ("quic", "http3"):  # aioquic logs a line for every connection, with text of the client
    logging.getLogger(_name).setLevel(logging.CRITICAL)


class DatagramListener:
    """Accepts connections that ``offer`` announced. ``refused`` counts connections without a valid secret."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self.refused = 0
        self._offers: Offers[PathUser] = Offers(clock)
        self._notices = Notices(clock)
        self._configuration = QuicConfiguration(
            alpn_protocols=H3_ALPN,
            is_client=False,
            congestion_control_algorithm=NAME,
            idle_timeout=_IDLE_TIMEOUT_S,
            max_data=4 * _MAX_STREAM_BYTES,
            max_stream_data=_MAX_STREAM_BYTES,
            max_datagram_frame_size=65536,  # no limit of its own: a packet holds less
            connection_id_length=_CONNECTION_ID_BYTES,
        )
        self._made = datetime.min.replace(tzinfo=UTC)
        self._sha256 = ""
        self._server: _Guarded | None = None
        self._socket: UdpSocket | None = None

    async def open(self, host: str, port: int) -> None:
        """Listen. Raises GlsplatError (port in use)."""
        self._renew()
        self._server = server = _Guarded(self._configuration, self._offers, self._admit, self._failed)
        self._socket = UdpSocket(bind_udp(host, port), server.received, self._flooded)
        server.connection_made(self._socket)  # type: ignore[arg-type]  # only sendto and close are called

    def offer(self, address: str, user: PathUser) -> dict[str, str] | None:
        """Return the URL path and certificate hash for the client's connection; None while the port is shut."""
        if self._socket is None or self._socket.shut:
            return None
        self._renew()
        self._socket.listen()
        asyncio.get_running_loop().call_later(2 * LASTS, self._rest_if_unused)
        return {"path": f"datagrams/{self._offers.make(address, user)}", "sha256": self._sha256}

    def withdraw(self, user: PathUser) -> None:
        """Withdraw the offer of a client that has left."""
        self._offers.withdraw(user)
        asyncio.get_running_loop().call_later(LASTS, self._rest_if_unused)

    async def close(self) -> None:
        """Close all connections and the port."""
        if self._server is not None and self._socket is not None:
            self._server.end()
            self._socket.close()
            self._server = self._socket = None

    def status(self) -> dict[str, int]:
        """Return the numbers for /stats."""
        paths = set() if self._server is None else self._server.paths()
        return {"open": sum(path.accepted for path in paths), "refused": self.refused}

    def _admit(self, secret: str, address: str) -> PathUser | None:
        user = self._offers.take(secret, address)
        if user is None:
            self.refused += 1
            self._notices("secret", "a datagram connection without a secret of ours was refused")
        return user

    def _rest_if_unused(self) -> None:
        """Stop reading while there is no connection and no open offer."""
        if self._server is not None and self._socket is not None:
            if not self._server.paths() and not self._offers.open():
                self._socket.rest()

    def _flooded(self) -> None:
        self._notices("strays", "the UDP port is flooded: pictures go over WebSockets for a while")
        assert self._server is not None
        self._server.end()

    def _failed(self, error: Exception) -> None:
        self._notices("quic", f"a datagram connection failed in the server: {type(error).__name__}")

    def _renew(self) -> None:
        now = datetime.now(UTC)
        if now - self._made < _CERTIFICATE_RENEWAL:
            return
        certificate, key = short_lived_certificate(_CERTIFICATE_LIFE)
        self._configuration.certificate, self._configuration.private_key = certificate, key
        self._sha256 = base64.b64encode(certificate.fingerprint(hashes.SHA256())).decode()
        self._made = now


class _Guarded(ConnectionServer):
    """aioquic's server behind a filter: packets of unknown connections pass only from addresses with an offer."""

    def __init__(
        self,
        configuration: QuicConfiguration,
        offers: Offers[PathUser],
        admit: Callable[[str, str], PathUser | None],
        failed: Callable[[Exception], None],
    ) -> None:
        super().__init__(configuration, self._path)
        self._offers, self._admit, self._failed = offers, admit, failed
        self._address = ""  # of the datagram in hand

    def received(self, data: bytes, addr: Any) -> bool:
        """Process a UDP datagram, which may open an offered connection; return whether its connection was open."""
        path = self.connection(_destination(data))
        if path is None:
            if (
                len(data) < SMALLEST_MAX_DATAGRAM_SIZE or not data[0] & _LONG_HEADER
            ):  # no Initial packet (RFC 9000, 14.1)
                return False
            self._address = address_key(addr[0])
            if not self._offers.knock(self._address):
                return False
        try:
            self.datagram_received(data, addr)
        except Exception as error:  # aioquic's, for malformed packets
            self._failed(error)
            if isinstance(path, DatagramPath):
                path.end()
        return path is not None

    def paths(self) -> set[DatagramPath]:
        """Return all connections."""
        return {path for path in self.connections() if isinstance(path, DatagramPath)}

    def end(self) -> None:
        """Close all connections."""
        for path in self.paths():
            path.end()
            path.cancel_timer()
        self.forget_connections()

    def _path(self, quic: Any, stream_handler: Any = None) -> DatagramPath:
        address = self._address
        return DatagramPath(quic, stream_handler, admit=lambda secret: self._admit(secret, address))


def _destination(data: bytes) -> bytes:
    """Return the destination connection identifier of a packet (RFC 9000, section 17)."""
    if len(data) > 6 and data[0] & _LONG_HEADER:
        return data[6 : 6 + data[5]]
    return data[1 : 1 + _CONNECTION_ID_BYTES]
