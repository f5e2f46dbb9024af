"""Faces tracked by another program on this machine and sent as OSC over UDP (docs/speech.md).

OSC is parsed here ("The Open Sound Control 1.0 Specification", Wright 2002): a library would add a server and a
dispatcher that prints tracebacks for malformed packets.
"""

from __future__ import annotations

import logging
import socket
import struct
import threading
import time
from collections.abc import Iterator, Mapping
from dataclasses import replace
from math import exp
from threading import Lock
from typing import Self

from glsplat.errors import GlsplatError, ProtocolError
from glsplat.extras.speech.unified import gaze_of, parameter_of, weights_of
from glsplat.tracking.sample import Sample

Argument = float | bool

MAX_DEPTH = 4  # of nested bundles
_SIZES = {"i": 4, "f": 4, "d": 8, "h": 8, "t": 8, "c": 4, "r": 4, "m": 4}
_NUMBERS = {"i": ">i", "f": ">f", "d": ">d", "h": ">q"}
_BOOLS = {"T": True, "F": False}


def osc_messages(packet: bytes, depth: int = 0) -> Iterator[tuple[str, list[Argument]]]:
    """Yield the address, and the numbers and booleans among the arguments, of each message in a packet.

    Raises ProtocolError at the first malformed message.
    """
    if not packet.startswith(b"#bundle\0"):
        yield _message(packet)
        return
    if depth == MAX_DEPTH:
        raise ProtocolError("an OSC bundle that is nested too deeply")
    position = 16  # behind the time tag, which is ignored
    while position < len(packet):
        size = int.from_bytes(packet[position : position + 4], "big")
        position += 4
        if not 0 < size <= len(packet) - position:
            raise ProtocolError("an OSC bundle that ends early")
        yield from osc_messages(packet[position : position + size], depth + 1)
        position += size


def _message(packet: bytes) -> tuple[str, list[Argument]]:
    address, position = _text(packet, 0)
    if not address.startswith("/"):
        raise ProtocolError("an OSC message whose address does not begin with /")
    tags, position = _text(packet, position)
    arguments: list[Argument] = []
    for tag in tags.removeprefix(","):
        if tag in _BOOLS:
            arguments.append(_BOOLS[tag])
        elif tag in _SIZES:
            if position + _SIZES[tag] > len(packet):
                raise ProtocolError("an OSC message that ends early")
            if tag in _NUMBERS:
                arguments.append(float(struct.unpack_from(_NUMBERS[tag], packet, position)[0]))
            position += _SIZES[tag]
        elif tag in "sS":
            _, position = _text(packet, position)
        elif tag == "b":
            position += 4 + (int.from_bytes(packet[position : position + 4], "big") + 3) // 4 * 4
        elif tag not in "NI[]":
            raise ProtocolError("an OSC message with an argument of a type that the specification does not have")
    return address, arguments


def _text(packet: bytes, position: int) -> tuple[str, int]:
    """Return a string of ASCII and the next position, a multiple of four bytes."""
    end = packet.find(b"\0", position)
    if end < 0:
        raise ProtocolError("an OSC string without an end")
    try:
        return packet[position:end].decode("ascii"), (end // 4 + 1) * 4
    except UnicodeDecodeError:
        raise ProtocolError("an OSC string that is not ASCII") from None


HOLD_S = 0.5  # time without a packet for which the face keeps its shape ...
RELAX_S = 0.25  # ... and the time constant of its relaxation afterwards
FORGET_S = 3.0  # time without a packet after which all values are dropped
WEARER_TIMEOUT_S = 2.0  # time without a sample of the wearer after which another user may have the face
_MAX_VALUE = 2.0  # of a parameter; larger ones are invalid


class FaceFeed:
    """One face, worn by one user at a time: the first one, until no samples came for WEARER_TIMEOUT_S. Thread-safe."""

    def __init__(self) -> None:
        self.malformed = 0  # packets
        self._values: dict[str, float] = {}  # by parameter; bounded by the known names
        self._received = float("-inf")
        self._wearer: object = None
        self._worn_at = float("-inf")
        self._lock = Lock()

    def receive(self, packet: bytes, now: float) -> None:
        """Read a packet. Malformed ones are counted, unknown parameters ignored."""
        try:
            for address, arguments in osc_messages(packet):
                name = parameter_of(address)
                value = float(arguments[0]) if name is not None and arguments else None
                if name is not None and value is not None and abs(value) <= _MAX_VALUE:  # NaN fails this
                    with self._lock:
                        self._values[name] = value
                        self._received = now
        except ProtocolError:
            self.malformed += 1

    def face(self, now: float) -> tuple[Mapping[str, float], Mapping[str, float]]:
        """Return the weights of ARKit's shapes and their parameters; both empty without a tracked face."""
        with self._lock:
            age = now - self._received
            if age > FORGET_S:
                self._values.clear()
            values = dict(self._values)
        rest = exp(-max(0.0, age - HOLD_S) / RELAX_S)
        return {name: weight * rest for name, weight in weights_of(values).items()}, values if age <= HOLD_S else {}

    def worn(self, wearer: object, sample: Sample, now: float) -> Sample:
        """Return a user's sample with the face, if the user wears it; the sample's own values take precedence."""
        with self._lock:
            if wearer is not self._wearer and now - self._worn_at < WEARER_TIMEOUT_S:
                return sample
            self._wearer, self._worn_at = wearer, now
        weights, values = self.face(now)
        if not weights:
            return sample
        left, right = (gaze_of(values, side) for side in ("Left", "Right"))
        return replace(
            sample,
            expression={**weights, **(sample.expression or {})},
            left_eye=left if sample.left_eye is None else sample.left_eye,
            right_eye=right if sample.right_eye is None else sample.right_eye,
        )


log: logging.Logger = logging.getLogger("glsplat.net")

_HOST = "127.0.0.1"
MAX_PACKET_BYTES = 16384  # VRCFaceTracking's bundles have 4096
_RETRY_S = 0.2  # after a socket error
_MAX_BUSY_S = 0.005  # of continuous work before a pause ...
_PAUSE_FACTOR = 3.0  # ... of this many times its length, so that a flood does not occupy a core


class FaceListener:
    """``with FaceListener(feed, 9000):`` listens on a thread. Port 0: any free one. Raises GlsplatError."""

    def __init__(self, feed: FaceFeed, port: int) -> None:
        self.feed = feed
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((_HOST, port))
        except OSError as error:
            self._socket.close()
            raise GlsplatError(f"UDP port {port} cannot be opened ({error.strerror}); choose another") from None
        self._socket.settimeout(0.2)
        self.port: int = self._socket.getsockname()[1]
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._listen, name="face", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ends.set()
        self._thread.join()
        self._socket.close()

    def _listen(self) -> None:
        busy, failing = 0.0, False
        while not self._ends.is_set():
            before = time.perf_counter()
            try:
                packet = self._socket.recv(MAX_PACKET_BYTES)
            except TimeoutError:
                continue
            except OSError as error:  # some systems report a closed sender
                if not failing:
                    log.warning("the face-tracking port cannot be read (%s); retrying", error.strerror)
                failing = True
                self._ends.wait(_RETRY_S)
                continue
            failing = False
            received, worked = time.perf_counter(), time.thread_time()
            self.feed.receive(packet, received)
            busy = max(0.0, busy - (received - before) / _PAUSE_FACTOR) + time.thread_time() - worked
            if busy > _MAX_BUSY_S:
                self._ends.wait(_PAUSE_FACTOR * busy)
                busy = 0.0
