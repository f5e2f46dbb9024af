"""Write a SOG atomically, as one file or as a folder."""

from __future__ import annotations

import hashlib
import io
import os
import re
import zipfile
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

import msgspec

from glsplat.errors import FormatError
from glsplat.extras.formats.sog.package import META
from glsplat.io.files import Source, replace_file

# names of a SOG's images: only these are deleted with a meta.json that lists them
_OURS = re.compile(r"(means_[lu]|scales|quats|sh0|shN_(centroids|labels))(\.[0-9a-f]{12})?\.webp")

Files = Iterable[tuple[str, bytes]]


def write_zip(target: Source, files: Files) -> None:
    """Write one zip without compression, as the images have it. The same files give the same bytes."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_STORED) as archive:
        for name, data in files:
            info = zipfile.ZipInfo(name)  # dated 1980, for the same bytes at any time
            info.create_system, info.external_attr = 3, 0o644 << 16
            archive.writestr(info, data)
    replace_file(target, [packed.getbuffer()])


def write_folder(folder: Path, files: Files) -> None:
    """Write the files to ``folder``, which is created if absent (its parents are not).

    Images get unused names, and meta.json is replaced last, by a rename: readers find either all new or all old files,
    even after a failure. The images of the old meta.json are deleted at the end.
    """
    made: list[Path] = []
    try:
        if not folder.is_dir():
            folder.mkdir()
            made.append(folder)
        old = _named_by(folder / META)
        new: dict[str, str] = {}
        for name, data in files:
            if name != META:
                new[name] = _free(folder, name, data)
                path = folder / new[name]
                if not _same(path, data):
                    fresh = not os.path.lexists(path)  # else a partial file of a power cut
                    replace_file(path, [data])
                    if fresh:
                        made.append(path)
                continue
            for standard, chosen in new.items():
                data = data.replace(b'"%s"' % standard.encode(), b'"%s"' % chosen.encode())
            replace_file(folder / META, [data])
    except BaseException as error:
        for path in reversed(made):
            with suppress(OSError):
                (Path.rmdir if path == folder else Path.unlink)(path)
        if isinstance(error, OSError):
            raise FormatError(f"{folder}: cannot be written ({error.strerror or error})") from None
        raise
    for name in old - set(new.values()):
        with suppress(OSError):
            os.unlink(folder / name)


def _free(folder: Path, name: str, data: bytes) -> str:
    """Return ``name`` if it is free, else with a part of the hash of ``data``."""
    if not os.path.lexists(folder / name) or _same(folder / name, data):
        return name
    return f"{Path(name).stem}.{hashlib.sha256(data).hexdigest()[:12]}{Path(name).suffix}"


def _same(path: Path, data: bytes) -> bool:
    return not path.is_symlink() and path.is_file() and path.stat().st_size == len(data) and path.read_bytes() == data


def _named_by(path: Path) -> set[str]:
    """Return the images of an older meta.json with names of a SOG; none if it cannot be read."""
    try:
        text = path.read_bytes() if path.stat().st_size < 1 << 20 else b""
        found = msgspec.json.decode(text, type=dict[str, object]).values()
    except (OSError, msgspec.MsgspecError, RecursionError, UnicodeDecodeError):
        return set()
    lists = [entry.get("files") for entry in found if isinstance(entry, dict)]
    names = {name for files in lists if isinstance(files, list) for name in files if isinstance(name, str)}
    return {name for name in names if _OURS.fullmatch(name)}
