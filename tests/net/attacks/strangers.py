"""Strangers at the UDP port of a server that offers datagrams: packets of nobody, as many as they like."""

from __future__ import annotations

import os
import socket
import threading
import time
from collections.abc import Callable, Sequence
from functools import cache

from tests.net.attacks.sockets import CHEAP, Attack, Target

__all__ = ["STRANGERS"]


def noise(nbytes: int) -> Callable[[], bytes]:
    """Random bytes, another packet each time."""
    return lambda: os.urandom(nbytes)


def initial(token: int = 0) -> Callable[[], bytes]:
    """What looks like the first packet of a connection (RFC 9000, 17.2.2), with a made-up token of so many bytes."""

    def packet() -> bytes:
        head = b"\xc0\0\0\0\1\x08" + os.urandom(8) + b"\x08" + os.urandom(8) + bytes([token]) + os.urandom(token)
        rest = 1200 - len(head) - 2
        return head + (0x4000 | rest).to_bytes(2, "big") + os.urandom(rest)

    return packet


@cache
def recorded() -> Sequence[bytes]:
    """The first packets of a real client, as somebody on its way would have them."""
    from aioquic.quic.configuration import QuicConfiguration  # here: not everybody who attacks has it
    from aioquic.quic.connection import QuicConnection

    client = QuicConnection(configuration=QuicConfiguration(alpn_protocols=["h3"], server_name="localhost"))
    client.connect(("127.0.0.1", 1), now=0.0)
    return [data for data, _ in client.datagrams_to_send(now=0.0)]


def replayed() -> bytes:
    """The first of them again."""
    return recorded()[0]


def strangers(kinds: Sequence[Callable[[], bytes]], a_second: float) -> Attack:
    """Each connection another kind of packets, so many a second, from one port."""

    def attack(target: Target, number: int, stop: threading.Event) -> None:
        packet, start, sent = kinds[number % len(kinds)], time.monotonic(), 0
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
            sock.bind((target.source, 0))
            while not stop.is_set():
                due = min(int((time.monotonic() - start) * a_second) + 1 - sent, 1000)
                data = packet()  # of one burst all alike: making them up is not to be the load
                for _ in range(due):
                    sock.sendto(data, (target.host, target.port))
                sent += due
                stop.wait(max(CHEAP, 1 / a_second))

    return attack


KINDS = [noise(60), noise(1200), replayed, initial(token=60)]

STRANGERS: dict[str, Attack] = {
    "datagrams of strangers": strangers(KINDS, 5000),
    "datagrams of strangers, 800 a second": strangers(KINDS, 200),
}
