"""Write SOG version 2: splats along a Morton curve, as the pixels of images, as one file or as a folder."""

from __future__ import annotations

import hashlib
import io
import math
import os
import re
import zipfile
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError
from glsplat.extras.formats.packed import morton_order, smallest_three
from glsplat.extras.formats.sog.package import META, encoded
from glsplat.extras.formats.sog.quantise import codebook, palette, palette_size
from glsplat.io.files import Source, replace_file
from glsplat.splats import Splats

# names of a SOG's images: only these are deleted with a meta.json that lists them
_OURS = re.compile(r"(means_[lu]|scales|quats|sh0|shN_(centroids|labels))(\.[0-9a-f]{12})?\.webp")

Files = Iterable[tuple[str, bytes]]

SMALLEST = 1e-9  # smallest standard deviation in a file, metres, as zero has no logarithm

_STEPS = 65535
_ROW = 64  # sets of coefficients in a row of the palette's image

Image = NDArray[np.uint8]


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


def drawn(splats: Splats) -> Splats:
    """Return the splats that a SOG can hold: finite ones with a rotation. Others are never drawn."""
    kept = splats.drawable()
    return splats if kept.all() else splats.take(kept)


def stored_order(splats: Splats) -> NDArray[np.intp]:
    """Return the indices of a SOG's splats, in its order."""
    kept = np.flatnonzero(splats.drawable())
    return kept[_along(_steps(splats.means[kept])[2])]


def _along(steps: NDArray[np.uint16]) -> NDArray[np.intp]:
    """Return the Morton order of the stored positions, so that reading and writing a file keeps it."""
    return morton_order(steps.astype(np.float32))


def packed(splats: Splats) -> Iterator[tuple[str, bytes]]:
    """Yield name and bytes of the files, meta.json last, for at most 16380 squared ``drawn`` splats."""
    count = len(splats)
    low, high, steps = _steps(splats.means)
    order = _along(steps)
    width = max(4, math.ceil(math.sqrt(count) / 4) * 4)
    shape = max(4, math.ceil(count / width / 4) * 4), width
    meta: dict[str, Any] = {"version": 2, "asset": {"generator": "glsplat"}, "count": count}
    meta["antialias"] = splats.antialias
    if splats.antialias:  # splat-transform's name since 3.2
        meta["model"] = "antialiased"
    meta["means"] = {"mins": low.tolist(), "maxs": high.tolist(), "files": ["means_l.webp", "means_u.webp"]}
    yield "means_l.webp", _image((steps & 255)[order], shape)
    yield "means_u.webp", _image((steps >> 8)[order], shape)
    book, index = codebook(np.log(np.maximum(np.abs(splats.scales), SMALLEST)))
    meta["scales"] = {"codebook": book.tolist(), "files": ["scales.webp"]}
    yield "scales.webp", _image(index[order], shape)
    meta["quats"] = {"files": ["quats.webp"]}
    yield "quats.webp", _image(_rotations(splats.quats)[order], shape)
    book, index = codebook(splats.sh[:, 0])
    opacities = np.rint(np.clip(splats.opacities, 0, 1) * 255).astype(np.uint8)
    meta["sh0"] = {"codebook": book.tolist(), "files": ["sh0.webp"]}
    yield "sh0.webp", _image(np.column_stack([index, opacities])[order], shape)
    if splats.sh_degree and count:
        rows = splats.sh[order, 1:].reshape(count, -1)
        sets, labels = palette(rows, palette_size(count))
        sets, labels = _by_place(sets, labels)
        book, index = codebook(sets)
        names = ["shN_centroids.webp", "shN_labels.webp"]
        meta["shN"] = {"count": len(sets), "bands": splats.sh_degree, "codebook": book.tolist(), "files": names}
        lines = math.ceil(len(sets) / _ROW)
        yield names[0], _image(index.reshape(-1, 3), (lines, _ROW * (rows.shape[1] // 3)))
        yield names[1], _image(np.column_stack([labels & 255, labels >> 8]).astype(np.uint8), shape)
    yield META, msgspec.json.encode(meta)


def _steps(means: NDArray[np.float32]) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.uint16]]:
    """Return the bounds of sign(x) ln(1 + abs(x)) by axis, and 16 bits between them for each."""
    if not len(means):
        return np.zeros(3), np.zeros(3), np.zeros((0, 3), np.uint16)
    logs = np.sign(means) * np.log1p(np.abs(means.astype(np.float64)))
    low, high = logs.min(axis=0), logs.max(axis=0)
    wide = np.where(high > low, high - low, 1)
    return low, high, np.rint((logs - low) / wide * _STEPS).astype(np.uint16)


def _rotations(quats: NDArray[np.float32]) -> Image:
    """Return [N, 4]: the three smaller components, signed so that the fourth is positive, and its index."""
    largest, three = smallest_three(quats.astype(np.float64))
    pixels = np.rint((three * math.sqrt(0.5) + 0.5) * 255)
    return np.column_stack([np.clip(pixels, 0, 255), 252 + largest]).astype(np.uint8)


def _by_place(sets: NDArray[np.float32], labels: NDArray[np.int64]) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Order the palette by the mean position of its sets in the file, so that neighbours have close labels."""
    met = np.bincount(labels, np.arange(len(labels)), len(sets)) / np.bincount(labels, minlength=len(sets))
    order = np.argsort(met, kind="stable")
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    return sets[order], place[labels]


def _image(pixels: NDArray[np.integer], shape: tuple[int, int]) -> bytes:
    """Return a WebP of [N, 2 to 4] channels; missing RGB is 0, missing alpha and pixels are opaque black."""
    image = np.zeros((shape[0] * shape[1], 4), np.uint8)
    image[:, 3] = 255
    image[: len(pixels), : pixels.shape[1]] = pixels
    return encoded(image.reshape(*shape, 4))
