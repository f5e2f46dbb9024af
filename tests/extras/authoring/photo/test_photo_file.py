"""Photographs as phones write them: orientations, kinds, sizes, damage; one line for what cannot be read."""

from __future__ import annotations

import io
import struct
import tracemalloc
import zlib

import numpy as np
import pytest
from PIL import Image

from glsplat.errors import FormatError
from glsplat.extras.authoring.photo import photo_file
from glsplat.extras.authoring.photo.photo_file import decode_photo, read_photo


def scene(width: int = 48, height: int = 64) -> np.ndarray:
    """Smooth, and different in every corner."""
    y, x = np.mgrid[0:height, 0:width]
    return np.stack([255 * x // width, 255 * y // height, 128 + 0 * x], -1).astype(np.uint8)


def packed(image: Image.Image, kind: str, **options: object) -> bytes:
    out = io.BytesIO()
    image.save(out, kind, **options)
    return out.getvalue()


def exif(orientation: int = 1, **inner: int) -> bytes:
    data = Image.Exif()
    data[0x0112] = orientation
    tags = {"focal": 0xA405, "width": 0xA002, "height": 0xA003}
    folder = data.get_ifd(0x8769)
    for name, value in inner.items():
        folder[tags[name]] = value
    return data.tobytes()


STORED = {  # what a camera writes for a scene when it says this orientation
    1: lambda a: a,
    2: lambda a: a[:, ::-1],
    3: lambda a: a[::-1, ::-1],
    4: lambda a: a[::-1],
    5: lambda a: a.swapaxes(0, 1),
    6: lambda a: np.rot90(a, 1),
    7: lambda a: np.rot90(a, 2).swapaxes(0, 1),
    8: lambda a: np.rot90(a, -1),
}


@pytest.mark.parametrize("orientation", STORED)
@pytest.mark.parametrize("kind", ["JPEG", "PNG", "WebP"])
def test_every_orientation_comes_out_upright(orientation: int, kind: str) -> None:
    stored = Image.fromarray(np.ascontiguousarray(STORED[orientation](scene())))
    options = {"JPEG": {"quality": 98, "subsampling": 0}, "PNG": {}, "WebP": {"lossless": True}}[kind]
    photo = decode_photo(packed(stored, kind, exif=exif(orientation), **options))
    assert photo.picture.shape == (64, 48, 3) and photo.size == (48, 64)
    assert np.abs(photo.picture.astype(int) - scene()).max() <= 6


@pytest.mark.parametrize("orientation", [0, 9])
def test_an_orientation_that_does_not_exist_is_none(orientation: int) -> None:
    photo = decode_photo(packed(Image.fromarray(scene()), "PNG", exif=exif(orientation)))
    assert np.array_equal(photo.picture, scene())


def test_kinds_of_pixels() -> None:
    rgb = Image.fromarray(scene())
    ink = decode_photo(packed(rgb.convert("CMYK"), "JPEG", quality=98)).picture
    assert np.abs(ink.astype(int) - scene()).mean() < 4
    for image in (rgb.convert("L"), rgb.convert("P"), rgb.convert("1"), rgb.convert("LA")):
        assert decode_photo(packed(image, "PNG")).picture.shape == (64, 48, 3)
    assert decode_photo(packed(rgb.convert("L"), "JPEG")).picture.shape == (64, 48, 3)
    deep = Image.fromarray(scene()[..., 0].astype(np.uint16) * 257)
    assert np.array_equal(decode_photo(packed(deep, "PNG")).picture[..., 1], scene()[..., 0])


def test_what_is_transparent_is_white() -> None:
    rgba = np.dstack([scene(), np.full((64, 48), 255, np.uint8)])
    rgba[:10, :, 3] = 0
    photo = decode_photo(packed(Image.fromarray(rgba), "PNG"))
    assert (photo.picture[:10] == 255).all() and np.array_equal(photo.picture[10:], scene()[10:])
    assert photo.notes == ("transparent parts were laid over white",)


def test_large_pictures_are_made_smaller_and_the_focal_length_with_them() -> None:
    large = Image.fromarray(scene(1638, 2184))
    photo = decode_photo(packed(large, "JPEG", exif=exif(1, focal=26, width=1638, height=2184)))
    assert photo.picture.shape == (2048, 1536, 3) and photo.size == (1638, 2184)
    assert photo.focal == pytest.approx(26 / 43.267 * 2560, rel=1e-3)
    assert photo.notes == ("1638 x 2184 pixels were reduced to 1536 x 2048",)


@pytest.mark.parametrize(
    "inner", [{}, {"focal": 0}, {"focal": 5}, {"focal": 60000}, {"focal": 26, "width": 4000, "height": 3000}]
)
def test_a_focal_length_that_cannot_be_true_is_none(inner: dict[str, int]) -> None:
    square = Image.fromarray(scene(64, 64))
    assert decode_photo(packed(square, "JPEG", exif=exif(6, **inner))).focal is None


def test_a_turned_picture_keeps_its_focal_length() -> None:
    stored = Image.fromarray(scene(64, 48))
    assert decode_photo(packed(stored, "JPEG", exif=exif(6, focal=50, width=64, height=48))).focal == pytest.approx(
        92.45, rel=1e-3
    )


def test_a_colour_profile_is_said() -> None:
    photo = decode_photo(packed(Image.fromarray(scene()), "JPEG", icc_profile=b"x" * 200))
    assert "profile is not applied" in photo.notes[0]


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"\0\0\0\x18ftypheic" + bytes(64), "HEIC is not read; on an iPhone choose Settings"),
        (b"\0\0\0\x18ftypavif" + bytes(64), "AVIF is not read; save the picture as JPEG or PNG"),
        (b"\0\0\0\x18ftypcrx " + bytes(64), "RAW is not read; develop it"),
        (b"\0\0\0\x18ftypisom" + bytes(64), "video is not read"),
        (b"II*\0" + bytes(64), "RAW or TIFF is not read; develop it"),
        (b"GIF89a" + bytes(64), "GIF is not read"),
        (b"", "the file is empty"),
        (b"hello", "expected a photograph (JPEG, PNG or WebP), found bytes that begin with b'hell'"),
    ],
)
def test_other_kinds_are_refused_with_the_way_out(tmp_path, data: bytes, message: str) -> None:
    path = tmp_path / "me.jpg"
    path.write_bytes(data)
    with pytest.raises(FormatError) as failed:
        read_photo(path)
    assert str(failed.value).startswith(f"{path}: {message}") and "\n" not in str(failed.value)


def png_of(width: int, height: int) -> bytes:
    """A tiny file that promises so many pixels."""
    parts = [
        (b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)),
        (b"IDAT", zlib.compress(b"")),
        (b"IEND", b""),
    ]
    chunks = (struct.pack(">I", len(b)) + n + b + struct.pack(">I", zlib.crc32(b, zlib.crc32(n))) for n, b in parts)
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


def test_bombs_are_refused_before_decoding(monkeypatch) -> None:
    for decoder in ("_decode_jpeg", "_decode_other"):
        monkeypatch.setattr(photo_file, decoder, lambda *_: pytest.fail("decoded"))
    with pytest.raises(FormatError, match=r"60000 x 60000 pixels are too many \(at most 64 megapixels"):
        decode_photo(png_of(60000, 60000))
    with pytest.raises(FormatError, match="31000 x 10 pixels are too many"):
        decode_photo(png_of(31000, 10))
    jpeg = bytearray(packed(Image.fromarray(scene()), "JPEG"))
    place = jpeg.index(b"\xff\xc0")
    jpeg[place + 5 : place + 9] = b"\xff\xff\xff\xff"
    with pytest.raises(FormatError, match="65535 x 65535 pixels are too many"):
        decode_photo(bytes(jpeg))
    monkeypatch.setattr(photo_file, "MAX_BYTES", 10)
    with pytest.raises(FormatError, match="at most"):
        decode_photo(bytes(11))


def test_hostile_metadata_neither_costs_memory_nor_warns() -> None:
    """EXIF entries that share the same bytes, an EXIF folder that is its own child, and compressed text that grows."""
    whole = packed(Image.fromarray(scene()), "PNG")

    def with_part(name: bytes, body: bytes) -> bytes:
        part = struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(body, zlib.crc32(name)))
        return whole[:33] + part + whole[33:]

    shared = b"".join(struct.pack("<HHII", tag, 7, 900_000, 8) for tag in range(60_000))
    cycle = struct.pack("<HHII", 0x8769, 4, 1, 8)
    for entries, count in ((shared, 60_000), (cycle, 1)):
        data = with_part(b"eXIf", b"II*\0" + struct.pack("<IH", 8, count) + entries + bytes(4))
        tracemalloc.start()
        photo = decode_photo(data)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert photo.focal is None and np.array_equal(photo.picture, scene()) and peak < 100e6
    with pytest.raises(FormatError, match="PNG file cannot be read"):
        decode_photo(with_part(b"zTXt", b"a\0\0" + zlib.compress(bytes(50_000_000))))
    wide = b"VP8X" + struct.pack("<I", 10) + bytes(4) + b"\xff\x3f\0" * 2
    with pytest.raises(FormatError, match="WebP file claims too many pixels"):
        decode_photo(b"RIFF" + struct.pack("<I", 4 + len(wide)) + b"WEBP" + wide)


@pytest.mark.parametrize("kind", ["JPEG", "PNG", "WebP"])
def test_truncated_files_are_refused(kind: str) -> None:
    data = packed(Image.fromarray(scene()), kind)
    for size in (12, len(data) // 3, len(data) // 2, len(data) - 2):
        with pytest.raises(FormatError):
            decode_photo(data[:size])


def test_a_folder_and_nothing(tmp_path) -> None:
    with pytest.raises(FormatError, match="directory"):
        read_photo(tmp_path)
    with pytest.raises(FormatError, match="No such file"):
        read_photo(tmp_path / "none.jpg")


def repaired(data: bytearray) -> bytearray:
    """A PNG file with right check sums, so that its damage reaches the decoder."""
    place = 8
    while place + 12 <= len(data):
        end = place + 8 + int.from_bytes(data[place : place + 4], "big")
        if end + 4 > len(data):
            break
        struct.pack_into(">I", data, end, zlib.crc32(data[place + 4 : end]))
        place = end + 4
    return data


NOISY = Image.fromarray(np.clip(scene() + np.random.default_rng(1).normal(0, 20, (64, 48, 3)), 0, 255).astype(np.uint8))


@pytest.mark.parametrize(
    ("kind", "image", "options"),
    [
        ("JPEG", NOISY, {"exif": exif(6, focal=26)}),
        ("JPEG", NOISY, {"progressive": True}),
        ("JPEG", NOISY.convert("CMYK"), {}),
        ("PNG", NOISY, {"exif": exif(3)}),
        ("WebP", NOISY, {"exif": exif(3)}),
        ("WebP", NOISY.convert("RGBA"), {"lossless": True}),
    ],
)
def test_fuzzed_files_give_a_picture_or_one_line(
    capfd: pytest.CaptureFixture[str], kind: str, image: Image.Image, options: dict[str, object]
) -> None:
    """Nothing else is raised, and the decoders print nothing."""
    whole, rng = packed(image, kind, **options), np.random.default_rng(7)
    for index in range(60):
        data = bytearray(whole)
        where = len(data) if index % 3 else min(len(data), 400)  # headers get a third of it
        place = int(rng.integers(0, where))
        if index % 4 < 2:
            for each in rng.integers(0, where, rng.integers(1, 9)):
                data[each] = rng.integers(256)
        elif index % 4 == 2:
            del data[place : place + int(rng.integers(1, 64))]
        else:
            data[place:place] = rng.bytes(int(rng.integers(1, 64)))
        try:
            photo = decode_photo(bytes(repaired(data) if kind == "PNG" and index % 5 else data))
            assert photo.picture.dtype == np.uint8 and photo.picture.ndim == 3
        except FormatError as error:
            assert "\n" not in str(error) and len(str(error)) < 300, error
    assert capfd.readouterr() == ("", "")
