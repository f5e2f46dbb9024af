"""What a picture file says of itself before it is decoded: kind, size, EXIF data, whether it is whole."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

from glsplat.errors import FormatError

__all__ = ["ImageHeader", "read_header"]

_STARTS = ((b"\xff\xd8\xff", "JPEG"), (b"\x89PNG\r\n\x1a\n", "PNG"))
_ISO = {  # brands of ISO media files
    b"heic": "HEIC", b"heix": "HEIC", b"hevc": "HEIC", b"mif1": "HEIC", b"msf1": "HEIC", b"heim": "HEIC",
    b"avif": "AVIF", b"avis": "AVIF", b"crx ": "RAW",
}  # fmt: skip
_OTHERS = (
    (b"FUJIFILMCCD-RAW", "RAW"), (b"IIRO", "RAW"), (b"IIU\0", "RAW"), (b"FOVb", "RAW"),
    (b"II*\0", "RAW or TIFF"), (b"MM\0*", "RAW or TIFF"), (b"GIF8", "GIF"), (b"BM", "BMP"),
    (b"\0\0\0\x0cJXL ", "JPEG XL"), (b"\xff\x0a", "JPEG XL"), (b"\0\0\0\x0cjP  ", "JPEG 2000"), (b"%PDF", "PDF"),
)  # fmt: skip
_WAY_OUT = {
    "HEIC": "on an iPhone choose Settings, Camera, Formats, Most Compatible, or share it as JPEG",
    "RAW": "develop it and save it as JPEG",
    "RAW or TIFF": "develop it and save it as JPEG or PNG",
}
_FRAMES = {0xC0, 0xC1, 0xC2}  # baseline, extended, progressive; nothing else is in use
_NO_FRAMES = {0xC4, 0xC8, 0xCC}


@dataclass
class ImageHeader:
    """A file of a kind that is read."""

    kind: str
    """JPEG, PNG or WebP."""
    width: int = 0
    height: int = 0
    channels: int = 3
    """Of a JPEG: 1 grey, 3 colour, 4 ink (CMYK)."""
    exif: bytes = b""
    profile: bool = False
    """A colour profile is embedded."""


def read_header(data: bytes) -> ImageHeader:
    """Walk through the file's structure. Raises FormatError for other kinds, and for files that end too early."""
    kind = next((name for start, name in _STARTS if data.startswith(start)), "")
    if data[:4] == b"RIFF" and data[8:12] == b"WEBP":
        kind = "WebP"
    if not kind:
        raise FormatError(_refusal(data))
    header = ImageHeader(kind)
    try:
        {"JPEG": _jpeg, "PNG": _png, "WebP": _webp}[kind](data, header)
    except (struct.error, IndexError):
        raise FormatError(f"the {kind} file ends too early, after {len(data)} bytes; copy it again") from None
    if header.width < 1 or header.height < 1:
        raise FormatError(f"the {kind} file says no size; save the picture again")
    return header


def _refusal(data: bytes) -> str:
    if not data:
        return "the file is empty"
    found = next((name for start, name in _OTHERS if data.startswith(start)), "")
    if data[4:8] == b"ftyp":
        found = _ISO.get(data[8:12], "video")
    if not found:
        return f"expected a photograph (JPEG, PNG or WebP), found bytes that begin with {data[:4]!r}"
    return f"{found} is not read; {_WAY_OUT.get(found, 'save the picture as JPEG or PNG')}"


def _jpeg(data: bytes, header: ImageHeader) -> None:
    place = 2
    while True:
        if data[place] != 0xFF:
            raise FormatError("the JPEG file is damaged before its picture begins; copy it again")
        while data[place] == 0xFF:  # fill bytes are allowed
            place += 1
        marker = data[place]
        (length,) = struct.unpack_from(">H", data, place + 1)
        body = data[place + 3 : place + 1 + length]
        if marker == 0xDA:
            break
        if marker in _FRAMES and not header.width:
            header.height, header.width, header.channels = struct.unpack_from(">xHHB", body)
        elif 0xC0 <= marker <= 0xCF and marker not in _FRAMES | _NO_FRAMES:
            raise FormatError("this kind of JPEG (lossless or arithmetic) is not read; save the picture again")
        elif marker == 0xE1 and body.startswith(b"Exif\0\0") and not header.exif:
            header.exif = body
        elif marker == 0xE2 and body.startswith(b"ICC_PROFILE\0"):
            header.profile = True
        place += 1 + length
    if header.width and data.find(b"\xff\xd9", place) < 0:
        raise FormatError("the JPEG file ends in the middle of the picture; copy it again")


def _png(data: bytes, header: ImageHeader) -> None:
    place, last = 8, b""
    while last != b"IEND":
        length, last = struct.unpack_from(">I4s", data, place)
        body = memoryview(data)[place + 8 : place + 8 + length]
        (check,) = struct.unpack_from(">I", data, place + 8 + length)
        if zlib.crc32(body, zlib.crc32(last)) != check:
            raise FormatError(f"the PNG file is damaged (in its part {last.decode('latin-1')!r}); copy it again")
        if last == b"IHDR":
            header.width, header.height = struct.unpack_from(">II", body)
        elif last == b"eXIf":
            header.exif = bytes(body)
        elif last == b"iCCP":
            header.profile = True
        place += 12 + length


def _webp(data: bytes, header: ImageHeader) -> None:
    (length,) = struct.unpack_from("<I", data, 4)
    if length + 8 > len(data):
        raise struct.error
    place, end = 12, length + 8
    while place + 8 <= end:
        name, size = struct.unpack_from("<4sI", data, place)
        body = data[place + 8 : place + 8 + size]
        if name == b"VP8X":
            if body[0] & 2:
                raise FormatError("an animated WebP is no photograph; save one picture of it as JPEG or PNG")
            header.width = 1 + int.from_bytes(body[4:7], "little")
            header.height = 1 + int.from_bytes(body[7:10], "little")
        elif name == b"VP8 " and not header.width:
            width, height = struct.unpack_from("<6xHH", body)
            header.width, header.height = width & 0x3FFF, height & 0x3FFF
        elif name == b"VP8L" and not header.width:
            (bits,) = struct.unpack_from("<xI", body)
            header.width, header.height = 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
        elif name == b"EXIF":
            header.exif = body
        elif name == b"ICCP":
            header.profile = True
        place += 8 + size + (size & 1)
