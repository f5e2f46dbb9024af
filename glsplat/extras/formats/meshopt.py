"""EXT_meshopt_compression of glTF 2.0: bufferViews of vertices and indices, from gltfpack and glTF-Transform.

Vertices are stored byte by byte: for every byte of an element the zigzag differences to the previous element, in groups
of sixteen with 0, 2, 4 or 8 bits a difference. Triangles refer to recent edges and vertices. Source: the bitstream of
the extension (Khronos, vendor extension of 2020), version 0 of vertices.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError

U8 = NDArray[np.uint8]

_GROUP, _BLOCK, _MOST = 16, 8192, 256  # elements a group, bytes and elements a block
_TAIL, _AUXILIARY = 32, 16  # bytes at the end: least of vertices, of triangles
_HELP = "unpack it: npx @gltf-transform/cli copy IN.glb OUT.glb"
_BYTES = np.arange(256, dtype=np.uint8)
_PAIRS = np.stack([_BYTES >> 6, _BYTES >> 4 & 3, _BYTES >> 2 & 3, _BYTES & 3], axis=1)  # of a byte, highest first
_NIBBLES = np.stack([_BYTES >> 4, _BYTES & 15], axis=1)


def unpacked(data: bytes, mode: str, count: int, stride: int, filtered: str, what: str) -> bytes:
    """Decode ``count`` elements of ``stride`` bytes. Raises FormatError naming ``what`` for invalid data."""
    try:
        if mode == "ATTRIBUTES" and filtered in ("NONE", "EXPONENTIAL"):
            if not 0 < stride <= 256 or stride % 4:
                raise ValueError
            found = _vertices(np.frombuffer(data, np.uint8), count, stride)
            return (_exponential(found) if filtered == "EXPONENTIAL" else found).tobytes()
        if mode in ("TRIANGLES", "INDICES") and filtered == "NONE" and stride in (2, 4):
            if count > 3 * len(data):
                raise ValueError
            index = _triangles(data, count) if mode == "TRIANGLES" else _sequence(data, count)
            return np.array(index, np.int64).astype(f"<u{stride}").tobytes()
    except (ValueError, IndexError, OverflowError):
        raise FormatError(f"{what}: {count} packed elements of {stride} bytes are broken (meshopt)") from None
    raise FormatError(f"{what}: packed in a way that is not read (meshopt {mode[:20]} {filtered[:20]}); {_HELP}")


def _vertices(data: U8, count: int, stride: int) -> U8:
    """Decode vertices [count, stride]."""
    # a group of zeros takes two bits
    if len(data) < 1 + max(_TAIL, stride) or data[0] != 0xA0 or count * stride > 64 * len(data):
        raise ValueError
    out = np.empty((count, stride), np.uint8)
    before = data[len(data) - stride :]
    end = len(data) - max(_TAIL, stride)
    size = min(_BLOCK // stride // _GROUP * _GROUP, _MOST)
    at = 1
    for first in range(0, count, size):
        rows = min(size, count - first)
        groups = -(-rows // _GROUP)
        coded = np.zeros((stride, groups, _GROUP), np.uint8)
        for channel in range(stride):
            head = _PAIRS[data[at : at + -(-groups // 4)]][:, ::-1].ravel()  # headers start at the lowest bits
            at += -(-groups // 4)
            for group, bits in enumerate(head[:groups].tolist()):
                at = _group(data, at, bits, coded[channel, group])
        if at > end:
            raise ValueError
        values = coded.reshape(stride, -1)[:, :rows].T
        deltas = (values >> 1) ^ (-(values & 1).astype(np.int8)).view(np.uint8)
        out[first : first + rows] = np.cumsum(deltas, axis=0, dtype=np.uint8) + before
        before = out[first + rows - 1]
    if at != end:
        raise ValueError
    return out


def _group(data: U8, at: int, bits: int, out: U8) -> int:
    """Decode sixteen differences into ``out``; return the position of the next."""
    if bits == 3:
        out[:] = data[at : at + 16]
        return at + 16
    if bits:
        table, most = (_PAIRS, 3) if bits == 1 else (_NIBBLES, 15)
        size = 4 * bits
        out[:] = table[data[at : at + size]].ravel()
        at += size
        large = out == most  # these follow, a byte each
        more = int(np.count_nonzero(large))
        if more:
            out[large] = data[at : at + more]
            at += more
    return at


def _exponential(data: U8) -> NDArray[np.float32]:
    """Decode floats of 32 bits: 8 bits of a signed exponent of two above 24 of a signed mantissa."""
    words = np.ascontiguousarray(data).view("<i4")
    return np.ldexp((words << 8 >> 8).astype(np.float64), words >> 24).astype("<f4")


class _Reader:
    """Reads numbers of one to five bytes, seven bits each, lowest first, and signed differences."""

    def __init__(self, data: bytes, at: int, end: int) -> None:
        self.data, self.at, self.end = data, at, end

    def byte(self) -> int:
        if self.at >= self.end:
            raise ValueError
        self.at += 1
        return self.data[self.at - 1]

    def number(self) -> int:
        out = 0
        for shift in range(0, 35, 7):
            byte = self.byte()
            out |= (byte & 127) << shift
            if byte < 128:
                break
        return out

    def after(self, last: int) -> int:
        value = self.number()
        return (last + (value >> 1 ^ -(value & 1))) & 0xFFFFFFFF


def _sequence(data: bytes, count: int) -> list[int]:
    if len(data) < 1 + count + 4 or data[0] & 0xF0 != 0xD0 or data[0] & 15 > 1:
        raise ValueError
    reader, last, out = _Reader(data, 1, len(data) - 4), [0, 0], []
    for _ in range(count):
        value = reader.number()
        which, value = value & 1, value >> 1
        last[which] = (last[which] + (value >> 1 ^ -(value & 1))) & 0xFFFFFFFF
        out.append(last[which])
    if reader.at != reader.end:
        raise ValueError
    return out


def _triangles(data: bytes, count: int) -> list[int]:
    triangles = count // 3
    if count % 3 or len(data) < 1 + triangles + _AUXILIARY or data[0] & 0xF0 != 0xE0 or data[0] & 15 > 1:
        raise ValueError
    known = 13 if data[0] & 15 else 15  # vertices that a code can refer to
    reader = _Reader(data, 1 + triangles, len(data) - _AUXILIARY)
    pairs = data[len(data) - _AUXILIARY :]
    # the last sixteen; codes count back from the newest
    edges: list[tuple[int, int]] = [(-1, -1)] * 16
    corners: list[int] = [-1] * 16
    following = last = 0
    out: list[int] = []
    for code in data[1 : 1 + triangles]:
        if code < 0xF0:  # on an edge
            a, b = edges[-1 - (code >> 4)]
            third = code & 15
            if third and third < known:
                c = corners[-1 - third]
            else:
                if not third:
                    c, following = following, following + 1
                else:
                    c = last = reader.after(last) if third == 15 else (last + (1 if third == 14 else -1)) & 0xFFFFFFFF
                corners.append(c)
            edges += ((c, b), (a, c))
        else:
            codes = pairs[code & 15] if code < 0xFE else reader.byte()
            if code >= 0xFE and codes == 0:
                following = 0
            three = (15 if code == 0xFF else 0, codes >> 4, codes & 15)
            found: list[int] = []
            for place, kind in enumerate(three):
                if kind == 0:
                    found.append(following)
                    following += 1
                else:  # the table's codes refer up to the fifteenth, the others write those out
                    found.append(corners[-kind] if place and (kind < 15 or code < 0xFE) else -1)
            for place, kind in enumerate(three):
                if kind == 15 and code >= 0xFE:
                    found[place] = last = reader.after(last)
            a, b, c = found
            corners += [v for v, kind in zip(found, three, strict=True) if kind == 0 or (kind == 15 and code >= 0xFE)]
            edges += ((b, a), (c, b), (a, c))
        if min(a, b, c) < 0:
            raise ValueError
        out += (a, b, c)
        if len(edges) > 4096:
            del edges[:-16], corners[:-16]
    if reader.at != reader.end:
        raise ValueError
    return out
