""".splat: 32 bytes a splat (antimatter15's web viewer). Position and scale as float32 x 3, then RGBA and the
quaternion wxyz as 8 bits, 128 + 128 q. No header, no view-dependent colour.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from glsplat.avatar import Avatar, splats_of
from glsplat.errors import FormatError
from glsplat.extras.formats.packed import read_rows
from glsplat.formats.format import Format, Opened, clamped_opacities, positive_scales
from glsplat.io.files import Source, replace_file, sampled
from glsplat.splats import SH_C0, Splats, normalised

_RECORD = np.dtype([("mean", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("rot", "u1", 4)])
_CHUNK = 1 << 16  # splats written at a time
_HALF = 0.5 / 255  # of a step of colours
_PLAUSIBLE = 0.9  # of the splats; a capture may hold a few broken ones


def read_splat(file: BinaryIO, size: int) -> Splats:
    """Read an open file of ``size`` bytes; non-finite values are kept. Raises FormatError if 32 does not divide it."""
    if size % _RECORD.itemsize:
        raise FormatError(f"a .splat file has 32 bytes a splat, but this one has {size} bytes (truncated?)")
    if _holes(np.frombuffer(sampled(file, 0, size), _RECORD)) > 1 - _PLAUSIBLE:
        raise FormatError("no .splat file: much of it is zero bytes (a hole?)")
    count = size // _RECORD.itemsize
    means, scales = np.empty((2, count, 3), np.float32)
    quats, opacities = np.empty((count, 4), np.float32), np.empty(count, np.float32)
    sh = np.empty((count, 1, 3), np.float32)
    for at in range(0, count, _CHUNK):
        part = slice(at, min(at + _CHUNK, count))
        rows = read_rows(file, at * _RECORD.itemsize, part.stop - at, _RECORD)
        rgba = rows["rgba"].astype(np.float32) / 255
        means[part], scales[part], opacities[part] = rows["mean"], rows["scale"], rgba[:, 3]
        # twice, as ``normalised`` does not change quaternions that are nearly unit
        quats[part] = normalised(normalised((rows["rot"].astype(np.float32) - 128) / np.float32(128)))
        sh[part, 0] = (rgba[:, :3] - np.float32(0.5)) / np.float32(SH_C0)
    return Splats(means, quats, scales, opacities, sh)


def looks_like_splat(data: bytes, *, named: bool = False) -> bool:
    """Return whether bytes can be a .splat: most positions finite, most scales positive, and no text.

    In files ``named`` .splat, flat and non-finite splats pass too, unless scales are negative.
    """
    # digits and blanks are small positive floats, but a quaternion has bytes of 128 and more
    if not data or len(data) % _RECORD.itemsize or data[:4096].isascii():
        return False
    rows = np.frombuffer(data, _RECORD)
    mean, scale = rows["mean"], rows["scale"]
    if named:
        return bool((scale < 0).any(axis=1).mean() <= 1 - _PLAUSIBLE and _holes(rows) <= 1 - _PLAUSIBLE)
    good = (np.abs(mean) < 1e9).all(axis=1) & (scale > 0).all(axis=1) & (scale < 1e6).all(axis=1)
    return bool(good.mean() >= _PLAUSIBLE)


def _holes(rows: NDArray[np.void]) -> float:
    """Return the share of zero records: even a splat of zeros has 128s in its quaternion."""
    return float(1 - rows.view(np.uint64).reshape(-1, 4).any(axis=1).mean()) if len(rows) else 0.0


def save_splat(splats: Splats, target: Source) -> None:
    """Write a .splat file with SH degree 0; colour, opacity and rotation are rounded to 8 bits.

    A negative scale is written as its magnitude, a rotation as the quaternion with w >= 0: the splat is the same. A
    splat whose colour, opacity or rotation is not finite, which is never drawn, becomes transparent. Raises
    FormatError if ``target`` cannot be written.
    """
    replace_file(target, _packed(splats))


def hidden(which: NDArray[np.bool_]) -> Iterator[str]:
    """Yield a format's loss for splats ``which`` [N] that are never drawn, and whose values it cannot store."""
    if which.any():
        yield f"{int(which.sum())} splats that are never drawn (not finite, or a zero quaternion) become transparent"


def _hidden(splats: Splats) -> NDArray[np.bool_]:
    """Return [N] whether an 8-bit attribute is not finite; such splats become transparent."""
    kept = np.isfinite(splats.quats).all(axis=1) & np.isfinite(splats.opacities)
    return ~(kept & np.isfinite(splats.sh).all(axis=(1, 2)))


def _packed(splats: Splats) -> Iterator[bytes]:
    unseen = _hidden(splats)
    for at in range(0, len(splats), _CHUNK):
        part = slice(at, at + _CHUNK)
        rows = np.empty(len(splats.means[part]), _RECORD)
        rows["mean"], rows["scale"] = splats.means[part], np.abs(splats.scales[part])
        opacities = np.where(unseen[part], 0, splats.opacities[part])
        rgba = np.hstack([splats.sh[part, 0] * np.float32(SH_C0) + np.float32(0.5), opacities[:, None]])
        rows["rgba"] = np.rint(np.clip(np.nan_to_num(rgba), 0, 1) * 255)
        quats = np.clip(np.nan_to_num(splats.quats[part]), -1, 1)
        quats = np.where(quats[:, :1] < 0, -quats, quats)  # w >= 0 is a byte of 128 or more, so a file is never text
        rows["rot"] = np.clip(np.rint(quats * 128 + 128), 0, 255)
        yield rows.tobytes()


def _sniff(start: Opened) -> bool:
    if not start.head:
        return start.named(*SPLAT.suffixes)  # no splats
    if start.size % _RECORD.itemsize:
        return False
    data = start.spread()
    return looks_like_splat(data) or (start.named(*SPLAT.suffixes) and looks_like_splat(data, named=True))


def _loses(scene: Splats | Avatar) -> Iterator[str]:
    splats = splats_of(scene)
    if splats.sh_degree:
        yield f"spherical harmonics of degree {splats.sh_degree} are dropped, the file holds degree 0"
    if splats.antialias:
        yield "the flag for opacity compensation is dropped; draw the splats with --antialias"
    yield from hidden(_hidden(splats))
    yield from clamped_opacities(scene)
    yield from positive_scales(scene)
    with np.errstate(invalid="ignore"):  # below 0 they are drawn as 0
        bright = int((splats.sh[:, 0] * SH_C0 + 0.5 > 1 + _HALF).any(axis=1).sum())
    if bright:
        yield f"{bright} splats have colours above 1, which are clamped"


SPLAT = Format(
    name="splat",
    title=".splat",
    suffixes=(".splat",),
    sniff=_sniff,
    load=lambda start: read_splat(start.file, start.size),
    save=lambda scene, target: save_splat(splats_of(scene), target),
    loses=_loses,
    marked=False,
)
