"""What QUIC may have under way on a path of pictures, and what it lost there.

How much is sent is decided before (pace/link_control.py: one picture and a half wait at most, two clients of one link
come to equal parts). aioquic's own controllers halve their window for every lost packet, as TCP does: with one in a
hundred lost and 60 ms they would let through 2 Mbit/s of 20. So the window here is BBR's, twice what the link holds at
the rate that was found (Cardwell et al., ACM Queue 14(5), 2016), and one picture; where packets of three probe
timeouts in a row are lost, it falls to the least (RFC 9002, section 7.6).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

from aioquic.quic.congestion.base import K_MINIMUM_WINDOW, QuicCongestionControl, register_congestion_control
from aioquic.quic.packet_builder import QuicSentPacket
from aioquic.quic.recovery import QuicPacketPacer

__all__ = ["NAME", "PicturePacer", "PictureWindow"]

NAME = "glsplat"
"""What a QuicConfiguration calls it."""
_GAIN = 2.0
_FEWEST = 32  # packets
_AT_ONCE = 64  # packets: a picture of 70 kB; there is room for as many before most links
_FASTEST = 200e6  # bits a second
_REMEMBERED = 2000.0  # packets of which the share that is lost is taken
_GONE = 512  # lost packets that are remembered
_BEFORE = 0.005, 200.0  # lost of so many packets, before anything is known


class PictureWindow(QuicCongestionControl):
    """``allow`` says what the link takes."""

    def __init__(self, *, max_datagram_size: int) -> None:
        super().__init__(max_datagram_size=max_datagram_size)
        self.newest: int = -1  # number of the packet sent last
        self.trip: float = 0.1  # seconds there and back, lately
        self._size = max_datagram_size
        self._outstanding: dict[int, None] = {}  # packets of pictures, oldest first
        self._gone: deque[int] = deque(maxlen=_GONE)  # numbers of packets that were lost
        self._lost, self._sent = _BEFORE[0] * _BEFORE[1], _BEFORE[1]

    @property
    def loss(self) -> float:
        """Share of the packets that is lost."""
        return self._lost / self._sent

    def allow(self, rate: float, nbytes: int) -> None:
        """The link takes ``rate`` bits a second; a picture of so many bytes is next."""
        held = min(rate, _FASTEST) / 8 * self.trip
        self.congestion_window = round(max(_FEWEST * self._size, _GAIN * held + nbytes))

    def settled(self, number: int) -> bool:
        """Whether it is known of that packet and all before whether they arrived."""
        return next(iter(self._outstanding), number + 1) > number

    def lost_of(self, first: int, last: int) -> int:
        """How many of those packets, both included, are known to be lost."""
        return sum(first <= number <= last for number in self._gone)

    def on_packet_sent(self, *, packet: QuicSentPacket) -> None:
        """aioquic gave it to the socket."""
        self.bytes_in_flight += packet.sent_bytes
        self.newest = packet.packet_number
        self._outstanding[packet.packet_number] = None

    def on_packet_acked(self, *, now: float, packet: QuicSentPacket) -> None:
        """It arrived."""
        self._end(packet)
        self._count(0.0)

    def on_packets_lost(self, *, now: float, packets: Iterable[QuicSentPacket]) -> None:
        """Later ones arrived, these did not."""
        for packet in packets:
            self._end(packet)
            self._gone.append(packet.packet_number)
            self._count(1.0)

    def on_packets_expired(self, *, packets: Iterable[QuicSentPacket]) -> None:
        """Nobody asks for them any more."""
        for packet in packets:
            self._end(packet)

    def on_persistent_congestion(self) -> None:
        """Nothing arrives: the least, until something is allowed anew."""
        self.congestion_window = K_MINIMUM_WINDOW * self._size

    def on_rtt_measurement(self, *, now: float, rtt: float) -> None:
        """The time there and back of one packet."""
        self.trip += (rtt - self.trip) / 8

    def _end(self, packet: QuicSentPacket) -> None:
        self.bytes_in_flight -= packet.sent_bytes
        self._outstanding.pop(packet.packet_number, None)

    def _count(self, lost: float) -> None:
        self._lost, self._sent = self._lost + lost, self._sent + 1
        if self._sent > _REMEMBERED:
            self._lost, self._sent = self._lost / 2, self._sent / 2


class PicturePacer(QuicPacketPacer):
    """Lets a picture go at once, as TCP does after a pause: each piece that waits for a timer waits for a busy loop."""

    def update_rate(self, congestion_window: int, smoothed_rtt: float) -> None:
        """The window is spread over a round trip, but for a burst."""
        super().update_rate(congestion_window, smoothed_rtt)
        assert self.packet_time is not None
        self.bucket_max = max(self.bucket_max, _AT_ONCE * self.packet_time)


register_congestion_control(NAME, PictureWindow)
