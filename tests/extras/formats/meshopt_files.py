"""A packer of EXT_meshopt_compression, written from the extension's text, that uses every code of its bitstreams."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

__all__ = ["packed_triangles", "packed_vertices"]


def packed_vertices(elements: np.ndarray) -> bytes:
    """Of elements [N, S] of bytes; each group as small as it can be."""
    count, stride = elements.shape
    out = bytearray([0xA0])
    size = min(8192 // stride // 16 * 16, 256)
    before = elements[0]
    for first in range(0, count, size):
        block = elements[first : first + size]
        deltas = np.diff(np.vstack([before, block]).astype(np.int64), axis=0)
        deltas = (deltas + 128) % 256 - 128
        coded = np.where(deltas < 0, -2 * deltas - 1, 2 * deltas).astype(np.uint8)
        coded = np.vstack([coded, np.zeros((-len(coded) % 16, stride), np.uint8)])
        for channel in range(stride):
            heads, bodies = [], bytearray()
            for group in coded[:, channel].reshape(-1, 16):
                head, body = min((_group(group, bits) for bits in range(4) if bits or not group.any()), key=_length)
                heads.append(head)
                bodies += body
            heads += [0] * (-len(heads) % 4)
            out += bytes(sum(h << 2 * k for k, h in enumerate(heads[i : i + 4])) for i in range(0, len(heads), 4))
            out += bodies
        before = block[-1]
    return bytes(out) + bytes(max(32 - stride, 0)) + elements[0].tobytes()


def _length(coded: tuple[int, bytes]) -> int:
    return len(coded[1])


def _group(values: np.ndarray, bits: int) -> tuple[int, bytes]:
    if bits in (0, 3):
        return bits, values.tobytes() if bits else b""
    width = 2 * bits
    most = (1 << width) - 1
    small = np.minimum(values, most).astype(int)
    per = 8 // width
    body = bytes(
        sum(int(v) << width * (per - 1 - k) for k, v in enumerate(small[i : i + per])) for i in range(0, 16, per)
    )
    return bits, body + values[values >= most].tobytes()


def _number(value: int) -> bytes:
    out = bytearray()
    while value > 127:
        out.append(value & 127 | 128)
        value >>= 7
    return bytes([*out, value])


def _signed(value: int) -> bytes:
    return _number(2 * value if value >= 0 else -2 * value - 1)


def packed_triangles(triangles: Sequence[Sequence[int]]) -> bytes:
    """Version 1. Every triangle begins where the two before it ended, or is written out."""
    codes, data = bytearray(), bytearray()
    edges: list[tuple[int, int]] = []
    corners: list[int] = []
    following = last = 0
    for a, b, c in triangles:
        if (a, b) in edges[-15:]:
            back = edges[::-1].index((a, b))
            recent = corners[-2:-14:-1]
            if c == following:
                codes.append(back << 4)
                following += 1
                corners.append(c)
            elif c in recent:
                codes.append(back << 4 | recent.index(c) + 1)
            elif c in (last - 1, last + 1):
                codes.append(back << 4 | (14 if c > last else 13))
                corners.append(c)
                last = c
            else:
                codes.append(back << 4 | 15)
                data += _signed(c - last)
                corners.append(c)
                last = c
            edges += [(c, b), (a, c)]
            continue
        if (a, b, c) == (following, following + 1, following + 2):
            codes.append(0xF0)  # the first of the table: three new ones
            following += 3
        else:
            codes.append(0xFF)
            data.append(0xFF)
            for corner in (a, b, c):
                data += _signed(corner - last)
                last = corner
        corners += [a, b, c]
        edges += [(b, a), (c, b), (a, c)]
    return bytes([0xE1]) + bytes(codes) + bytes(data) + bytes(16)
