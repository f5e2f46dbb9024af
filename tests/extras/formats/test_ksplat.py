"""KSPLAT: every level and degree, several sections and buckets, and headers that lie."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from glsplat.errors import FormatError
from glsplat.formats import load, recognise
from glsplat.splats import Splats
from tests.extras.formats.ksplats import C0, RANGE, ksplat
from tests.formats.scenes import random_splats
from tests.formats.test_contract import refused
from tests.golden import stored

SECTION = 4096  # where the first section's header begins
DATA = SECTION + 1024


def read(tmp_path: Path, data: bytes) -> Splats:
    (tmp_path / "a").write_bytes(data)
    assert recognise(tmp_path / "a") == "ksplat"
    scene = load(tmp_path / "a")
    assert isinstance(scene, Splats)
    return scene


def bounded(count: int, degree: int, seed: int = 1) -> Splats:
    """What the format can hold: colours in 0 to 1."""
    splats = random_splats(count, degree, seed)
    sh = np.clip(splats.sh, -1.4, 1.4)
    sh[:, 0] = np.clip(sh[:, 0], -0.5 / C0, 0.5 / C0)
    return Splats(splats.means, splats.quats, splats.scales, splats.opacities, sh)


def close(again: Splats, splats: Splats, level: int, block: float = 2.0, sh: float = 3.0) -> None:
    half = 2.0**-11  # half a step of a float16 of size 1
    step = block / 2 / RANGE if level else 0.0
    np.testing.assert_allclose(again.means, splats.means, atol=0.5 * step + 1e-6)
    np.testing.assert_allclose(again.scales, splats.scales, rtol=half if level else 0, atol=3e-8 if level else 0)
    np.testing.assert_allclose(again.quats, splats.quats, atol=2 * half if level else 1e-6)
    np.testing.assert_allclose(again.opacities, splats.opacities, atol=0.5 / 255 + 1e-6)
    np.testing.assert_allclose(again.sh[:, 0] * C0, splats.sh[:, 0] * C0, atol=0.5 / 255 + 1e-6)
    rest = (0, 1.5 * half, sh / 255)[level]  # of level 2 the writer takes the lower code
    np.testing.assert_allclose(again.sh[:, 1:], splats.sh[:, 1:], atol=rest + 1e-6)
    assert level == 0 or not np.array_equal(again.means, splats.means)


@pytest.mark.parametrize("level", [0, 1, 2])
@pytest.mark.parametrize("degree", [0, 1, 2])
def test_levels_and_degrees(tmp_path: Path, level: int, degree: int) -> None:
    data, (written,) = ksplat([bounded(60, degree)], level)
    again = read(tmp_path, data)
    assert (len(again), again.sh_degree, again.antialias) == (60, degree, False)
    close(again, written, level)
    rest = (0, 9, 24)[degree]
    buckets = 0 if level == 0 else int.from_bytes(data[SECTION + 12 : SECTION + 16], "little")
    partial = 0 if level == 0 else int.from_bytes(data[SECTION + 36 : SECTION + 40], "little")
    a_splat = (44 + 4 * rest, 24 + 2 * rest, 24 + rest)[level]
    assert len(data) == DATA + 12 * buckets + 4 * partial + a_splat * 60
    assert level == 0 or 1 < partial < buckets


@pytest.mark.parametrize("level", [0, 1, 2])
def test_sections_of_several_degrees(tmp_path: Path, level: int) -> None:
    parts = [bounded(30, 1, 1), bounded(0, 0, 2), bounded(40, 2, 3), bounded(7, 0, 4)]
    data, written = ksplat(parts, level)
    again = read(tmp_path, data)
    assert len(again) == 77 and again.sh_degree == 2
    at = 0
    for part in written:
        own = again.take(np.arange(at, at + len(part)))
        known = part.sh.shape[1]
        assert not own.sh[:, known:].any()
        if len(part):
            close(Splats(own.means, own.quats, own.scales, own.opacities, own.sh[:, :known]), part, level)
        at += len(part)


def test_more_splats_than_are_read_at_a_time(tmp_path: Path) -> None:
    count = 70_000
    one = bounded(1, 0)
    data = bytearray(ksplat([one], 0)[0])
    record = data[DATA:]
    rows = np.frombuffer(bytes(record) * count, "u1").reshape(count, 44).copy()
    rows[:, :4] = np.arange(count, dtype="<f4").view("u1").reshape(count, 4)
    for at in (SECTION, SECTION + 4, 12, 16):
        struct.pack_into("<I", data, at, count)
    again = read(tmp_path, bytes(data[:DATA]) + rows.tobytes())
    np.testing.assert_array_equal(again.means[:, 0], np.arange(count))


def test_16_bits_about_the_middle_of_a_bucket_by_hand(tmp_path: Path) -> None:
    """Two buckets, one of two splats (full) and one of one, block 10: a step is 5 / 32767."""
    head, section = bytearray(4096), bytearray(1024)
    struct.pack_into("<BBxxIIIIH", head, 0, 0, 1, 1, 1, 3, 3, 1)
    struct.pack_into("<IIIIfHxxIIII", section, 0, 3, 3, 2, 2, 10.0, 12, 0, 0, 1, 1)  # range 0: 32767
    body = struct.pack("<I", 1) + struct.pack("<6f", 5, 5, 5, -15, 25, 5)
    for position in ((0, 32767, 65534), (65535, 0, 1), (32768, 32766, 32767)):
        body += struct.pack("<3H", *position) + np.array([0.5, 0.25, 2, 0, 1, 0, 0], "<f2").tobytes()
        body += bytes([0, 255, 51, 102])
    again = read(tmp_path, bytes(head + section) + body)
    step = 5 / 32767
    expected = [[0, 5, 10], [10 + step, 0, step], [-15 + step, 25 - step, 5]]
    np.testing.assert_allclose(again.means, expected, atol=1e-6)
    np.testing.assert_array_equal(again.scales, [[0.5, 0.25, 2]] * 3)
    np.testing.assert_array_equal(again.quats, [[0, 1, 0, 0]] * 3)  # w comes first
    np.testing.assert_allclose(again.sh[:, 0] * C0 + 0.5, [[0, 1, 0.2]] * 3, atol=1e-6)
    np.testing.assert_allclose(again.opacities, 0.4)


def test_harmonics_are_by_degree_then_by_channel(tmp_path: Path) -> None:
    data, _ = ksplat([bounded(1, 2)], 0)
    numbers = np.arange(24, dtype="<f4")
    again = read(tmp_path, data[: DATA + 44] + numbers.tobytes())
    np.testing.assert_array_equal(again.sh[0, 1:4], numbers[:9].reshape(3, 3).T)
    np.testing.assert_array_equal(again.sh[0, 4:9], numbers[9:].reshape(3, 5).T)


def test_bounds_of_8_bit_harmonics(tmp_path: Path) -> None:
    splats = bounded(20, 2)
    data, (written,) = ksplat([splats], 2, sh=(-2.0, 1.5))
    close(read(tmp_path, data), written, 2, sh=3.5)
    zeros = bytearray(ksplat([splats], 2)[0])
    zeros[36:44] = bytes(8)  # older writers: -1.5 to 1.5
    close(read(tmp_path, bytes(zeros)), ksplat([splats], 2)[1][0], 2)


GOOD = ksplat([bounded(10, 1)], 1, bucket=2)[0]  # some of its buckets are full


def changed(at: int, form: str, value: float, data: bytes = GOOD) -> bytes:
    out = bytearray(data)
    struct.pack_into("<" + form, out, at, value)
    return bytes(out)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (GOOD[:-1], r"truncated: section 0 ends at \d+ bytes, the file has \d+"),
        (GOOD[:5000], "truncated: the headers declare 5120 bytes, the file has 5000"),
        (GOOD[:600], "truncated: the headers declare 4096 bytes, the file has 600"),
        (changed(1, "B", 2), "KSPLAT is read in version 0.1, but this is 0.2"),
        (changed(20, "H", 3), "compression levels 0, 1 and 2, but this says 3"),
        (changed(4, "I", 2**32 - 1), "4294967295 sections is not supported; 16384 is the most"),
        (changed(4, "I", 16384), r"truncated: the headers declare 16781312 bytes, the file has \d+"),
        (changed(4, "I", 0), "the header says 10 splats, its sections hold 0"),
        (changed(16, "I", 11), "the header says 11 splats, its sections hold 10"),
        (changed(SECTION, "I", 11), "section 0 says 11 splats of 10 at most"),
        (changed(SECTION + 4, "I", 2**32 - 1), "truncated: section 0 ends at"),
        (changed(SECTION + 12, "I", 2**32 - 1), "truncated: section 0 ends at"),
        (changed(SECTION + 8, "I", 0), "the buckets of a section of 10 splats hold"),
        (changed(SECTION + 12, "I", 1), r"section 0 uses \d+ buckets of 1 for 10 splats"),
        (changed(SECTION + 20, "H", 16), "section 0 has 16 bytes a bucket; KSPLAT has 12"),
        (changed(SECTION + 32, "I", 2**32 - 1), r"section 0 uses \d+ buckets of"),
        (changed(SECTION + 40, "H", 3), "section 0 has SH degree 3; KSPLAT has 0 to 2"),
    ],
)
def test_refuses(tmp_path: Path, data: bytes, message: str) -> None:
    refused(tmp_path / "a.ksplat", data, message)


def test_what_is_none_is_not_taken_for_one(tmp_path: Path) -> None:
    font = b"\0\1\0\0\0\x10\1\0\0\4\0\0" + bytes(6000)  # TrueType: 16 tables
    for name, content in {"a.ttf": font, "b": bytes(6000), "c.ksplat": b"hello" * 2000}.items():
        (tmp_path / name).write_bytes(content)
        with pytest.raises(FormatError, match="none of them"):
            load(tmp_path / name)


def test_values_that_are_not_finite_are_kept(tmp_path: Path) -> None:
    data = bytearray(ksplat([bounded(2, 0)], 0)[0])
    struct.pack_into("<f", data, DATA, np.nan)
    struct.pack_into("<4f", data, DATA + 44 + 24, 0, 0, 0, 0)
    again = read(tmp_path, bytes(data))
    assert np.isnan(again.means[0, 0]) and not again.quats[1].any()
    with pytest.raises(FormatError, match="1 of 2 splats hold NaN or infinity"):
        load(tmp_path / "a", strict=True)


def test_a_real_file() -> None:
    """Four green, red, blue and white splats of 0.1 m at the corners of a square, of level 0."""
    splats = load(stored.DATA / "minimal.ksplat", strict=True)
    assert isinstance(splats, Splats) and (len(splats), splats.sh_degree) == (4, 0)
    assert splats.means.tolist() == [[-1, 0, -1], [0, 0, -1], [-1, 0, 0], [0, 0, 0]]
    np.testing.assert_allclose(splats.scales, 0.1)
    np.testing.assert_allclose(splats.opacities, 230 / 255)
