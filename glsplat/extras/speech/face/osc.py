"""OSC packets: messages and bundles of them, as bytes that may be anything.

"The Open Sound Control 1.0 Specification", Wright 2002. What is needed of it is a page, so no library is: one would
bring a server and a dispatcher that answers what is malformed with tracebacks.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator

from glsplat.errors import ProtocolError

__all__ = ["Argument", "osc_messages"]

Argument = float | bool

_DEEPEST = 4  # bundles in bundles
_SIZES = {"i": 4, "f": 4, "d": 8, "h": 8, "t": 8, "c": 4, "r": 4, "m": 4}
_NUMBERS = {"i": ">i", "f": ">f", "d": ">d", "h": ">q"}
_BOOLS = {"T": True, "F": False}


def osc_messages(packet: bytes, depth: int = 0) -> Iterator[tuple[str, list[Argument]]]:
    """Address, and the numbers and booleans among the arguments, of every message in a packet.

    Raises ProtocolError for what is no OSC, once the messages before it were given.
    """
    if not packet.startswith(b"#bundle\0"):
        yield _message(packet)
        return
    if depth == _DEEPEST:
        raise ProtocolError("an OSC bundle that is nested too deeply")
    place = 16  # behind the time tag, which is not waited for
    while place < len(packet):
        size = int.from_bytes(packet[place : place + 4], "big")
        place += 4
        if not 0 < size <= len(packet) - place:
            raise ProtocolError("an OSC bundle that ends early")
        yield from osc_messages(packet[place : place + size], depth + 1)
        place += size


def _message(packet: bytes) -> tuple[str, list[Argument]]:
    address, place = _text(packet, 0)
    if not address.startswith("/"):
        raise ProtocolError("an OSC message whose address does not begin with /")
    tags, place = _text(packet, place)
    arguments: list[Argument] = []
    for tag in tags.removeprefix(","):
        if tag in _BOOLS:
            arguments.append(_BOOLS[tag])
        elif tag in _SIZES:
            if place + _SIZES[tag] > len(packet):
                raise ProtocolError("an OSC message that ends early")
            if tag in _NUMBERS:
                arguments.append(float(struct.unpack_from(_NUMBERS[tag], packet, place)[0]))
            place += _SIZES[tag]
        elif tag in "sS":
            _, place = _text(packet, place)
        elif tag == "b":
            place += 4 + (int.from_bytes(packet[place : place + 4], "big") + 3) // 4 * 4
        elif tag not in "NI[]":
            raise ProtocolError("an OSC message with an argument of a type that the specification does not have")
    return address, arguments


def _text(packet: bytes, place: int) -> tuple[str, int]:
    """A string of ASCII and where the next thing begins: at a multiple of four bytes."""
    end = packet.find(b"\0", place)
    if end < 0:
        raise ProtocolError("an OSC string without an end")
    try:
        return packet[place:end].decode("ascii"), (end // 4 + 1) * 4
    except UnicodeDecodeError:
        raise ProtocolError("an OSC string that is not ASCII") from None
