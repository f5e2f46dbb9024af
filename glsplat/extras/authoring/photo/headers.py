"""Read an image file's kind, size, EXIF data and colour profile with Pillow, before its pixels are decoded."""

from __future__ import annotations

import io
import warnings
from dataclasses import dataclass

from PIL.Image import DecompressionBombError
from PIL.ImageFile import ImageFile
from PIL.JpegImagePlugin import JpegImageFile
from PIL.PngImagePlugin import PngImageFile
from PIL.WebPImagePlugin import WebPImageFile

from glsplat.errors import FormatError

# the readers themselves, not Image.open(), which warns about large pictures: the caller checks the size
_READERS: dict[str, type[ImageFile]] = {"JPEG": JpegImageFile, "PNG": PngImageFile, "WebP": WebPImageFile}
_SIGNATURES = ((b"\xff\xd8\xff", "JPEG"), (b"\x89PNG\r\n\x1a\n", "PNG"))
_END_MARKERS = {"JPEG": b"\xff\xd9", "PNG": b"IEND\xaeB`\x82", "WebP": b""}  # libwebp checks a WebP's length
_ISO_BRANDS = {  # of ISO media files
    b"heic": "HEIC", b"heix": "HEIC", b"hevc": "HEIC", b"mif1": "HEIC", b"msf1": "HEIC", b"heim": "HEIC",
    b"avif": "AVIF", b"avis": "AVIF", b"crx ": "RAW",
}  # fmt: skip
_OTHER_SIGNATURES = (
    (b"FUJIFILMCCD-RAW", "RAW"), (b"IIRO", "RAW"), (b"IIU\0", "RAW"), (b"FOVb", "RAW"),
    (b"II*\0", "RAW or TIFF"), (b"MM\0*", "RAW or TIFF"), (b"GIF8", "GIF"), (b"BM", "BMP"),
    (b"\0\0\0\x0cJXL ", "JPEG XL"), (b"\xff\x0a", "JPEG XL"), (b"\0\0\0\x0cjP  ", "JPEG 2000"), (b"%PDF", "PDF"),
)  # fmt: skip
_ADVICE = {
    "HEIC": "on an iPhone choose Settings, Camera, Formats, Most Compatible, or share it as JPEG",
    "RAW": "develop it and save it as JPEG",
    "RAW or TIFF": "develop it and save it as JPEG or PNG",
    "video": "glsplat avatar video makes an avatar of one, or save one picture of it as JPEG or PNG",
}


@dataclass(frozen=True)
class ImageHeader:
    """The header of a file of a supported kind."""

    kind: str
    """JPEG, PNG or WebP."""
    width: int
    height: int
    channels: int
    """1 for grey, 3 for colour, 4 for ink (CMYK) or transparency."""
    exif: bytes
    """Empty if the file has none."""
    profile: bool
    """A colour profile is embedded."""


def read_header(data: bytes) -> ImageHeader:
    """Parse the header and check that the file is whole. Raises FormatError for other kinds and damaged files."""
    kind = next((name for start, name in _SIGNATURES if data.startswith(start)), "")
    if data[:4] == b"RIFF" and data[8:12] == b"WEBP":
        kind = "WebP"
    if not kind:
        raise FormatError(_refusal(data))
    file = io.BytesIO(data)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about damaged metadata
            image = _READERS[kind](file)
            parsed = file.tell()  # bytes
            if kind == "PNG":
                image.verify()  # the check sums
    except DecompressionBombError:
        raise FormatError(f"the {kind} file claims too many pixels; save it smaller") from None
    except Exception as error:  # Pillow raises many types for damaged files
        text = " ".join(str(error).split())[:120]
        raise FormatError(f"the {kind} file cannot be read ({text}); copy it again or save it again") from None
    if data.find(_END_MARKERS[kind], parsed) < 0:
        raise FormatError(f"the {kind} file ends in the middle of the picture; copy it again")
    if isinstance(image, WebPImageFile) and image.is_animated:
        raise FormatError("an animated WebP is not a photograph; save one picture of it as JPEG or PNG")
    profile = image.info.get("icc_profile") is not None
    return ImageHeader(kind, *image.size, len(image.getbands()), image.info.get("exif", b""), profile)


def _refusal(data: bytes) -> str:
    if not data:
        return "the file is empty"
    found = next((name for start, name in _OTHER_SIGNATURES if data.startswith(start)), "")
    if data[4:8] == b"ftyp":
        found = _ISO_BRANDS.get(data[8:12], "video")
    if not found:
        return f"expected a photograph (JPEG, PNG or WebP), found bytes that begin with {data[:4]!r}"
    return f"{found} is not read; {_ADVICE.get(found, 'save the picture as JPEG or PNG')}"
