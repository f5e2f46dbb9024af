"""Attackers that send too much: frames and bytes that cost the server work before it knows what they ask for."""

from __future__ import annotations

import itertools
import threading

from tests.net.attacks.requests import request, stale, tracking
from tests.net.attacks.sockets import Attack, Target, again_and_again, frame, repeat, upgrade

__all__ = ["FLOODS"]


def flood(blob: bytes, a_second: float, first: bytes = b"") -> Attack:
    """The same bytes over and over, on a connection that begins with a legal request."""

    def visit(target: Target, number: int, stop: threading.Event) -> None:
        with upgrade(target, "?window=1") as sock:
            sock.sendall(first or frame(0x1, request(1, (64, 64))))
            repeat(sock, lambda: blob, a_second, stop)

    return again_and_again(visit)


def samples(target: Target, number: int, stop: threading.Event) -> None:
    """220 samples of head and full hands a second, below the documented rate; each is to be solved."""
    ids = itertools.count(1)

    def blob() -> bytes:
        out = b""
        for _ in range(11):
            i = next(ids)
            more = {"tracking": tracking(i), "t": i * 4.5, "eyes": None, "size": (16, 16)}
            out += frame(0x1, request(i, **more))
        return out

    with upgrade(target) as sock:
        repeat(sock, blob, 20, stop)


def time_leaps(target: Target, number: int, stop: threading.Event) -> None:
    """Samples whose clock runs backwards or by days, and a height of its own: the solver begins anew each time."""
    ids = itertools.count(1)

    def blob() -> bytes:
        out = b""
        for _ in range(10):
            i = next(ids)
            more = {"tracking": tracking(i), "t": (-1) ** i * i * 1e9, "eyes": None, "size": (16, 16)}
            out += frame(0x1, request(i, **more))
        return out

    with upgrade(target, "?height=0.5&window=8") as sock:
        repeat(sock, blob, 20, stop)


def always_newer(body: bytes, a_second: float) -> Attack:
    """A legal request of nearly 64 kB, never an old one, as often as messages are read."""

    def visit(target: Target, number: int, stop: threading.Event) -> None:
        ids = itertools.count(2)

        def blob() -> bytes:
            return frame(0x1, body.replace(b'"frame_id": 1,', b'"frame_id": %d,' % next(ids), 1))

        with upgrade(target, "?window=8") as sock:
            repeat(sock, blob, a_second, stop)

    return again_and_again(visit)


def permitted(target: Target, number: int, stop: threading.Event) -> None:
    """Nothing but legal requests in full poses, 230 a second: each one is read and checked, few are drawn."""
    ids = itertools.count(1)
    pose = {
        "root_pose": [0, 0.1, 0],
        "body_pose": [[0.1, 0, 0]] * 21,
        "lhand_pose": [0.1] * 45,
        "rhand_pose": [0.1] * 45,
    }

    def blob() -> bytes:
        return b"".join(frame(0x1, request(next(ids), (16, 16), pose=pose, ack=None)) for _ in range(10))

    with upgrade(target, "?window=1") as sock:
        repeat(sock, blob, 23, stop)


PING = frame(0x9, b"") * 1000
PONG = frame(0xA, b"") * 1000
EMPTY_PARTS = frame(0x0, b"", fin=False) * 1000
BEGUN = frame(0x1, request(1, (64, 64))) + frame(0x1, b"", fin=False)

FLOODS: dict[str, Attack] = {
    "pings": flood(PING, 170),  # 2 million in 12 s
    "pongs": flood(PONG, 170),
    "63 kB with an old frame_id": flood(frame(0x1, stale()), 230),
    "63 kB of empty objects": always_newer(stale(60_000, "{},").replace(b'"more": [', b'"note": ":", "more": ['), 230),
    "requests at the permitted rate": again_and_again(permitted),
    "empty continuations": flood(EMPTY_PARTS, 100, first=BEGUN),
    "tracking": again_and_again(samples),
    "tracking, leaps in time": again_and_again(time_leaps),
}
