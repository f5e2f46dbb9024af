"""Congestion window of a path of pictures, and the packets lost on it.

link_control.py decides how much is sent: at most one and a half pictures wait, and two clients share a link equally.
aioquic's own controllers halve their window for every lost packet, as TCP does: with 1 % lost and 60 ms they would pass
2 Mbit/s of 20. So this window is BBR's, twice what the link holds at the measured rate (Cardwell et al., ACM Queue
14(5), 2016), plus one picture. After losses over three probe timeouts it falls to the minimum (RFC 9002, section 7.6).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

from glsplat.extras.far_links.datagrams.aioquic_internals import (
    K_MINIMUM_WINDOW,
    QuicCongestionControl,
    QuicSentPacket,
    register_congestion_control,
)

NAME = "glsplat"
"""Name of the window in a QuicConfiguration."""
_GAIN = 2.0
_MIN_PACKETS = 32
_MAX_BITS_PER_S = 200e6
_LOSS_PACKETS = 2000.0  # over which the loss is averaged
_LOST_NUMBERS = 512  # lost packets whose numbers are kept
_PRIOR_LOSS, _PRIOR_PACKETS = 0.005, 200.0  # before any packet was sent


class PictureWindow(QuicCongestionControl):
    """A congestion window that ``allow`` sets from the link's rate."""

    def __init__(self, *, max_datagram_size: int) -> None:
        super().__init__(max_datagram_size=max_datagram_size)
        self.newest: int = -1  # number of the last packet sent
        self.trip: float = 0.1  # smoothed round trip, seconds
        self._size = max_datagram_size
        self._outstanding: dict[int, None] = {}  # packets of pictures, oldest first
        self._lost_numbers: deque[int] = deque(maxlen=_LOST_NUMBERS)
        self._lost, self._sent = _PRIOR_LOSS * _PRIOR_PACKETS, _PRIOR_PACKETS

    @property
    def loss(self) -> float:
        """Lost share of the packets."""
        return self._lost / self._sent

    def allow(self, rate: float, nbytes: int) -> None:
        """Set the window for a link of ``rate`` bits a second and a next picture of ``nbytes``."""
        held = min(rate, _MAX_BITS_PER_S) / 8 * self.trip
        self.congestion_window = round(max(_MIN_PACKETS * self._size, _GAIN * held + nbytes))

    def settled(self, number: int) -> bool:
        """Return whether packet ``number`` and all before it are known to have arrived or to be lost."""
        return next(iter(self._outstanding), number + 1) > number

    def lost_of(self, first: int, last: int) -> int:
        """Return the number of packets from ``first`` to ``last`` that are known to be lost."""
        return sum(first <= number <= last for number in self._lost_numbers)

    def on_packet_sent(self, *, packet: QuicSentPacket) -> None:
        """Count a packet that aioquic has sent."""
        self.bytes_in_flight += packet.sent_bytes
        self.newest = packet.packet_number
        self._outstanding[packet.packet_number] = None

    def on_packet_acked(self, *, now: float, packet: QuicSentPacket) -> None:
        """Count a packet that has arrived."""
        self._end(packet)
        self._count(0.0)

    def on_packets_lost(self, *, now: float, packets: Iterable[QuicSentPacket]) -> None:
        """Count packets that were lost: later ones have arrived."""
        for packet in packets:
            self._end(packet)
            self._lost_numbers.append(packet.packet_number)
            self._count(1.0)

    def on_packets_expired(self, *, packets: Iterable[QuicSentPacket]) -> None:
        """Forget packets that no longer matter."""
        for packet in packets:
            self._end(packet)

    def on_persistent_congestion(self) -> None:
        """Reduce the window to the minimum, until the next ``allow``."""
        self.congestion_window = K_MINIMUM_WINDOW * self._size

    def on_rtt_measurement(self, *, now: float, rtt: float) -> None:
        """Smooth the round trip of one packet into ``trip``."""
        self.trip += (rtt - self.trip) / 8

    def _end(self, packet: QuicSentPacket) -> None:
        self.bytes_in_flight -= packet.sent_bytes
        self._outstanding.pop(packet.packet_number, None)

    def _count(self, lost: float) -> None:
        self._lost, self._sent = self._lost + lost, self._sent + 1
        if self._sent > _LOSS_PACKETS:
            self._lost, self._sent = self._lost / 2, self._sent / 2


register_congestion_control(NAME, PictureWindow)
