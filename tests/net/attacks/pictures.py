"""Attackers that ask for pictures: each request is one that some honest client might send."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable

from tests.net.attacks.requests import collapsed, heap, pair, request, tracking
from tests.net.attacks.sockets import Attack, Target, abort, again_and_again, frame, repeat, upgrade

__all__ = ["PICTURES"]

LARGE = (2048, 2048)


def asking(
    make: Callable[[int, int], bytes],
    a_second: float = 20,
    query: str = "?window=8",
    read: bool = True,
    receive_buffer: int | None = None,
) -> Attack:
    """Requests ``make(frame_id, number of the connection)``, never acknowledged: the server draws what it can."""

    def visit(target: Target, number: int, stop: threading.Event) -> None:
        ids = itertools.count(1)
        with upgrade(target, query, receive_buffer=receive_buffer) as sock:
            repeat(sock, lambda: frame(0x1, make(next(ids), number)), a_second, stop, read)

    return again_and_again(visit)


def costly(frame_id: int, number: int) -> bytes:
    """The whole body in one heap, seen through a focal length of 40 image sizes."""
    y, z = heap()
    eyes = pair(*LARGE, focal=40.0, y=y, z=z + 2.0)
    return request(frame_id, LARGE, eyes=eyes, pose=collapsed(), quality=100, ack=None)


def close_up(frame_id: int, number: int) -> bytes:
    """The rest pose, an eye a hand's breadth from the chest: a full screen of an ordinary person."""
    eyes = pair(*LARGE, focal=1.0, y=1.2 + 0.01 * (frame_id % 10), z=0.3)
    return request(frame_id, LARGE, eyes=eyes, quality=100, ack=None)


def inside(frame_id: int, number: int) -> bytes:
    """An eye in the middle of the head, which looks through all of it."""
    return request(frame_id, LARGE, eyes=pair(*LARGE, focal=0.6, y=1.55, z=0.1), ack=None)


def of_many_sizes(frame_id: int, number: int) -> bytes:
    """Eight clients, 64^2 to 1536^2."""
    side = (64, 256, 512, 768, 1024, 1280, 1408, 1536)[number % 8]
    return request(frame_id, (side, side), ack=None)


def never_the_same_size(frame_id: int, number: int) -> bytes:
    """Targets of the sizes used last are kept: always ask for another one."""
    size = (1 + (frame_id * 397 + number * 31) % 2048, 1 + (frame_id * 571) % 2048)
    return request(frame_id, size, ack=None)


def specks(frame_id: int, number: int) -> bytes:
    """1 x 1 pixel: all that a picture costs besides its pixels, in another pose each time."""
    pose = {"root_pose": [0, frame_id % 60 / 10, 0], "body_pose": [[(frame_id % 3) / 10, 0, 0]] * 21}
    return request(frame_id, (1, 1), pose=pose, ack=None)


def noisy(frame_id: int, number: int) -> bytes:
    """What compresses worst, at quality 100, for a client that does not read."""
    return request(frame_id, LARGE, eyes=pair(*LARGE, focal=1.5, z=1.2), quality=100, ack=None)


def leaving(target: Target, number: int, stop: threading.Event) -> None:
    """Asks for a large picture, waits until it is being drawn or encoded, and is gone."""
    for i in itertools.count():
        if stop.is_set():
            return
        sock = upgrade(target, "?window=8")
        try:
            sock.sendall(frame(0x1, request(1, (1024, 1024), ack=None)) + frame(0x1, request(2, (1024, 1024))))
            stop.wait((0.0, 0.02, 0.1, 0.3)[i % 4])
        finally:
            abort(sock)


def undecided(frame_id: int, number: int) -> bytes:
    """A picture and a pose in turn, never acknowledged: each needs its sample solved, and none may overtake another."""
    more = {"want": "pose"} if frame_id % 2 else {"want": "picture", "size": (64, 64)}
    return request(frame_id, tracking=tracking(frame_id), t=frame_id * 10.0, ack=None, **more)


def poses_alone(frame_id: int, number: int) -> bytes:
    """What costs no picture, as often as messages are read."""
    return request(frame_id, want="pose", eyes=None, size=None, tracking=tracking(frame_id), t=frame_id * 4.4, ack=None)


def lying(frame_id: int, number: int) -> bytes:
    """Its pictures arrived at once, or never, or it is silent; it wants another size, quality and crop each time."""
    arrival = ({"age": 0}, {"age": 60_000, "held": 60_000}, {"age": 5, "held": 30_000}, None)[frame_id % 4]
    more = {"quality": 1 + frame_id % 100, "crop": frame_id % 3 == 0, "arrival": arrival}
    return request(frame_id, (64 + 64 * (frame_id % 5), 64), ack=0, **more)


def guessing(target: Target, number: int, stop: threading.Event) -> None:
    """Says that pictures arrive, and answers pings that were never sent, as often as control frames are read."""
    ids = itertools.count(1)

    def blob() -> bytes:
        frame_id = next(ids)
        pong = frame(0xA, frame_id.to_bytes(4 + 4 * (frame_id % 2), "big"))
        return frame(0x1, request(frame_id, (64, 64), ack=0, arrival={"age": 1})) + pong

    with upgrade(target, "?window=8") as sock:
        repeat(sock, blob, 19, stop)


def of_another_codec(frame_id: int, number: int) -> bytes:
    """Video, another codec, size and quality each time: what begins one anew is dear."""
    side = 512 + 2 * (frame_id % 7)
    video = {"codecs": [("vp9", "h264")[frame_id % 2]]}
    return request(frame_id, (side, side), video=video, quality=1 + frame_id % 100, ack=None)


def always_key(frame_id: int, number: int) -> bytes:
    """Video that its client can never go on from."""
    return request(frame_id, (1024, 1024), video={"codecs": ["h264"], "key": True}, ack=None)


def largest_video(frame_id: int, number: int) -> bytes:
    """As many pixels as are coded, with alpha, close up."""
    eyes = pair(2048, 1152, focal=1.0, y=1.2 + 0.01 * (frame_id % 10), z=0.3)
    return request(frame_id, (2048, 1152), eyes=eyes, video={"codecs": ["vp9"]}, alpha=True, quality=100, ack=None)


def deep(frame_id: int, number: int) -> bytes:
    """A speck of which it wants to know how far away it is: that takes longer than to draw it."""
    return request(frame_id, (1, 1), depth=True, ack=None)


PICTURES: dict[str, Attack] = {
    "pings answered that were not sent": again_and_again(guessing),
    "another codec each time, 100 a second": asking(of_another_codec, 100),
    "key frames without end": asking(always_key, 100),
    "the largest video": asking(largest_video, 20),
    "lies about what arrived, 100 a second": asking(lying, 100),
    "a picture, a pose, 100 a second": asking(undecided, 100),
    "poses, 230 a second": asking(poses_alone, 230),
    "collapsed body, 40 image sizes": asking(costly, 2),
    "close-ups, 2048^2": asking(close_up),
    "an eye inside the head, 2048^2": asking(inside),
    "64^2 to 1536^2": asking(of_many_sizes),
    "another size each time": asking(never_the_same_size),
    "specks of 1 x 1": asking(specks, 230),
    "depth of specks": asking(deep, 230),
    "does not read": asking(noisy, 20, read=False, receive_buffer=4096),
    "leaves while drawn": again_and_again(leaving),
}
