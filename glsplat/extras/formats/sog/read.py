"""Read splats from the images of a SOG."""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError
from glsplat.extras.formats.sog.images import decoded
from glsplat.extras.formats.sog.meta import BANDS, Meta, parse
from glsplat.extras.formats.sog.package import Package, SogFolder, SogZip
from glsplat.splats import Splats

_SPARE = 1 << 16  # pixels that an image may have beyond four times its splats
_SPLATS_A_BYTE, _FREE = 256, 1 << 16  # limit of a file's splats: for each byte, plus a constant
_CHUNK = 1 << 16  # splats decoded at a time
_PLACES = np.array([[0, 1, 2, 3], [1, 0, 2, 3], [1, 2, 0, 3], [1, 2, 3, 0]])  # of w x y z, by which is the largest


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
            three = parts[part[:, :3]]
            largest = np.sqrt(np.maximum(1 - (three * three).sum(axis=1, keepdims=True), 0))
            known = part[:, 3] >= 252
            order = _PLACES[np.where(known, part[:, 3], 252) - 252]
            turned = np.take_along_axis(np.hstack([largest, three]), order, axis=1)
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
