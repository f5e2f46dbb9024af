"""Pictures and requests in datagrams, in Python and in the page (web/stream): the same answers for the same vectors."""

from __future__ import annotations

import base64
import hashlib
import zlib
from pathlib import Path
from random import Random
from typing import Any

from glsplat.extras.far_links.datagrams.packets import HEAD, LARGEST, PICTURE, PIECE, REQUEST, Assembler, packets_of
from tests.extras.far_links.datagrams.test_packets import lossy
from tests.twins import Twin, both_sides, text_of


def pictures(datagrams: str) -> list[list[Any]]:
    """Return [bytes, SHA-256] of each message that comes of datagrams (see ``wrapped``)."""
    data, whole, out = zlib.decompress(base64.b64decode(datagrams)), Assembler(), []
    while data:
        size = 2 + int.from_bytes(data[:2], "little")
        if found := whole.add(data[2:size]):
            out.append([len(found[1]), hashlib.sha256(found[1]).hexdigest()])
        data = data[size:]
    return out


def wrapped(datagrams: list[bytes]) -> dict[str, str]:
    """Return datagrams as a vector has them: each after its length (u16, little endian), packed, in base64."""
    return {"datagrams": text_of(zlib.compress(b"".join(len(d).to_bytes(2, "little") + d for d in datagrams), 9))}


def streams() -> list[dict[str, str]]:
    chance = Random(8)
    out = []
    for number, (nbytes, parity) in enumerate([(1, 1), (PIECE, 2), (9000, 5), (160 * PIECE + 1, 3)]):
        message = (chance.randbytes(211) * (nbytes // 211 + 1))[:nbytes]  # repeats, so that a vector is short
        out.append(wrapped(lossy(packets_of(number, message, parity), nbytes, parity, chance)))
        out.append(wrapped(lossy(packets_of(number, message, parity), nbytes, parity, chance, more=1)))
    old, new = packets_of(1, b"old" * 800, 0), packets_of(2, b"new" * 800, 0)
    lies = [b"", b"\0", old[0][:-1], HEAD.pack(PICTURE, 255, 0, 9, 3000) + b"x" * PIECE]
    lies += [HEAD.pack(PICTURE, 0, 0, 9, LARGEST + 1) + b"x" * PIECE, HEAD.pack(PICTURE, 0, 0, 9, 0) + b"x"]
    return [*out, wrapped([*old[:2], *lies, *new, *new, *old[2:]])]


def request(number: int, text: str) -> list[str]:
    """Return the datagrams of a request."""
    return [text_of(one) for one in packets_of(number, text.encode(), 0, REQUEST)]


TWINS = {
    "pictures": Twin(pictures, streams, 0),
    "request": Twin(request, lambda: [{"number": 5, "text": "ä" * 3000}, {"number": 70_000, "text": "{}"}], 0),
}

test_python_gives_the_vectors, test_the_page_gives_the_vectors = both_sides(Path(__file__).parent, TWINS)
