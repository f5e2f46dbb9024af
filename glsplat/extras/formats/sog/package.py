"""Files of a SOG: in a zip, read within limits and never unpacked to disk, or beside its meta.json; and its images.

Images have eight bits a channel, lossless; their size is checked before they are decoded.
"""

from __future__ import annotations

import struct
import zipfile
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import BinaryIO, cast

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError
from glsplat.io.files import open_regular

META = "meta.json"
_META_SIZE = 1 << 20  # bytes; other makers' have 2 to 20 kB
_ENTRIES = 1000  # of the zip's directory; a SOG has 6 to 9
_DIRECTORY = 1 << 18  # bytes of the zip's directory
_END = struct.Struct("<4s4H2LH")  # end record: mark, disks, entries, size and offset of the directory, comment
_COMMENT = 0xFFFF
_BROKEN = (zipfile.BadZipFile, zlib.error, struct.error, EOFError, OverflowError, RuntimeError, ValueError)

_HEAD = 1 << 12  # bytes in which the size must be
_CHUNKS = 16  # of a WebP, before its image


class SogFolder:
    """An open meta.json and the images in its folder."""

    def __init__(self, file: BinaryIO, size: int, folder: Path | None) -> None:
        self._file, self._size, self._folder = file, size, folder

    def meta(self) -> bytes:
        """Return the bytes of meta.json. Raises FormatError if there are too many."""
        self._file.seek(0)
        return self._file.read(_fitting(self._size))

    @contextmanager
    def open(self, name: str) -> Iterator[tuple[BinaryIO, int]]:
        """Open the image ``name``. Raises FormatError if it is outside the folder, even by a link."""
        if self._folder is None:
            raise FormatError("the images lie beside the meta.json, and an open file has no folder; give its path")
        folder = self._folder.resolve()
        try:
            path = (folder / _inside(name)).resolve()
        except (OSError, ValueError, RuntimeError):
            raise FormatError(f"the image {name!r:.60} is not the path of a file") from None
        if not path.is_relative_to(folder):
            raise FormatError(f"the image {name!r:.60} lies outside the folder of the meta.json")
        with open_regular(path) as (file, size):
            yield file, size

    def size(self, names: Iterable[str]) -> int:
        """Return the bytes of meta.json and of the images ``names``."""
        total = self._size
        for name in names:
            with self.open(name) as (_, size):
                total += size
        return total


class SogZip:
    """An open zip with a checked directory."""

    def __init__(self, file: BinaryIO, size: int) -> None:
        try:
            _check_directory(file, size)
            self._zip = zipfile.ZipFile(file)
        except _BROKEN as error:
            raise FormatError(f"a .sog is a zip, but {_line(error)}") from None
        # not is_dir(), which fails for an empty name
        entries = [i for i in self._zip.infolist() if not i.filename.endswith("/") and "__MACOSX" not in i.filename]
        if len(entries) > _ENTRIES:
            raise FormatError(f"a .sog has a handful of files, this zip {len(entries)}")
        self._size = size
        self._names: dict[str, list[zipfile.ZipInfo]] = {}
        for info in entries:
            self._names.setdefault(info.filename, []).append(info)
        # at the root, or in a single folder, as from archivers of folders
        found = [name for name in self._names if PurePosixPath(name).name == META and name.count("/") <= 1]
        if not found:
            inside = ", ".join(name[:40] for name in list(self._names)[:6]) or "nothing"
            raise FormatError(f"a .sog is a zip that holds {META}, this one holds {inside}")
        if len(found) > 1 and META not in found:
            raise FormatError(f"{len(found)} folders of the zip hold a {META}; pack each of them alone")
        self._root = "" if META in found else found[0].removesuffix(META)

    def meta(self) -> bytes:
        """Return the bytes of meta.json. Raises FormatError if there are too many."""
        with self.open(META) as (file, size):
            return file.read(_fitting(size))

    @contextmanager
    def open(self, name: str) -> Iterator[tuple[BinaryIO, int]]:
        """Open the member ``name``, unpacked while it is read; return it and its claimed size."""
        found = self._names.get(self._root + _inside(name), [])
        if not found:
            raise FormatError(f"{META} names {name!r:.60}, which the zip does not hold")
        info = found[0]
        if len(found) > 1:
            raise FormatError(f"{len(found)} files of the zip are called {name!r:.60}")
        if info.flag_bits & 1:
            raise FormatError(f"{name:.60} is encrypted; unpack the zip and pack it without a password")
        if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise FormatError(f"{name:.60} is packed by method {info.compress_type}; use store or deflate")
        if info.compress_size > self._size:
            raise FormatError(f"truncated: {name:.60} claims {info.compress_size} bytes, the zip has {self._size}")
        try:
            with self._zip.open(info) as file:
                yield file, info.file_size  # type: ignore[misc]
        except _BROKEN as error:
            raise FormatError(f"{name:.60} cannot be unpacked: {_line(error)}") from None

    def size(self, _: Iterable[str]) -> int:
        """Return the bytes of the zip."""
        return self._size


Package = SogFolder | SogZip


def is_zip(file: BinaryIO, size: int) -> bool:
    """Return whether an open file is a zip that holds a meta.json."""
    try:
        SogZip(file, size)
    except FormatError:
        return False
    return True


def _check_directory(file: BinaryIO, size: int) -> None:
    """Check the end record before zipfile reads the directory. Raises BadZipFile."""
    file.seek(max(size - _END.size - _COMMENT, 0))
    tail = file.read(_END.size + _COMMENT)
    at = len(tail) - _END.size
    if at < 0 or tail[at : at + 4] != b"PK\5\6" or tail[-2:] != b"\0\0":
        at = tail.rfind(b"PK\5\6")
    if at < 0 or at + _END.size > len(tail):
        raise zipfile.BadZipFile("it has no end record (truncated?)")
    _, _, _, _, entries, directory, _, _ = _END.unpack_from(tail, at)
    if b"PK\6\7" in tail[max(at - 20, 0) : at]:
        raise zipfile.BadZipFile("it is a ZIP64, for more than 4 GB; pack it without")
    if entries > _ENTRIES or directory > _DIRECTORY:
        raise zipfile.BadZipFile(f"its directory has {entries} entries in {directory} bytes, a .sog a handful")


def _inside(name: str) -> str:
    """Return ``name`` if it is relative and stays inside. Raises FormatError otherwise."""
    if not name or "\\" in name or ":" in name or "\0" in name or {"", ".", ".."} & set(name.split("/")):
        raise FormatError(f"{META} names its images relative to itself, not {name!r:.60}")
    return name


def _fitting(size: int) -> int:
    if size > _META_SIZE:
        raise FormatError(f"{META} has {_META_SIZE} bytes at most, this one {size}")
    return size


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:120] or type(error).__name__


def decoded(package: Package, name: str, least: int, most: int) -> NDArray[np.uint8]:
    """Decode RGBA [H, W, 4] of the image ``name``: lossless WebP, or PNG; without alpha it is 255.

    Raises FormatError before decoding if it has fewer than ``least`` or more than ``most`` pixels, or more bytes than
    its pixels can need.
    """
    import cv2  # not at the top, as it takes 0.1 s

    from glsplat.extras.formats.texture import decoded_silently

    with package.open(name) as (file, size):
        head = file.read(_HEAD)
        width, height = _size(head, name)
        if not least <= width * height <= most:
            raise FormatError(
                f"{name:.60} has {width} x {height} pixels, but needs {least} or somewhat more"
                if least < most
                else f"{name:.60} needs {least} pixels, not {width} x {height}"
            )
        if size > 5 * width * height + (1 << 16):
            raise FormatError(f"{name:.60} has {size} bytes, more than an image of {width} x {height} pixels can need")
        data = head + file.read(max(size - len(head), 0))
    image = decoded_silently(np.frombuffer(data, np.uint8))
    if image is None or image.dtype != np.uint8 or image.shape not in ((height, width, 3), (height, width, 4)):
        raise FormatError(f"{name:.60} cannot be decoded (damaged?)")
    turned = cv2.cvtColor(image, cv2.COLOR_BGRA2RGBA if image.shape[2] == 4 else cv2.COLOR_BGR2RGBA)
    return cast("NDArray[np.uint8]", turned)


def encoded(image: NDArray[np.uint8]) -> bytes:
    """Encode RGBA [H, W, 4] as lossless WebP; OpenCV 4.13 and newer keep colours with alpha 0."""
    import cv2

    # older versions have lossless as a quality above 100, and set colours with alpha 0 to black
    mode = getattr(cv2, "IMWRITE_WEBP_LOSSLESS_MODE", None)
    how = [cv2.IMWRITE_WEBP_QUALITY, 101] if mode is None else [mode, cv2.IMWRITE_WEBP_LOSSLESS_PRESERVE_COLOR]
    done, data = cv2.imencode(".webp", cv2.cvtColor(image, cv2.COLOR_RGBA2BGRA), how)
    if not done:
        raise FormatError(f"an image of {image.shape[1]} x {image.shape[0]} pixels cannot be encoded")
    return data.tobytes()


def _size(head: bytes, name: str) -> tuple[int, int]:
    """Return width and height from the header."""
    try:
        if head[:4] == b"RIFF" and head[8:12] == b"WEBP":
            return _webp_size(head, name)
        if head.startswith(b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR"):
            width, height, depth, kind = struct.unpack_from(">IIBB", head, 16)
            if depth != 8 or kind not in (2, 6):
                raise FormatError(f"{name:.60} needs 8 bits of RGB or RGBA, not {depth} bits of PNG type {kind}")
            return width, height
    except struct.error:
        pass
    raise FormatError(f"{name:.60} needs to be a WebP image without loss (or a PNG), but is none")


def _webp_size(head: bytes, name: str) -> tuple[int, int]:
    at = 12
    canvas = None
    for _ in range(_CHUNKS):
        tag, length = struct.unpack_from("<4sI", head, at)
        if tag == b"VP8L":
            mark, bits = struct.unpack_from("<BI", head, at + 8)
            size = 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
            if mark != 0x2F or canvas not in (None, size):
                break
            return size
        if tag == b"VP8X":
            flags, wide, low, high = struct.unpack_from("<I3s2sB", head, at + 8)
            canvas = 1 + int.from_bytes(wide, "little"), 1 + (int.from_bytes(low, "little") | high << 16)
            if flags & 2:
                raise FormatError(f"{name:.60} is an animation")
        if tag in (b"VP8 ", b"ALPH"):
            raise FormatError(f"{name:.60} is WebP with loss, so that its values are wrong; write it without")
        at += 8 + length + length % 2
    raise FormatError(f"{name:.60} needs to be a WebP image without loss, but its header is damaged")
