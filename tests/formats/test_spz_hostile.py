"""SPZ files that are broken, lie about what they hold, or unpack to more than memory: refused in one line."""

from __future__ import annotations

import gzip
import struct
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.formats.scenes import spz_streams, zstd_frame
from tests.formats.test_contract import peak_of
from tests.formats.test_spz import (
    ATTRIBUTES,
    BODY,
    GZIPPED,
    HEADER,
    PAYLOAD,
    _zstd,
    header,
    needs_zstd,
    refused,
)

BREAKS: dict[str, tuple[bytes, str]] = {
    "nothing": (b"", "header of 16 bytes"),
    "half a header": (HEADER[:9], "header of 16 bytes"),
    "other magic": (b"NGSQ" + PAYLOAD[4:], "begins with NGSP"),
    "version 0": (header(0) + BODY, "version 1 to 4 .*, found 0"),
    "version 5": (header(5) + BODY, "version 1 to 4 .*, found 5"),
    "degree 5": (header(degree=5) + BODY, "found 5 and 12"),
    "25 bits": (header(bits=25) + BODY, "found 1 and 25"),
    "a tree": (header(flags=0x80) + BODY, "level-of-detail tree"),
    "one splat more": (header(count=3) + BODY, "take more than the file"),
    "one splat fewer": (header(count=1) + BODY, "the file holds more"),
    "four billion": (header(count=2**32 - 1) + BODY, "take more than the file"),
    "another degree": (header(degree=2) + BODY, "take more than the file"),
    "a byte more": (PAYLOAD + b"\0", "the file holds more"),
    "a byte fewer": (PAYLOAD[:-1], "truncated"),
}


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("name", BREAKS)
def test_refuses(tmp_path: Path, name: str, packed: bool) -> None:
    content, message = BREAKS[name]
    content, message = (
        (gzip.compress(content), "." if len(content) >= 16 else message) if packed else (content, message)
    )
    refused(tmp_path, content, message)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (gzip.compress(header(count=3) + BODY, mtime=0), "truncated: 3 splats take 87 bytes, 58 are there"),
        (GZIPPED[:-1], "has no end"),
        (GZIPPED[:-9], "has no end|58 bytes"),
        (GZIPPED[:30], "has no end"),
        (GZIPPED[:-8] + bytes(8), "the gzip stream is broken"),  # the checksum
        (GZIPPED + b"more", "something follows"),
        (b"\x1f\x8b" + bytes(30), "the gzip stream is broken"),
    ],
)
def test_refuses_broken_gzip(tmp_path: Path, content: bytes, message: str) -> None:
    refused(tmp_path, content, message)


def with_streams(change: Callable[[bytearray], None]) -> bytes:
    data = bytearray(spz_streams(gzip.compress(PAYLOAD)))
    change(data)
    return bytes(data)


def put(at: int, form: str, value: int) -> Callable[[bytearray], None]:
    return lambda data: struct.pack_into(form, data, at, value)


def cut(data: bytearray) -> None:
    del data[-1]


STREAMS: dict[str, tuple[Callable[[bytearray], None], str]] = {
    "degree": (put(12, "<B", 0), "need 5 streams, the header declares 6"),
    "count": (put(8, "<I", 3), "need other sizes"),
    "huge count": (put(8, "<I", 2**32 - 1), "more than [0-9]+ bytes can hold"),
    "no streams": (put(15, "<B", 0), "declares 0"),
    "table before the header": (put(16, "<I", 31), "declared at byte 31"),
    "table behind the end": (put(16, "<I", 2**32 - 1), "declared at byte"),
    "packed size": (put(32, "<Q", 2**63), "do not add up"),
    "unpacked size": (put(40, "<Q", 17), "need other sizes"),
    "cut": (cut, "do not add up"),
    "longer": (lambda data: data.extend(b"x"), "do not add up"),
}


@pytest.mark.parametrize("name", STREAMS)
def test_refuses_a_broken_table(tmp_path: Path, name: str) -> None:
    change, message = STREAMS[name]
    refused(tmp_path, with_streams(change), message)


@needs_zstd
@pytest.mark.parametrize(
    ("frame", "message"),
    [
        (b"no frame at all", "zstd stream is broken"),
        (zstd_frame(ATTRIBUTES[0])[:-1], "has no end"),
        (zstd_frame(ATTRIBUTES[0][:-1]), "needs to hold 18 bytes"),
        (zstd_frame(ATTRIBUTES[0] + b"x"), "needs to hold 18 bytes"),
        (zstd_frame(ATTRIBUTES[0]) + b"x", "needs to hold 18 bytes"),
        (zstd_frame(bytes(10**7)), "needs to hold 18 bytes"),
    ],
)
def test_refuses_a_broken_stream(tmp_path: Path, frame: bytes, message: str) -> None:
    data = spz_streams(gzip.compress(PAYLOAD))
    old = struct.unpack_from("<Q", data, 32)[0]
    table = 32 + 16 * 6
    data = data[:32] + struct.pack("<Q", len(frame)) + data[40:table] + frame + data[table + old :]
    refused(tmp_path, data, message)


def test_without_zstd_it_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("compression.zstd", "backports.zstd", "backports"):
        monkeypatch.setitem(sys.modules, name, None)
    refused(tmp_path, spz_streams(gzip.compress(PAYLOAD)), "pip install backports.zstd")


@pytest.mark.parametrize("count", [2, 10_000])
def test_a_bomb_unpacks_no_further_than_its_header_says(tmp_path: Path, count: int) -> None:
    """20 MB of zeros in 20 kB: the splats that are declared, a little more, and the end of it."""
    bomb = gzip.compress(header(count=count, degree=0) + bytes(2 * 10**7), 9)
    assert peak_of(lambda: refused(tmp_path, bomb, "the file holds more")) < 2_000_000


@needs_zstd
def test_a_bomb_of_zstd_neither(tmp_path: Path) -> None:
    frame = _zstd.compress(bytes(2 * 10**7))
    data = spz_streams(gzip.compress(PAYLOAD))
    old, table = struct.unpack_from("<Q", data, 32)[0], 32 + 16 * 6
    bomb = data[:32] + struct.pack("<Q", len(frame)) + data[40:table] + frame + data[table + old :]
    assert peak_of(lambda: refused(tmp_path, bomb, "needs to hold 18 bytes")) < 2_000_000
