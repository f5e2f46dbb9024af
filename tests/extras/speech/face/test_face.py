"""A face over OSC: what VRCFaceTracking and strangers send, and what is left when nobody sends."""

from __future__ import annotations

import random
import socket
import struct
import time
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import pytest

from glsplat.data import default_avatar
from glsplat.errors import GlsplatError, ProtocolError
from glsplat.extras.speech.face import FORGET_S, HOLD_S, WEARER_TIMEOUT_S, FaceFeed, FaceListener, osc_messages
from glsplat.extras.speech.unified import PARAMETERS, gaze_of, parameter_of, weights_of
from glsplat.net.backends.tracking import TrackingSolver
from glsplat.net.messages import Decoder, Request
from glsplat.skinning.expression import ARKIT
from glsplat.tracking.calibration import Calibration
from glsplat.tracking.sample import Sample

FT = "/avatar/parameters/FT/v2/"


def padded(text: str) -> bytes:
    data = text.encode() + b"\0"
    return data + bytes(-len(data) % 4)


def message(address: str, *values: float | bool | int | str) -> bytes:
    tags, body = ",", b""
    for value in values:
        if isinstance(value, bool):
            tags += "TF"[not value]
        elif isinstance(value, str):
            tags, body = tags + "s", body + padded(value)
        elif isinstance(value, int):
            tags, body = tags + "i", body + struct.pack(">i", value)
        else:
            tags, body = tags + "f", body + struct.pack(">f", value)
    return padded(address) + padded(tags) + body


def bundle(*elements: bytes) -> bytes:
    return b"#bundle\0" + bytes(7) + b"\1" + b"".join(struct.pack(">i", len(e)) + e for e in elements)


def face_of(**values: float) -> dict[str, float]:
    feed = FaceFeed()
    for name, value in values.items():
        feed.receive(message(FT + name, value), 1.0)
    return dict(feed.face(1.0)[0])


def test_messages_and_bundles_are_read() -> None:
    packet = bundle(message("/a", 0.5), bundle(message("/b", "text", 3, True)), message("/c"))
    assert list(osc_messages(packet)) == [("/a", [0.5]), ("/b", [3.0, True]), ("/c", [])]
    blob = padded("/d") + padded(",bf") + struct.pack(">i", 3) + b"abc\0" + struct.pack(">f", 2.0)
    assert list(osc_messages(blob)) == [("/d", [2.0])]


@pytest.mark.parametrize(
    "packet",
    [
        *(b"", b"/", b"/a\0\0,f\0\0\0", b"a\0\0\0,\0\0\0", b"/\xff\0\0,\0\0\0", b"#bundle\0", b"\0" * 64),
        *(bundle(message("/a"))[:-2], bundle(b""), b"#bundle\0" + bytes(8) + b"\xff" * 4, padded("/a") + padded(",?")),
    ],
)
def test_what_is_no_osc_is_refused_or_says_nothing(packet: bytes) -> None:
    try:
        assert all(not arguments for _, arguments in osc_messages(packet))
    except ProtocolError as error:
        assert "\n" not in str(error)


def test_bundles_in_bundles_end() -> None:
    packet = message("/a", 1.0)
    for _ in range(200):
        packet = bundle(packet)
    with pytest.raises(ProtocolError, match="deeply"):
        list(osc_messages(packet))


@pytest.mark.parametrize(
    ("address", "name"),
    [
        (FT + "JawOpen", "JawOpen"),
        ("/avatar/parameters/v2/EyeLidLeft", "EyeLidLeft"),
        ("/avatar/parameters/mouthSmileLeft", "mouthSmileLeft"),
        ("/avatar/parameters/MouthSmileLeft", "MouthSmileLeft"),
        ("/avatar/parameters/Hat", None),
        ("/chatbox/input", None),
        ("/avatar/parameters/", None),
    ],
)
def test_addresses(address: str, name: str | None) -> None:
    assert parameter_of(address) == name


def test_single_and_combined_names_are_the_shapes_of_arkit() -> None:
    assert face_of(JawOpen=0.5, MouthClosed=0.25) == {"jawOpen": 0.5, "mouthClose": 0.25}
    assert face_of(JawX=-0.5) == {"jawLeft": 0.5, "jawRight": 0.0}
    assert face_of(EyeLidLeft=0.375) == pytest.approx({"eyeBlinkLeft": 0.5, "eyeWideLeft": 0.0})
    assert face_of(EyeLidRight=1.0) == pytest.approx({"eyeBlinkRight": 0.0, "eyeWideRight": 1.0})
    assert face_of(MouthCornerPullLeft=1, MouthCornerSlantLeft=0.5)["mouthSmileLeft"] == pytest.approx(0.9)
    lips = {f"LipFunnel{half}{side}": 0.25 for half in ("Upper", "Lower") for side in ("Left", "Right")}
    assert face_of(**lips)["mouthFunnel"] == pytest.approx(0.25)
    assert face_of(SmileFrown=-0.75)["mouthFrownRight"] == 0.75
    assert face_of(BrowExpressionLeft=-1)["browDownLeft"] == 1
    assert face_of(JawOpen=1.75)["jawOpen"] == 1
    assert face_of(mouthSmileLeft=0.25, MouthSmileLeft=0.75)["mouthSmileLeft"] == 0.25  # ARKit's own name is nearer


def test_each_shape_of_arkit_can_be_reached_by_unified_names() -> None:
    unified = {name: 0.6 for name in PARAMETERS - set(ARKIT)}
    gaze = {name for name in ARKIT if name.startswith("eyeLook")}
    assert set(weights_of(unified)) == set(ARKIT) - gaze  # these follow from where the eyes look


def test_gaze() -> None:
    assert gaze_of({"EyeLeftX": 0.25, "EyeLeftY": -0.5}, "Left") == (0.25, -0.5, -1.0)
    assert gaze_of({"EyeX": 0.25}, "Right") == (0.25, 0.0, -1.0)
    assert gaze_of({}, "Left") is None


def test_a_face_that_is_no_longer_tracked_relaxes_smoothly_and_is_gone() -> None:
    feed = FaceFeed()
    feed.receive(message(FT + "JawOpen", 1.0), 10.0)
    seen = [feed.face(10 + k / 90)[0].get("jawOpen", 0.0) for k in range(int(90 * (FORGET_S + 0.2)))]
    assert seen[int(90 * HOLD_S) - 1] == 1
    steps = [a - b for a, b in pairwise(seen)]
    assert min(steps) >= 0 and max(steps) < 0.05 and seen[-1] == 0
    assert max(seen[int(90 * (HOLD_S + 1.2)) :]) < 0.01


def test_a_sample_has_the_face_unless_it_says_its_own() -> None:
    feed, me, other = FaceFeed(), object(), object()
    feed.receive(bundle(message(FT + "JawOpen", 0.5), message(FT + "EyeLeftX", 0.25)), 0.0)
    sample = Sample(0.0, head=(0, 1.6, 0, 0, 0, 0, 1), expression={"jawOpen": 0.1, "cheekPuff": 0.2})
    mine = feed.worn(me, sample, 0.1)
    assert mine.expression == {"jawOpen": 0.1, "cheekPuff": 0.2} and mine.left_eye == (0.25, 0.0, -1.0)
    assert feed.worn(other, sample, 0.2) is sample, "one user at a time"
    feed.receive(message(FT + "JawOpen", 0.5), 1.0 + WEARER_TIMEOUT_S)
    assert feed.worn(other, Sample(0.0, head=sample.head), 0.2 + WEARER_TIMEOUT_S).expression == {"jawOpen": 0.5}
    assert feed.worn(me, sample, 0.3 + WEARER_TIMEOUT_S) is sample


def test_the_solver_of_a_server_wears_it() -> None:
    feed = FaceFeed()
    feed.receive(message(FT + "JawOpen", 0.75), 0.0)
    solver = TrackingSolver(default_avatar().skeleton, Calibration(), face=feed)
    request = Decoder().decode('{"v": 1, "frame_id": 1, "tracking": {"head": [0, 1.6, 0, 0, 0, 0, 1]}, "want": "pose"}')
    assert isinstance(request, Request)
    assert dict(solver.solve(request, 0.1).pose.expression) == {"jawOpen": 0.75}


@pytest.fixture
def listener() -> Iterator[FaceListener]:
    with FaceListener(FaceFeed(), 0) as listener:
        yield listener


def sent(listener: FaceListener, *packets: bytes) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for packet in packets:
            sender.sendto(packet, ("127.0.0.1", listener.port))


def until(true: object, timeout: float = 20.0) -> None:
    end = time.monotonic() + timeout
    while not true():  # type: ignore[operator]
        assert time.monotonic() < end
        time.sleep(0.01)


def hears(listener: FaceListener) -> bool:
    """Send a face again and tell whether it has arrived: of a flood the system drops some."""
    sent(listener, message(FT + "JawOpen", 0.5))
    return listener.feed.face(time.perf_counter())[0].get("jawOpen") == 0.5


def test_it_listens_on_this_machine_alone_and_a_port_that_is_taken_is_said(listener: FaceListener) -> None:
    assert listener._socket.getsockname()[0] == "127.0.0.1"
    sent(listener, message(FT + "JawOpen", 0.25))
    until(lambda: listener.feed.face(time.perf_counter())[0] == {"jawOpen": 0.25})
    with pytest.raises(GlsplatError, match="choose another"):
        FaceListener(FaceFeed(), listener.port)


@pytest.mark.check
def test_hostile_packets_do_no_harm(listener: FaceListener) -> None:
    """Random bytes, and good packets with flipped and cut parts."""
    chance = random.Random(36)
    good = bundle(*(message(FT + name, 0.5) for name in sorted(PARAMETERS)[:40]), message(FT + "JawOpen", float("nan")))
    feed = FaceFeed()
    for _ in range(3000):
        packet = bytearray(good if chance.random() < 0.8 else chance.randbytes(chance.randrange(300)))
        for _ in range(chance.randrange(6)):
            if packet:
                packet[chance.randrange(len(packet))] = chance.randrange(256)
        if chance.random() < 0.3:
            packet = packet[: chance.randrange(len(packet) + 1)]
        feed.receive(bytes(packet), 0.0)
        weights, values = feed.face(0.0)
        assert set(values) <= PARAMETERS and all(0 <= weight <= 1 for weight in weights.values())
    assert feed.malformed > 600
    for value in (float("inf"), float("-inf"), float("nan"), 3e38):
        feed.receive(message(FT + "TongueOut", value), 0.0)
    assert "TongueOut" not in feed.face(0.0)[1] or feed.face(0.0)[1]["TongueOut"] == 0.5
    sent(listener, *(chance.randbytes(900) for _ in range(300)), b"", bytes(60000))
    until(lambda: hears(listener))


@pytest.mark.check
def test_a_flood_does_not_take_a_core(listener: FaceListener) -> None:
    packet = bundle(*(message(f"{FT}{name}", 0.5) for name in sorted(PARAMETERS)[:100]))
    before, end = time.process_time(), time.monotonic() + 1.0
    own = time.thread_time()
    while time.monotonic() < end:
        sent(listener, packet)
        time.sleep(0.0005)
    spent = time.process_time() - before - (time.thread_time() - own)
    assert spent < 0.5


class Broken(socket.socket):
    """A socket of which nothing can be read until it is mended."""

    reads, mended = 0, False

    def recv(self, *args: Any) -> bytes:
        self.reads += 1
        if self.mended:
            return super().recv(*args)
        raise OSError(9, "Bad file descriptor")


def test_a_port_that_cannot_be_read_is_said_once_and_takes_no_core(caplog: pytest.LogCaptureFixture) -> None:
    listener = FaceListener(FaceFeed(), 0)
    broken = listener._socket = Broken(fileno=listener._socket.detach())
    with listener:
        until(lambda: broken.reads >= 2)
        began, before = time.monotonic(), broken.reads
        until(lambda: broken.reads >= before + 2)
        assert time.monotonic() - began > 0.15
        assert caplog.text.count("cannot be read (Bad file descriptor)") == 1
        broken.mended = True
        until(lambda: hears(listener))
