"""The only module that touches undocumented parts of aioquic: those of version 1.7.

Importing it raises GlsplatError, in one line, if the installed version lacks a part.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from importlib.metadata import version
from typing import Any

from glsplat.errors import GlsplatError

PACKAGE = "aioquic>=1.7.2,<1.8"
"""The requirement, as in pyproject.toml."""


def _unsupported(part: str) -> GlsplatError:
    return GlsplatError(
        f"WebTransport expects aioquic 1.7 with {part}, got version {version('aioquic')}: "
        f"pip install '{PACKAGE}', or leave webtransport out"
    )


try:
    from aioquic.asyncio.protocol import QuicConnectionProtocol
    from aioquic.asyncio.server import QuicServer
    from aioquic.quic.configuration import SMALLEST_MAX_DATAGRAM_SIZE
    from aioquic.quic.congestion.base import K_MINIMUM_WINDOW, QuicCongestionControl, register_congestion_control
    from aioquic.quic.connection import QuicConnection
    from aioquic.quic.packet_builder import QuicSentPacket
    from aioquic.quic.recovery import QuicPacketPacer, QuicPacketRecovery
except ImportError as error:
    raise _unsupported(f"{error.name}: {error.msg}") from None

__all__ = [
    "K_MINIMUM_WINDOW",
    "PACKAGE",
    "SMALLEST_MAX_DATAGRAM_SIZE",
    "BurstPacer",
    "ConnectionProtocol",
    "ConnectionServer",
    "QuicCongestionControl",
    "QuicSentPacket",
    "register_congestion_control",
]

_PARTS: dict[type, tuple[str, ...]] = {
    QuicConnection: ("_datagrams_pending", "_loss"),
    QuicConnectionProtocol: ("_loop", "_quic", "_timer", "datagram_received", "transmit"),
    QuicServer: ("_protocols", "connection_made", "datagram_received"),
    QuicPacketRecovery: ("_cc", "_pacer"),
    QuicPacketPacer: ("bucket_max", "packet_time", "update_rate"),
    QuicSentPacket: ("packet_number", "sent_bytes"),
    QuicCongestionControl: (
        *("bytes_in_flight", "congestion_window", "on_packet_acked", "on_packet_sent", "on_packets_expired"),
        *("on_packets_lost", "on_persistent_congestion", "on_rtt_measurement"),
    ),
}


def _check() -> None:
    """Raise GlsplatError for the first part that the installed aioquic lacks."""
    for owner, names in _PARTS.items():
        code: Any = getattr(vars(owner).get("__init__"), "__code__", None)
        assigned = () if code is None else (*code.co_names, *code.co_varnames)
        for name in names:
            if name not in assigned and not hasattr(owner, name):
                raise _unsupported(f"{owner.__name__}.{name}")


_check()

_BURST_PACKETS = 64  # a picture of 70 kB; queues before most links hold as many


class BurstPacer(QuicPacketPacer):
    """Sends a picture at once, as TCP does after a pause: a packet's timer would wait for a busy loop."""

    def update_rate(self, congestion_window: int, smoothed_rtt: float) -> None:
        """Spread the window over a round trip, except for a burst."""
        super().update_rate(congestion_window, smoothed_rtt)
        assert self.packet_time is not None
        self.bucket_max = max(self.bucket_max, _BURST_PACKETS * self.packet_time)


class ConnectionProtocol(QuicConnectionProtocol):
    """One QUIC connection, paced by ``BurstPacer``."""

    def __init__(self, quic: QuicConnection, stream_handler: Any = None) -> None:
        super().__init__(quic, stream_handler)
        self.quic: QuicConnection = quic
        self.loop: asyncio.AbstractEventLoop = self._loop
        self.congestion_control: QuicCongestionControl = quic._loss._cc
        quic._loss._pacer = BurstPacer(max_datagram_size=quic.configuration.max_datagram_size)

    @property
    def has_unsent(self) -> bool:
        """Whether datagrams wait to be sent."""
        return bool(self.quic._datagrams_pending)

    def drop_unsent(self) -> None:
        """Drop the datagrams that wait to be sent."""
        self.quic._datagrams_pending.clear()

    def cancel_timer(self) -> None:
        """Send nothing any more, not even QUIC's answers to a closed connection."""
        if self._timer is not None:
            self._timer.cancel()


class ConnectionServer(QuicServer):
    """A QUIC server that finds connections by their identifiers and validates addresses by retry packets."""

    def __init__(self, configuration: Any, create_protocol: Callable[..., QuicConnectionProtocol]) -> None:
        super().__init__(configuration=configuration, create_protocol=create_protocol, retry=True)

    def connection(self, identifier: bytes) -> QuicConnectionProtocol | None:
        """Return the connection with that identifier; None if there is none."""
        return self._protocols.get(identifier)

    def connections(self) -> set[QuicConnectionProtocol]:
        """Return all connections."""
        return set(self._protocols.values())

    def forget_connections(self) -> None:
        """Drop all connections without closing them."""
        self._protocols.clear()
