"""Split a picture into datagrams and join them again (docs/protocol.md, section 5.3). No I/O.

A datagram is a header and a piece. Header, little endian: u8 kind, u8 parity pieces of each group, u16 number of the
piece, u32 frame_id, u32 bytes of the whole. Piece i is in group i mod G; every group has its own parity.
"""

from __future__ import annotations

import struct
from functools import lru_cache
from math import exp

import numpy as np

from glsplat.extras.far_links.datagrams.erasure import MOST, parity_of, restored

_FAILS = 0.003  # accepted share of pictures that cannot be restored
_MOST = 0.4  # most parity pieces a piece: a link that needs more is unfit for pictures


def parity_for(pieces: int, loss: float) -> int:
    """Return the fewest parity pieces by which all but ``_FAILS`` of pictures survive independent packet ``loss``."""
    return _parity(pieces, round(min(loss, 0.5), 4))


@lru_cache(4096)
def _parity(pieces: int, loss: float) -> int:
    most = max(2, round(_MOST * pieces))
    for parity in range(most):
        mean = (pieces + parity) * loss  # Poisson, slightly above the binomial law
        term = left = exp(-mean)
        for lost in range(1, parity + 1):
            term *= mean / lost
            left += term
        if 1 - left <= _FAILS:
            return parity
    return most


PICTURE, PING, REQUEST = 0, 1, 2
"""Kinds: a piece of a picture; a ping, which the client returns; a piece of a client's request."""
PIECE = 1124
"""Bytes of a piece; with all headers below the 1,200 that every QUIC path carries (RFC 9000, section 14)."""
LARGEST = 8 * 2**20
"""Most bytes of a picture sent by datagrams."""
NONCE = 8
"""Bytes before a picture, which the client returns once it arrived."""
HEAD: struct.Struct = struct.Struct("<BBHII")
_GROUP = 160  # most pieces of a group; the rest of MOST is for parity
_UNFINISHED = 8  # incomplete pictures kept


def groups_of(nbytes: int) -> tuple[int, int]:
    """Return the pieces and groups of a message of ``nbytes``."""
    pieces = -(-nbytes // PIECE)
    return pieces, -(-pieces // _GROUP)


def packets_of(frame_id: int, message: bytes, parity: int, kind: int = PICTURE) -> list[bytes]:
    """Return a message's datagrams; the last are ``parity`` pieces for each group."""
    pieces, groups = groups_of(len(message))
    assert 0 < len(message) <= LARGEST and parity <= MOST - _GROUP
    padded = np.zeros((pieces, PIECE), np.uint8)
    padded.ravel()[: len(message)] = np.frombuffer(message, np.uint8)
    out = [
        HEAD.pack(kind, parity, i, frame_id, len(message)) + message[i * PIECE : (i + 1) * PIECE] for i in range(pieces)
    ]
    more = [parity_of(padded[group::groups], parity) for group in range(groups)] if parity else []
    for row in range(parity):
        for group in range(groups):
            number = pieces + row * groups + group
            out.append(HEAD.pack(kind, parity, number, frame_id, len(message)) + more[group][row].tobytes())
    return out


class _Unfinished:
    def __init__(self, nbytes: int, parity: int) -> None:
        self.nbytes, self.parity = nbytes, parity
        self.pieces, self.groups = groups_of(nbytes)
        self.data: dict[int, bytes] = {}
        self.lacking = [len(range(group, self.pieces, self.groups)) for group in range(self.groups)]

    def add(self, number: int, piece: bytes) -> bool:
        """Add a piece; return whether the message can now be restored."""
        length = min(PIECE, self.nbytes - number * PIECE) if number < self.pieces else PIECE
        if number >= self.pieces + self.parity * self.groups or len(piece) != length or number in self.data:
            return False
        self.data[number] = piece
        self.lacking[(number if number < self.pieces else number - self.pieces) % self.groups] -= 1
        return max(self.lacking) <= 0

    def whole(self) -> bytes:
        out = np.zeros((self.pieces, PIECE), np.uint8)
        for number, piece in self.data.items():
            if number < self.pieces:
                out[number, : len(piece)] = np.frombuffer(piece, np.uint8)
        for group in range(self.groups):
            own = range(group, self.pieces, self.groups)
            missing = [index for index, number in enumerate(own) if number not in self.data]
            rows = {
                row: np.frombuffer(self.data[number], np.uint8)
                for row in range(self.parity)
                if (number := self.pieces + row * self.groups + group) in self.data
            }
            part = np.ascontiguousarray(out[own.start :: self.groups])
            restored(part, missing, rows)
            out[own.start :: self.groups] = part
        return out.tobytes()[: self.nbytes]


class Assembler:
    """Joins datagrams to messages; drops those older than the newest complete message.

    It also drops messages above ``largest`` bytes, or with more than ``parity`` parity pieces in a group.
    """

    def __init__(self, kind: int = PICTURE, largest: int = LARGEST, parity: int = MOST - _GROUP) -> None:
        self.newest = -1
        self._kind, self._largest, self._parity = kind, largest, parity
        self._unfinished: dict[int, _Unfinished] = {}

    def add(self, datagram: bytes) -> tuple[int, bytes] | None:
        """Add a datagram; return frame_id and message if it completes one."""
        if len(datagram) <= HEAD.size:
            return None
        kind, parity, number, frame_id, nbytes = HEAD.unpack_from(datagram)
        if kind != self._kind or frame_id <= self.newest:
            return None
        if not 0 < nbytes <= self._largest or parity > self._parity:
            return None
        one = self._unfinished.get(frame_id)
        if one is None:
            one = self._unfinished[frame_id] = _Unfinished(nbytes, parity)
            if len(self._unfinished) > _UNFINISHED:
                del self._unfinished[min(self._unfinished)]
        if (nbytes, parity) != (one.nbytes, one.parity) or not one.add(number, datagram[HEAD.size :]):
            return None
        self.newest = frame_id
        for old in [old for old in self._unfinished if old <= frame_id]:
            del self._unfinished[old]
        return frame_id, one.whole()
