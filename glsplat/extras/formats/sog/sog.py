"""SOG as a Format: read and save splats, recognise the file, and list losses."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from glsplat.avatar import Avatar, splats_of
from glsplat.errors import FormatError
from glsplat.extras.formats.packed import with_largest
from glsplat.extras.formats.sog.meta import BANDS, MOST_SPLATS, Meta, parse
from glsplat.extras.formats.sog.package import META, Package, SogFolder, SogZip, decoded, is_zip
from glsplat.extras.formats.sog.quantise import palette_size
from glsplat.extras.formats.sog.write import drawn, packed, stored_order, write_folder, write_zip
from glsplat.formats.format import Format, Opened, clamped_opacities
from glsplat.io.files import Source, naming
from glsplat.splats import Splats

_SPARE = 1 << 16  # pixels that an image may have beyond four times its splats
_SPLATS_A_BYTE, _FREE = 256, 1 << 16  # limit of a file's splats: for each byte, plus a constant
_CHUNK = 1 << 16  # splats decoded at a time

_LARGEST = 1 << 20  # bytes of a meta.json


def read_sog(file: BinaryIO, size: int, folder: Path | None) -> Splats:
    """Read the splats of an open .sog, or of an open meta.json whose images are in ``folder``.

    Coordinates are the file's, those of its source PLY: SOG has no up axis. As in other readers, a rotation with an
    alpha outside 252 to 255 is the identity, and a label beyond the palette has coefficients of zero. Raises
    FormatError for any other mistake.
    """
    file.seek(0)
    package: Package = SogZip(file, size) if file.read(2) == b"PK" else SogFolder(file, size, folder)
    meta = parse(package.meta())
    held = package.size(meta.files.values())
    if meta.count > _FREE + _SPLATS_A_BYTE * held:
        raise FormatError(f"meta.json claims {meta.count} splats, which {held} bytes cannot hold")
    scene = _Scene(package, meta)
    means = scene.means()
    quats = scene.quats()
    scales = scene.scales()
    sh, opacities = scene.colours()
    for array in (means, quats, scales, opacities, sh):
        array.flags.writeable = False  # so that Splats need not copy
    return Splats(means, quats, scales, opacities, sh, meta.antialias)


class _Scene:
    def __init__(self, package: Package, meta: Meta) -> None:
        self._package, self._meta, self._count = package, meta, meta.count

    def means(self) -> NDArray[np.float32]:
        low, high = self._pixels("means_l"), self._pixels("means_u")
        means = np.empty((self._count, 3), np.float32)
        for axis in range(3):
            means[:, axis] = self._meta.means[axis][high[:, axis].astype(np.uint16) << 8 | low[:, axis]]
        return means

    def quats(self) -> NDArray[np.float32]:
        pixels = self._pixels("quats")
        parts = ((np.arange(256) / 255 * 2 - 1) / np.sqrt(2)).astype(np.float32)
        quats = np.empty((self._count, 4), np.float32)
        for at in range(0, self._count, _CHUNK):
            part = pixels[at : at + _CHUNK]
            known = part[:, 3] >= 252
            turned = with_largest(np.where(known, part[:, 3], 252) - 252, parts[part[:, :3]])
            quats[at : at + _CHUNK] = np.where(known[:, None], turned, np.array([1, 0, 0, 0], np.float32))
        return quats

    def scales(self) -> NDArray[np.float32]:
        pixels = self._pixels("scales")
        return np.stack([self._meta.scales[axis][pixels[:, axis]] for axis in range(3)], axis=1)

    def colours(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return SH coefficients [N, K, 3] and opacities [N]."""
        palette = self._palette()
        sh = np.empty((self._count, 1 + palette.shape[1], 3), np.float32)
        pixels = self._pixels("sh0")
        for channel in range(3):
            sh[:, 0, channel] = self._meta.colours[channel][pixels[:, channel]]
        opacities = self._meta.opacities[pixels[:, 3]]
        if palette.shape[1]:
            pixels = self._pixels("labels")
            for at in range(0, self._count, _CHUNK):
                part = pixels[at : at + _CHUNK]
                labels = part[:, 1].astype(np.intp) << 8 | part[:, 0]
                sh[at : at + _CHUNK, 1:] = palette[np.minimum(labels, len(palette) - 1)]
        return sh, opacities

    def _palette(self) -> NDArray[np.float32]:
        """Return sets of further coefficients [P + 1, K - 1, 3], the last of zeros; [1, 0, 3] without any."""
        meta = self._meta
        if meta.rest is None:
            return np.empty((1, 0, 3), np.float32)
        name = meta.files["centroids"]
        image = decoded(self._package, name, 1, 64 * BANDS[3] * 1024)
        height, width = image.shape[:2]
        bands = meta.bands or next((bands for bands in BANDS if 64 * BANDS[bands] == width), None)
        if bands is None or width != 64 * BANDS[bands]:
            wanted = " or ".join(str(64 * BANDS[one]) for one in ([bands] if bands else BANDS))
            raise FormatError(f"{name:.60} needs 64 sets of coefficients a row, {wanted} pixels, not {width}")
        count = min(meta.palette, height * 64)
        sets = image[..., :3].reshape(height * 64, BANDS[bands], 3)[:count]
        return np.concatenate([meta.rest[sets], np.zeros((1, BANDS[bands], 3), np.float32)])

    def _pixels(self, what: str) -> NDArray[np.uint8]:
        """Return the RGBA [N, 4] of the splats."""
        image = decoded(self._package, self._meta.files[what], self._count, 4 * self._count + _SPARE)
        return image.reshape(-1, 4)[: self._count]


def save_sog(splats: Splats, target: Source) -> None:
    """Write a SOG of version 2: a zip, or if ``target`` is a folder or called meta.json, unpacked there.

    Positions are rounded to 65536 steps between the lowest and the highest of sign(x) ln(1 + abs(x)) by axis (the error
    is at most half a step, times 1 + abs(x), in metres), the three smaller components of a rotation to steps of
    sqrt(2) / 255, opacities to steps of 1 / 255. Logarithms of scales and the first SH coefficients are rounded to 256
    numbers each, with errors of at most 1/60 of the range; up to 256 different ones are exact. The further
    coefficients share at most 65536 sets, the largest power of two that is not above the number of splats, whose values
    are also rounded to 256 numbers.

    Splats are in Morton order. Those that are not finite or have no rotation, which are never drawn, are left out.
    Scales are written as their magnitude, at least 1e-9. A failure leaves a folder unchanged. Raises FormatError if
    ``target`` cannot be written.
    """
    with naming(target):
        kept = drawn(splats)
        if len(kept) > MOST_SPLATS:
            raise FormatError(f"a SOG holds {MOST_SPLATS} splats at most, not {len(kept)}")
        folder = _folder(target)
        if folder is None:
            write_zip(target, packed(kept))
        else:
            write_folder(folder, packed(kept))


def _folder(target: Source) -> Path | None:
    """Return the folder of an unpacked SOG; None for a .sog."""
    if not isinstance(target, (str, bytes, os.PathLike)):
        return None
    name = os.fsdecode(target)
    path = Path(name)
    if path.name == META:
        return Path(os.path.realpath(path.parent))
    if path.suffix.lower() != ".sog" and (path.is_dir() or name.endswith(("/", os.sep))):
        return Path(os.path.realpath(path))
    return None


def _sniff(start: Opened) -> bool:
    if start.head.startswith(b"PK"):
        return start.named(*SOG.suffixes) or is_zip(start.file, start.size)
    head = start.head.removeprefix(b"\xef\xbb\xbf").lstrip()
    if not start.text or not head.startswith(b"{") or start.size > _LARGEST:
        return False
    text = start.spread()
    return all(name in text for name in (b'"means"', b'"scales"', b'"quats"', b'"sh0"')) and b'"accessors"' not in text


def _loses(scene: Splats | Avatar) -> Iterator[str]:
    splats = splats_of(scene)
    kept = drawn(splats)
    if len(kept) < len(splats):
        yield f"{len(splats) - len(kept)} splats that are not finite or have no rotation are dropped (none is drawn)"
    if splats.sh_degree and len(kept) > palette_size(len(kept)):
        yield (
            f"spherical harmonics of degree 1 to {splats.sh_degree} are kept as the nearest of "
            f"{palette_size(len(kept))} sets of coefficients, for {len(kept)} splats"
        )
    negative = int((kept.scales < 0).any(axis=1).sum())
    if negative:
        yield f"{negative} splats with negative scales are written with positive ones (their shape is the same)"
    yield from clamped_opacities(kept)


SOG = Format(
    name="sog",
    title="SOG (.sog, or its meta.json)",
    suffixes=(".sog", META),
    sniff=_sniff,
    load=lambda start: read_sog(start.file, start.size, start.folder),
    save=lambda scene, target: save_sog(splats_of(scene), target),
    loses=_loses,
    order=stored_order,
)
