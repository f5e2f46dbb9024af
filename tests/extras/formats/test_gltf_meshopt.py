"""Packed bufferViews (EXT_meshopt_compression) and sparse accessors hold what was put in, or are one line."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from glsplat.errors import FormatError
from glsplat.extras.formats.meshopt import unpacked
from glsplat.formats.gltf.container import Container, parse
from tests.extras.formats.meshopt_files import packed_triangles, packed_vertices

RNG = np.random.default_rng(8)
WALK = np.cumsum(RNG.integers(-3, 4, (1000, 8)), axis=0).astype(np.uint8)
NOISE = RNG.integers(0, 256, (300, 12)).astype(np.uint8)
STILL = np.full((40, 4), 7, np.uint8)
WIDE = RNG.integers(0, 20, (700, 64)).astype(np.uint8)
GRID = [
    t
    for y in range(12)
    for x in range(9)
    for t in ((10 * y + x, 10 * y + x + 1, 10 * y + x + 10), (10 * y + x + 10, 10 * y + x + 1, 10 * y + x + 11))
]
FAN = [(0, 1, 2), (0, 2, 3), (3, 2, 1), (900, 5, 70000), (70000, 5, 6), (70000, 6, 5), (3, 900, 4)]


@pytest.mark.parametrize("elements", [WALK, NOISE, STILL, WIDE, WALK[:1], WALK[:17]])
def test_vertices(elements: np.ndarray) -> None:
    data = packed_vertices(elements)
    assert unpacked(data, "ATTRIBUTES", len(elements), elements.shape[1], "NONE", "x") == elements.tobytes()
    assert len(data) < 1.1 * elements.size + 80


def test_vertices_by_hand() -> None:
    """One channel of four in use: +1, -1, +2, +40, 0: zigzag 2, 1, 4, 80 on nibbles, of which 80 follows."""
    group = bytes([0x21, 0x4F, 0, 0, 0, 0, 0, 0, 80])
    data = bytes([0xA0, 0b10]) + group + bytes([0, 0, 0]) + bytes(28) + bytes([10, 0, 0, 0])
    found = np.frombuffer(unpacked(data, "ATTRIBUTES", 5, 4, "NONE", "x"), np.uint8).reshape(5, 4)
    assert found[:, 0].tolist() == [11, 10, 12, 52, 52] and not found[:, 1:].any()


def test_floats_of_a_shared_exponent() -> None:
    """Mantissa of 24 bits below an exponent of two of 8: 3 * 2^-1, -5 * 2^2."""
    words = np.array([(0xFF << 24) | 3, (2 << 24) | (2**24 - 5)], "<u4")
    data = packed_vertices(words.view(np.uint8).reshape(2, 4))
    found = np.frombuffer(unpacked(data, "ATTRIBUTES", 2, 4, "EXPONENTIAL", "x"), "<f4")
    assert found.tolist() == [1.5, -20.0]


@pytest.mark.parametrize("triangles", [GRID, FAN, GRID[::-1]])
@pytest.mark.parametrize("size", [2, 4])
def test_triangles(triangles: list[tuple[int, int, int]], size: int) -> None:
    if size == 2:
        triangles = [tuple(min(v, 65535) for v in t) for t in triangles]  # type: ignore[misc]
    data = packed_triangles(triangles)
    found = np.frombuffer(unpacked(data, "TRIANGLES", 3 * len(triangles), size, "NONE", "x"), f"<u{size}")
    assert found.reshape(-1, 3).tolist() == [list(t) for t in triangles]


def test_indices_by_hand() -> None:
    """Two runs, differences zigzag above one bit that says which: 1, 2 of the first, 100 of the second, 3."""
    numbers = [1 << 2, 1 << 2, 100 << 2 | 1, 1 << 2]
    coded = b"".join(bytes([n]) if n < 128 else bytes([n & 127 | 128, n >> 7]) for n in numbers)
    found = unpacked(bytes([0xD1]) + coded + bytes(4), "INDICES", 4, 2, "NONE", "x")
    assert np.frombuffer(found, "<u2").tolist() == [1, 2, 100, 3]


@pytest.mark.parametrize(
    "change",
    [
        lambda d, n: (d[:-1], n),
        lambda d, n: (d + b"\0", n),
        lambda d, n: (b"\xa1" + d[1:], n),
        lambda d, n: (d, 2**40),
        lambda d, n: (d, n + 900),
        lambda d, n: (b"", n),
        lambda d, n: (d[:40], n),
    ],
)
def test_broken_vertices_are_one_line(change: Any) -> None:
    data, count = change(packed_vertices(NOISE), len(NOISE))
    with pytest.raises(FormatError, match=r"^a thing: .*meshopt") as caught:
        unpacked(data, "ATTRIBUTES", count, 12, "NONE", "a thing")
    assert "\n" not in str(caught.value)


def test_nothing_makes_it_fail_otherwise() -> None:
    good = [("ATTRIBUTES", packed_vertices(WALK[:64]), 64, 8), ("TRIANGLES", packed_triangles(GRID), 3 * len(GRID), 4)]
    good.append(("INDICES", bytes([0xD1, 4, 4, 9]) + bytes(4), 3, 2))
    for mode, data, count, stride in good:
        for _ in range(300):
            broken = bytearray(data)
            for _ in range(RNG.integers(1, 4)):
                broken[RNG.integers(len(broken))] = RNG.integers(256)
            try:
                assert len(unpacked(bytes(broken), mode, count, stride, "NONE", "x")) == count * stride
            except FormatError:
                continue


def opened(**change: Any) -> Container:
    """Two floats of eight elements, packed, in a file whose plain buffer is only said to be there."""
    data = packed_vertices(np.arange(8, dtype="<f4").view(np.uint8).reshape(8, 4))
    packed = {"buffer": 0, "byteLength": len(data), "byteStride": 4, "count": 8, "mode": "ATTRIBUTES"} | change
    extension = {"EXT_meshopt_compression": packed}
    uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    document = {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": len(data), "uri": uri}, {"byteLength": 32}],
        "bufferViews": [{"buffer": 1, "byteLength": 32, "extensions": extension}] * 2,
        "accessors": [{"bufferView": n, "componentType": 5126, "count": 8, "type": "SCALAR"} for n in (0, 1)],
    }
    return parse(json.dumps(document).encode(), Path())


def test_an_accessor_of_packed_elements() -> None:
    container = opened()
    for _ in range(3):  # read again, not unpacked again
        assert container.read(0, "x", ("SCALAR",))[:, 0].tolist() == list(range(8))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"count": 7}, "does not hold what is packed"),
        ({"byteLength": 10**6}, "truncated"),
        ({"count": "8"}, "broken way"),
        ({"mode": "POINTS"}, "gltf-transform"),
        ({"filter": "QUATERNION"}, "gltf-transform"),
        ({"buffer": 9}, "refers to buffer 9"),
    ],
)
def test_hostile_packed_views(change: dict[str, Any], words: str) -> None:
    with pytest.raises(FormatError, match=words):
        opened(**change).read(0, "x", ("SCALAR",))


def test_the_same_bytes_are_not_unpacked_again_and_again() -> None:
    container = opened()
    container.read(0, "x", ("SCALAR",))
    with pytest.raises(FormatError, match="overlap"):
        container.read(1, "x", ("SCALAR",))


def sparse(base: bool, rows: list[int], **change: Any) -> Container:
    data = np.arange(6, dtype="<f4").tobytes() + np.array(rows, "<u2").tobytes().ljust(4, b"\0")
    data += np.array([50, 60], "<f4").tobytes()
    uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    ends = [(0, 24), (24, 4), (28, 8)]
    part = {"count": 2, "indices": {"bufferView": 1, "componentType": 5123}, "values": {"bufferView": 2}}
    accessor = {"componentType": 5126, "count": 6, "type": "SCALAR", "sparse": part | change.pop("sparse", {})}
    document = {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": len(data), "uri": uri}],
        "bufferViews": [{"buffer": 0, "byteOffset": a, "byteLength": n} for a, n in ends],
        "accessors": [accessor | ({"bufferView": 0} if base else {}) | change],
    }
    return parse(json.dumps(document).encode(), Path())


def test_sparse_accessors() -> None:
    assert sparse(True, [1, 4]).read(0, "x", ("SCALAR",))[:, 0].tolist() == [0, 50, 2, 3, 60, 5]
    assert sparse(False, [1, 4]).numbers(0, "x", ("SCALAR",))[:, 0].tolist() == [0, 50, 0, 0, 60, 0]


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ({"rows": [1, 6]}, "x needs indices of its 6 elements"),
        ({"sparse": {"count": 3}}, "truncated: x indices"),
        ({"sparse": {"count": 2**50}}, "truncated: x indices"),
        ({"sparse": {"values": {"bufferView": 7}}}, "refers to bufferView of x values 7"),
        ({"count": 2**40}, "x needs at most 4194304 elements over nothing"),
        ({"sparse": {"indices": {"bufferView": 1, "componentType": 5122}}}, "x needs indices"),
        ({"sparse": {"indices": 3}}, "x is a broken sparse accessor"),
    ],
)
def test_hostile_sparse_accessors(how: dict[str, Any], words: str) -> None:
    how = {"rows": [1, 4], "base": False} | how
    with pytest.raises(FormatError, match=words):
        sparse(**how).read(0, "x", ("SCALAR",))
