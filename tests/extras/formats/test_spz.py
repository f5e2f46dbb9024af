"""SPZ: bytes by hand, every version, round trips within the quantisation, hostile files, splats inside glTF."""

from __future__ import annotations

import gzip
import io
import struct
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from glsplat.errors import FormatError
from glsplat.extras.formats.spz import read_spz, save_spz
from glsplat.extras.formats.spz_packing import position_bits
from glsplat.formats import load, losses
from glsplat.formats.transform import transformed
from glsplat.splats import Splats
from tests.formats import test_contract as contract
from tests.formats.scenes import (
    assert_equal,
    awkward_splats,
    load_gltf,
    load_spz,
    random_avatar,
    random_splats,
    spz_streams,
    write_glb,
    zstd_frame,
)
from tests.formats.test_contract import peak_of
from tests.golden.stored import DATA

try:
    if sys.version_info >= (3, 14):
        import compression.zstd as _zstd
    else:
        import backports.zstd as _zstd
except ImportError:
    _zstd = None
needs_zstd = pytest.mark.skipif(_zstd is None, reason="no zstd: pip install 'glsplat[spz]'")

KHR = "KHR_gaussian_splatting"
COMPRESSION = f"{KHR}_compression_spz_2"
AXES = 0xADBE0003

HEADER = struct.pack("<4sIIBBBB", b"NGSP", 3, 2, 1, 12, 1, 0)
ATTRIBUTES = (
    bytes.fromhex("001800 00e0ff 000400  ffffff 000080 ffff7f"),  # 6144, -8192, 1024; -1, -2^23, 2^23 - 1
    bytes([51, 255]),
    bytes([255, 0, 128, 127, 128, 0]),
    bytes([160, 128, 176, 0, 255, 1]),
    struct.pack("<II", 3 << 30 | 300 << 20, 0 << 30 | (512 | 256) << 20 | 100 << 10),
    bytes([192, 64, 128, 192, 64, 128, 192, 64, 128]) + bytes([0] * 9),
)
PAYLOAD = HEADER + b"".join(ATTRIBUTES)
BODY = PAYLOAD[16:]
GZIPPED = gzip.compress(PAYLOAD, mtime=0)  # the same at each start: tests are named after it


def header(version: int = 3, count: int = 2, degree: int = 1, bits: int = 12, flags: int = 1) -> bytes:
    return struct.pack("<4sIIBBBB", b"NGSP", version, count, degree, bits, flags, 0)


def refused(folder: Path, content: bytes, message: str) -> None:
    contract.refused(folder / "a.spz", content, message, load_spz)


def spz(splats: Splats, version: int = 3) -> bytes:
    out = io.BytesIO()
    save_spz(splats, out, version=version)
    return out.getvalue()


def read(data: bytes) -> Splats:
    return load_spz(io.BytesIO(data))


def expected_by_hand(splats: Splats) -> None:
    limit = 2**23
    np.testing.assert_array_equal(splats.means, [[1.5, 2, -0.25], [-1 / 4096, limit / 4096, -(limit - 1) / 4096]])
    np.testing.assert_allclose(splats.opacities, [0.2, 1], rtol=1e-6)
    np.testing.assert_allclose(splats.sh[0, 0], [10 / 3, -10 / 3, 0.0130719], rtol=1e-5)
    np.testing.assert_allclose(splats.scales, np.exp([[0, -2, 1], [-10, 5.9375, -9.9375]]), rtol=1e-6)
    np.testing.assert_allclose(splats.quats[0], [0.9097616, 0.4151312, 0, 0], atol=1e-6)
    np.testing.assert_allclose(splats.quats[1], [0, 0.9248578, 0.3542461, -0.1383774], atol=1e-6)
    np.testing.assert_array_equal(splats.sh[0, 1:], [[-0.5, 0.5, 0], [-0.5, 0.5, 0], [0.5, -0.5, 0]])  # y, z, x
    np.testing.assert_array_equal(splats.sh[1, 1:, 0], [1, 1, -1])
    assert splats.antialias


@pytest.mark.parametrize("pack", [bytes, gzip.compress, lambda data: gzip.compress(data) + bytes(2)])
def test_two_splats_byte_by_byte(pack: Callable[[bytes], bytes]) -> None:
    """The figures are by hand; Niantic's library (npm @adobe/spz 0.2.3, into axes RDF) reads the same ones."""
    expected_by_hand(read(pack(PAYLOAD)))


def test_they_are_written_as_they_came() -> None:
    assert gzip.decompress(spz(read(PAYLOAD))) == PAYLOAD


@needs_zstd
def test_version_4_by_hand() -> None:
    expected_by_hand(read(spz_streams(gzip.compress(PAYLOAD))))


@needs_zstd
@pytest.mark.parametrize("degree", [0, 3])
def test_streams_of_zstd(degree: int) -> None:
    """Compressed ones, among them one of many blocks."""
    splats = random_splats(20_000, degree)
    stored = spz_streams(spz(splats))
    again = read(stored)
    assert_equal(again, read(spz(splats)))
    table = 32 + 16 * stored[15]
    packed, at = [], table
    for size, _ in struct.iter_unpack("<QQ", stored[32:table]):
        packed.append(_zstd.compress(_zstd.decompress(stored[at : at + size])))
        at += size
    sizes = [size for _, size in struct.iter_unpack("<QQ", stored[32:table])]
    entries = b"".join(struct.pack("<QQ", len(part), size) for part, size in zip(packed, sizes, strict=True))
    assert_equal(read(stored[:32] + entries + b"".join(packed)), again)


def test_version_1_has_half_floats() -> None:
    payload = struct.pack("<4sIIBBBB", b"NGSP", 1, 2, 0, 0, 0, 0) + struct.pack("<6e", 1, 2, 3, 4, np.nan, -np.inf)
    payload += bytes([255, 255]) + bytes([128] * 6) + bytes([160] * 6) + bytes([204, 102, 128, 255, 128, 255])
    splats = read(gzip.compress(payload))
    np.testing.assert_array_equal(splats.means, [[1, -2, -3], [4, np.nan, np.inf]])
    np.testing.assert_allclose(splats.quats[0], [0.7745869, 0.6, 0.2, -0.0039216], atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(splats.quats, axis=1), 1, atol=1e-6)  # the second is longer than one
    with pytest.raises(FormatError, match="1 of 2 splats hold NaN"):
        load_spz(io.BytesIO(payload), strict=True)


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_round_trip_within_half_a_step(degree: int, version: int) -> None:
    splats = random_splats(1000, degree)
    splats = replace(splats, sh=np.clip(splats.sh, -1, 0.9921875), antialias=bool(degree % 2))
    again = read(spz(splats, version))
    assert again.sh_degree == degree and again.antialias == splats.antialias
    np.testing.assert_allclose(again.means, splats.means, rtol=0, atol=0.5 / 4096 + 1e-9)
    np.testing.assert_allclose(again.opacities, splats.opacities, atol=0.5 / 255 + 1e-6)
    np.testing.assert_allclose(again.sh[:, 0], splats.sh[:, 0], atol=0.5 / 38.25 + 1e-6)
    np.testing.assert_allclose(np.log(again.scales), np.log(splats.scales), atol=0.5 / 16 + 1e-5)
    np.testing.assert_allclose(again.sh[:, 1:4], splats.sh[:, 1:4], atol=0.5 / 16 + 1e-6)
    np.testing.assert_allclose(again.sh[:, 4:], splats.sh[:, 4:], atol=0.5 / 8 + 1e-6)
    angles = np.degrees(4 * np.arcsin(np.minimum(apart(again.quats, splats.quats) / 2, 1)))
    assert angles.max() < (0.28 if version == 3 else 14) and angles.mean() < (0.1 if version == 3 else 1.5)
    assert read(spz(again, version)).means.tobytes() == again.means.tobytes()  # and no further


def apart(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Between quaternions, q and -q being one."""
    return np.minimum(np.linalg.norm(p - q, axis=1), np.linalg.norm(p + q, axis=1))


@pytest.mark.parametrize("version", [2, 3])
def test_the_turn_is_half_a_turn_around_x(version: int) -> None:
    """Of shapes and of the colours' directions too, by the code that turns the nodes of glTF."""
    data = spz(random_splats(100, 3), version)
    kept = read_spz(io.BytesIO(data), len(data), turn=False)
    turned = transformed(kept, np.diag([1.0, -1, -1, 1]))
    splats = read(data)
    np.testing.assert_allclose(splats.means, turned.means)
    np.testing.assert_allclose(covariances(splats), covariances(turned), atol=1e-6)
    np.testing.assert_allclose(splats.sh, turned.sh, atol=1e-6)


@pytest.mark.parametrize("version", [2, 3])
def test_awkward_splats_become_transparent(version: int) -> None:
    splats = awkward_splats()
    again = read(spz(splats, version))
    assert again.finite().all() and again.quats.any(axis=1).all()
    drawn = splats.finite() & splats.quats.any(axis=1)
    assert drawn.sum() == 4 and not again.opacities[~drawn].any() and not again.means[~drawn].any()
    assert again.opacities[7] == 0 and again.opacities[8] == 1
    np.testing.assert_allclose(again.scales[4], np.exp(-10), rtol=1e-6)  # as small as can be
    np.testing.assert_allclose(again.scales[5, 0], 0.5, rtol=0.033)  # a sign is without meaning


def test_losses_are_counted() -> None:
    splats = random_splats(1000, 1)
    splats = replace(splats, sh=np.clip(splats.sh, -1, 0.99), opacities=splats.opacities)
    assert any("rig of 5 joints" in line for line in losses(random_avatar(), "a.spz"))
    with pytest.raises(FormatError, match="version 2 or 3, not 4"):
        save_spz(splats, io.BytesIO(), version=4)
    assert [*losses(splats, "a.spz")] == ["spherical harmonics keep 5 bits in degree 1 and 4 above, between -1 and 1"]
    means, scales, sh, quats = (array.copy() for array in (splats.means, splats.scales, splats.sh, splats.quats))
    means[7, 1], means[8] = -5000, np.nan
    scales[:3], scales[3] = 1e-5, 1000
    sh[4, 0], sh[5:7, 1, 0] = 4, (1.5, -1.04)
    quats[9] = 0
    said = [*losses(replace(splats, means=means, scales=scales, sh=sh, quats=quats), "a.spz")]
    assert [line.split(" ")[0] for line in said] == ["2", "1", "3", "1", "1", "spherical"]
    assert "2048 m" in said[1] and "4.5e-05 m" in said[2] and "379 m" in said[3] and "2 of 8982" in said[5]
    again = read(spz(replace(splats, means=means)))
    assert again.means[7, 1] == -(2**23 - 1) / 4096 and again.means[8, 0] == 0  # in the file's axes, y is up
    assert not [*losses(replace(random_splats(), sh=np.zeros((50, 1, 3))), "a.spz")]


@pytest.mark.parametrize(("reach", "bits"), [(1, 12), (2000, 12), (5000, 10), (1e6, 3), (1e8, 0)])
def test_positions_of_a_large_scene_have_larger_steps(reach: float, bits: int) -> None:
    splats = random_splats(500)
    means = splats.means / np.abs(splats.means).max() * np.float32(reach)
    splats = replace(splats, means=means)
    assert position_bits(splats) == bits
    if reach < 1e7:
        np.testing.assert_allclose(read(spz(splats)).means, means, rtol=0, atol=0.5 / 2**bits + 1e-6 * reach)
        assert not any("moved" in line for line in losses(splats, "a.spz"))


def test_degree_4_is_cut_and_said(caplog: pytest.LogCaptureFixture) -> None:
    rest = np.arange(2 * 72) % 251
    payload = header(degree=4) + b"".join(ATTRIBUTES[:5]) + rest.astype(np.uint8).tobytes()
    splats = read(gzip.compress(payload))
    assert splats.sh_degree == 3 and "degree 4 are cut to degree 3 (2 splats)" in caplog.text
    np.testing.assert_array_equal(
        np.abs(splats.sh[:, 1:].ravel() * 128), np.abs(rest.reshape(2, 72)[:, :45].ravel() - 128)
    )


SYSTEMS = "LDB RDB LUB RUB LDF RDF LUF RUF LFD RFD LFU RFU LBD RBD LBU RBU".split()
WORDS = {"R": (1, 0, 0), "L": (-1, 0, 0), "D": (0, 1, 0), "U": (0, -1, 0), "F": (0, 0, 1), "B": (0, 0, -1)}


@pytest.mark.parametrize("code", [1, 4, 6, 7, 11, 12, 13, 14])
def test_axes_that_an_extension_names(code: int) -> None:
    """Position and shape of one splat, and the direction that its colour has, by the letters of the system."""
    splats = random_splats(20, 1)
    matrix = np.eye(4)
    matrix[:3, :3] = np.transpose([WORDS[letter] for letter in SYSTEMS[code - 1]])  # to right, down, front
    payload = bytearray(gzip.decompress(spz(splats)))  # as if its numbers were those of the system
    payload[14] |= 2
    other = struct.pack("<II", 0xADBE0002, 12) + bytes(12)
    named = bytes(payload) + other + struct.pack("<III", AXES, 4, code) + struct.pack("<II", 7, 99)  # no such bytes
    numbers = read_spz(io.BytesIO(spz(splats)), len(spz(splats)), turn=False)
    expected, found = transformed(numbers, matrix), read(gzip.compress(named))
    np.testing.assert_allclose(found.means, expected.means, atol=1e-6)
    np.testing.assert_allclose(found.sh, expected.sh, atol=1e-5)
    np.testing.assert_allclose(covariances(found), covariances(expected), atol=1e-6)
    if _zstd is not None:
        extension = struct.pack("<III", AXES, 4, code)
        np.testing.assert_allclose(read(spz_streams(spz(splats), extension)).means, expected.means, atol=1e-6)


def covariances(splats: Splats) -> Any:
    from glsplat.rotations import quaternion_matrices

    shapes = quaternion_matrices(splats.quats) * splats.scales[:, None, :]
    return shapes @ shapes.transpose(0, 2, 1)


def test_extensions_are_bounded(tmp_path: Path) -> None:
    payload = header(flags=2) + BODY
    assert len(read(payload + struct.pack("<III", AXES, 4, 0))) == 2  # 0: not said
    refused(tmp_path, payload + struct.pack("<III", AXES, 4, 17), "names system 17")
    refused(tmp_path, payload + struct.pack("<III", AXES, 4, 9), "axes LFD, which mean two things")
    refused(tmp_path, payload + bytes(1 << 16), "smaller than 65536")
    refused(tmp_path, gzip.compress(payload + bytes(10**7)), "smaller than 65536")


def glb_of(path: Path, payload: bytes, count: int, views: int = 1, **more: Any) -> None:
    extension = {KHR: {"extensions": {COMPRESSION: {"bufferView": 0}}}}
    document = {
        "asset": {"version": "2.0"},
        "extensionsUsed": [KHR, COMPRESSION],
        "extensionsRequired": [KHR, COMPRESSION, "KHR_materials_unlit"],
        "buffers": [{"byteLength": len(payload)}],
        "bufferViews": [{"buffer": 0, "byteLength": len(payload)}] * views,
        "accessors": [{"componentType": 5126, "type": "VEC3", "count": count}],
        "meshes": [{"primitives": [{"mode": 0, "attributes": {"POSITION": 0}, "extensions": extension}]}],
        "nodes": [{"mesh": 0, "translation": [1, 0, 0]}],
    }
    write_glb(path, document | more, payload + bytes(-len(payload) % 4))


def test_splats_inside_gltf_are_read_in_their_own_axes(tmp_path: Path) -> None:
    splats = replace(random_splats(30, 2), antialias=True)
    data = spz(splats, 2)
    glb_of(tmp_path / "a.glb", data, 30)
    found = load(tmp_path / "a.glb")
    expected = read_spz(io.BytesIO(data), len(data), turn=False)
    assert isinstance(found, Splats) and found.antialias
    np.testing.assert_allclose(found.means, expected.means + np.float32([1, 0, 0]), atol=1e-6)
    np.testing.assert_allclose(found.sh, expected.sh, atol=1e-6)


def test_splats_inside_gltf_that_are_refused(tmp_path: Path) -> None:
    path, data = tmp_path / "a.glb", spz(random_splats(30))
    primitives = [
        {"mode": 0, "extensions": {KHR: {"extensions": {COMPRESSION: {"bufferView": view}}}}} for view in (0, 1)
    ]
    meshes = [{"primitives": primitives}]
    for more, message in (
        ({"count": 31}, "POSITION has 31 elements, its SPZ data 30"),
        ({"bufferViews": []}, "bufferView of mesh 0 primitive 0 .* 0"),
        ({"bufferViews": [{"buffer": 0, "byteLength": len(data), "byteOffset": 1}]}, "its buffer ends before"),
        ({"bufferViews": [{"buffer": 0, "byteLength": len(data) - 3}]}, "has no end"),
        ({"views": 2, "meshes": meshes}, "overlap"),
        ({"meshes": [{"primitives": [primitives[0]] * 60}]}, None),
    ):
        glb_of(path, data, **{"count": 30} | more)  # type: ignore[arg-type]
        if message is None:
            assert len(load_gltf(path)) == 1800
        else:
            with pytest.raises(FormatError, match=message):
                load_gltf(path)


@pytest.mark.parametrize("name", ["raw", "v2", "v3", "v4"])
def test_files_of_splat_transform(name: str) -> None:
    """Four splats in a square, by four writers; the older two have z the other way around."""
    if name == "v4" and _zstd is None:
        pytest.skip("no zstd")
    splats = load(DATA / f"minimal-{name}.spz")
    z = 1 if name in ("raw", "v2") else -1
    np.testing.assert_array_equal(splats.means, [[-1, 0, z], [0, 0, z], [-1, 0, 0], [0, 0, 0]])
    np.testing.assert_allclose(splats.scales, np.exp(123 / 16 - 10), rtol=1e-6)
    np.testing.assert_allclose(splats.opacities, 230 / 255, rtol=1e-6)
    np.testing.assert_allclose(splats.quats, np.tile([1, 0, 0, 0], (4, 1)), atol=0.005)
    red = (0x69, 0x96) if name in ("v3", "v4") else (0x55, 0xAA)
    np.testing.assert_allclose(splats.sh[:2, 0, 0], (np.array(red) - 127.5) / 38.25, rtol=1e-5)


@pytest.mark.shared
def test_file_of_cesium(shared_data: Path) -> None:
    """One splat, whose POSITION accessor says (1, 2, 3), under a node that turns y up to z up."""
    splats = load(shared_data / "real/splats/khr_spz2_basic.glb")
    assert isinstance(splats, Splats) and len(splats) == 1
    np.testing.assert_allclose(splats.means, [[1, 3, -2]], atol=1e-6)
    np.testing.assert_allclose(splats.scales, np.exp([[3, 2, 1]]), rtol=1e-6)


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
    refused(tmp_path, spz_streams(gzip.compress(PAYLOAD)), r"pip install 'glsplat\[spz\]'")


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
