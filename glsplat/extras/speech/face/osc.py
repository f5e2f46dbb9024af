"""Parse OSC packets from untrusted senders ("The Open Sound Control 1.0 Specification", Wright 2002).

A library would add a server and a dispatcher that prints tracebacks for malformed packets.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator

from glsplat.errors import ProtocolError

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
