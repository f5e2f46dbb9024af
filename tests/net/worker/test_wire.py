"""The handshake and the messages between gateway and worker."""

from __future__ import annotations

import socket
import threading
from concurrent.futures import ThreadPoolExecutor

import msgspec
import numpy as np
import pytest

from glsplat.errors import BudgetError, ContextError, FormatError, GlsplatError, PoseError
from glsplat.net.backend import RenderJob
from glsplat.net.codec.encoded import Encoded, grid_of
from glsplat.net.messages import PictureOptions
from glsplat.net.room_view import RoomView, VisiblePerson
from glsplat.net.worker import wire
from glsplat.net.worker.wire import Kind, Reader, RenderResult, WorkerLostError, Writer, greet, pack
from glsplat.skinning.pose import Pose
from tests.extras.workers.fakes import camera


def meet(ours: bytes, theirs: bytes) -> list[object]:
    """Shake hands with these secrets; return what either side comes to, the gateway's first."""
    ends = socket.socketpair()

    def side(index: int, secret: bytes) -> object:
        with ends[index] as end:
            end.settimeout(60)
            try:
                return greet(end, secret, worker=bool(index))
            except (GlsplatError, EOFError, OSError) as error:
                return error

    with ThreadPoolExecutor() as threads:
        return list(threads.map(side, (0, 1), (ours, theirs)))


def test_only_who_knows_the_secret_is_let_in():
    one, other = meet(b"s" * 32, b"s" * 32), meet(b"s" * 32, b"s" * 32)
    assert one[0] == one[1] and len(one[0]) == 32
    assert one[0] != other[0]  # a key a connection
    gateway, worker = meet(b"s" * 32, b"t" * 32)
    assert isinstance(worker, GlsplatError) and "do not have the same secret" in str(worker)
    assert isinstance(gateway, (EOFError, ConnectionError))


def test_what_was_said_cannot_be_said_back():
    ours, theirs = socket.socketpair()
    ours.settimeout(60)
    theirs.settimeout(60)
    with ours, theirs:
        echo = threading.Thread(target=lambda: [theirs.sendall(theirs.recv(4096)) for _ in range(2)])
        echo.start()
        with pytest.raises(GlsplatError, match="do not have the same secret"):
            greet(ours, b"s" * 32, worker=False)
        echo.join()
        ours.sendall(b"HTTP/1.1 200 OK".ljust(48))
        with pytest.raises(GlsplatError, match="not a glsplat worker"):
            greet(theirs, b"s" * 32, worker=False)


def messages(count: int) -> list[bytes]:
    writer = Writer(b"k" * 32)
    request = RenderJob(frame_id=7, cameras=(camera(3),), options=PictureOptions(quality=61), avatar="ann")
    return [writer.pack(Kind.DRAW, number, request) for number in range(1, count + 1)]


def read(data: bytes, count: int = 1) -> list[tuple]:
    ours, theirs = socket.socketpair()
    with ours, theirs:
        ours.sendall(data)
        ours.shutdown(socket.SHUT_WR)
        reader = Reader(theirs, b"k" * 32)
        return [reader.receive() for _ in range(count)]


def test_a_room_of_people_with_the_longest_expressions_arrives():
    """64 people are the most in a room, and a message of 64 KiB holds 256 names."""
    faces = [{f"{key:02d}{number:03d}".ljust(64, "n"): 0.5 for number in range(256)} for key in range(64)]
    poses = [Pose(np.zeros((55, 3)), expression=face) for face in faces]
    people = tuple(VisiblePerson(key, "", "ann", pose, np.eye(4)) for key, pose in enumerate(poses))
    data = Writer(b"k" * 32).pack(Kind.DRAW, 1, RenderJob(cameras=(camera(3),), room=RoomView("lab", 0, 0, people)))
    ours, theirs = socket.socketpair()
    with ours, theirs, ThreadPoolExecutor() as threads:
        threads.submit(ours.sendall, data)
        _, _, found = Reader(theirs, b"k" * 32).receive()
    assert len(data) > 2**20 and found.room.people[63].pose.expression == faces[63]


@pytest.mark.parametrize(
    "change",
    [
        lambda a, b: bytes([*a[:20], a[20] ^ 1, *a[21:]]),  # the pickle
        lambda a, b: bytes([*a[:5], a[5] ^ 1, *a[6:]]),  # the number
        lambda a, b: b,  # out of order
        lambda a, b: Writer(b"x" * 32).pack(Kind.PING),
    ],
)
def test_what_the_gateway_did_not_send_is_not_looked_at(change, monkeypatch):
    monkeypatch.setattr(wire.pickle, "loads", lambda body: pytest.fail("it was read"))
    with pytest.raises(GlsplatError, match="its gateway did not send"):
        read(change(*messages(2)))


def test_a_message_that_is_repeated_or_too_long_is_refused():
    first, second = messages(2)
    (_, one, _), (kind, two, request) = read(first + second, 2)
    assert (kind, one, two) == (Kind.DRAW, 1, 2)
    assert (request.frame_id, request.options.quality, request.avatar) == (7, 61, "ann")
    with pytest.raises(GlsplatError, match="its gateway did not send"):
        read(first + first, 2)
    with pytest.raises(GlsplatError, match="at most 16777216 bytes, not 20000000"):
        read(wire.HEAD.pack(20_000_000, 1, 1))
    with pytest.raises(EOFError):
        read(first[:-1])


def test_answers():
    drawn = RenderResult(2, {"sort": 1.5}, (0, 16, 32, 48), (0, 1), False, 3, {"box": [0.0] * 6})
    deep = RenderResult(2, {}, None, (), True, 0, {}, (grid_of(np.linspace(0.2, 3, 6).reshape(2, 3)),) * 2)
    for one in (drawn, deep):
        assert wire.read_result(pack(Kind.DRAWN, 5, one)[wire.HEAD.size :]) == one
    encoded = Encoded([b"left", b"right"], [(0, 16, 32, 48)] * 2, 1.25, [b"l", b"r"])
    assert wire.read_encoded(pack(Kind.ENCODED, 5, encoded)[wire.HEAD.size :]) == encoded
    assert pack(Kind.OPENED, 0, "llvmpipe")[wire.HEAD.size :] == b"llvmpipe"
    with pytest.raises(msgspec.MsgspecError):
        wire.read_result(b"\x93\x01\x02")


@pytest.mark.parametrize(
    ("error", "back"),
    [
        (PoseError("no such joint"), PoseError),
        (BudgetError("covers 1e12 pixels", "too_slow"), BudgetError),
        (FormatError("ann.glb: broken"), FormatError),
        (FileNotFoundError(2, "No such file"), FormatError),  # an avatar that is not on that machine
        (ContextError("no EGL"), ContextError),
        (WorkerLostError("gone"), WorkerLostError),
        (ZeroDivisionError("in a renderer"), RuntimeError),
    ],
)
def test_errors(error, back):
    found = wire.error_of(wire.read_failed(pack(Kind.FAILED, 1, wire.failure_of(error))[wire.HEAD.size :]))
    assert type(found) is back and str(error) in str(found)
    assert getattr(found, "code", None) == getattr(error, "code", None)
