"""The UDP port of a server: who comes without a client's invitation is not answered, whatever they send."""

from __future__ import annotations

import asyncio
import base64
import socket
from collections import Counter
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Any

from aioquic.asyncio.server import QuicServer
from aioquic.h3.connection import H3_ALPN
from aioquic.quic.configuration import QuicConfiguration
from cryptography.hazmat.primitives import hashes

from glsplat.errors import GlsplatError
from glsplat.net.datagrams.congestion import NAME
from glsplat.net.datagrams.offers import Offers
from glsplat.net.datagrams.path import DatagramPath
from glsplat.net.datagrams.way import PathUser
from glsplat.net.guard.certificate import passing_certificate
from glsplat.net.guard.limits import address_key

__all__ = ["DatagramListener"]

_LASTS, _RENEWED = timedelta(days=12), timedelta(days=5)  # from now on; browsers take 14 days, of which one lies behind
_IDLE = 30.0  # seconds without a packet
_STREAM = 16 * 1024  # bytes of a client's stream: a CONNECT and its settings
_EACH = 2  # connections of which nobody knows yet whose they are, for each client that is expected from an address
_CID = 8


class DatagramListener:
    """Listens for those that ``offer`` was made to. ``refused`` counts connections that named no such secret."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self.refused = 0
        self._offers: Offers[PathUser] = Offers(clock)
        self._configuration = QuicConfiguration(
            alpn_protocols=H3_ALPN,
            is_client=False,
            congestion_control_algorithm=NAME,
            idle_timeout=_IDLE,
            max_data=4 * _STREAM,
            max_stream_data=_STREAM,
            max_datagram_frame_size=65536,
            connection_id_length=_CID,
        )
        self._made = datetime.min.replace(tzinfo=UTC)
        self._sha256 = ""
        self._server: _Guarded | None = None

    async def open(self, host: str, port: int) -> None:
        """Listen. Raises GlsplatError (port in use)."""
        self._renew()
        loop = asyncio.get_running_loop()
        listening = _bind(host, port)
        _, self._server = await loop.create_datagram_endpoint(
            lambda: _Guarded(self._configuration, self._offers, self._admit), sock=listening
        )

    def offer(self, address: str, user: PathUser) -> dict[str, str]:
        """What a client is told: where it may connect once, and by what certificate it knows the server."""
        self._renew()
        return {"path": f"datagrams/{self._offers.make(address, user)}", "sha256": self._sha256}

    def withdraw(self, user: PathUser) -> None:
        """The client has left."""
        self._offers.withdraw(user)

    async def close(self) -> None:
        """Close all connections and the port."""
        if self._server is not None:
            self._server.end()
            self._server = None

    def status(self) -> dict[str, int]:
        """Numbers for /stats."""
        paths = [] if self._server is None else self._server.paths()
        return {"open": sum(path.accepted for path in paths), "refused": self.refused}

    def _admit(self, secret: str, address: str) -> PathUser | None:
        user = self._offers.take(secret, address)
        self.refused += user is None
        return user

    def _renew(self) -> None:
        now = datetime.now(UTC)
        if now - self._made < _RENEWED:
            return
        certificate, key = passing_certificate(_LASTS)
        self._configuration.certificate, self._configuration.private_key = certificate, key
        self._sha256 = base64.b64encode(certificate.fingerprint(hashes.SHA256())).decode()
        self._made = now


class _Guarded(QuicServer):
    """aioquic's server behind a look at who is expected: others cost it a look into a table."""

    def __init__(
        self,
        configuration: QuicConfiguration,
        offers: Offers[PathUser],
        admit: Callable[[str, str], PathUser | None],
    ) -> None:
        super().__init__(configuration=configuration, create_protocol=self._path, retry=True)
        self._offers, self._admit = offers, admit
        self._address = ""  # of the datagram in hand

    def datagram_received(self, data: bytes | str, addr: Any) -> None:
        """A UDP datagram: of a connection that there is, or of an address from which one is expected."""
        assert isinstance(data, bytes)
        if _destination(data) not in self._protocols:
            self._address = address_key(addr[0])
            waiting = Counter(path.address for path in self.paths() if not path.accepted)
            expected = self._offers.expected()[self._address]
            if waiting[self._address] >= _EACH * expected:
                return
        super().datagram_received(data, addr)

    def paths(self) -> set[DatagramPath]:
        """All connections."""
        return {path for path in self._protocols.values() if isinstance(path, DatagramPath)}

    def end(self) -> None:
        """Close all, and the port."""
        for path in self.paths():
            path.end()
        self._protocols.clear()
        if self._transport is not None:
            self._transport.close()

    def _path(self, quic: Any, stream_handler: Any = None) -> DatagramPath:
        address = self._address
        return DatagramPath(quic, stream_handler, admit=lambda secret: self._admit(secret, address), address=address)


def _destination(data: bytes) -> bytes:
    """The connection that a packet is for (RFC 9000, section 17)."""
    if len(data) > 6 and data[0] & 0x80:
        return data[6 : 6 + data[5]]
    return data[1 : 1 + _CID]


def _bind(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listening = socket.socket(family, socket.SOCK_DGRAM)
    try:
        listening.bind((host, port))
    except OSError as error:
        listening.close()
        reason = error.strerror or str(error)
        raise GlsplatError(
            f"cannot listen on {host} UDP port {port} ({reason}); choose another --port, or leave --webtransport out"
        ) from None
    listening.setblocking(False)
    return listening
