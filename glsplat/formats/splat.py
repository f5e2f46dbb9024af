""".splat: 32 bytes a splat (antimatter15's web viewer). Position and scale as float32 x 3, then RGBA and the
quaternion wxyz as 8 bits, 128 + 128 q. No header, no view-dependent colour.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from glsplat.errors import FormatError
from glsplat.formats.files import checked, naming, open_regular, replace_file
from glsplat.splats import SH_C0, Splats, normalised

__all__ = ["load_splat", "looks_like_splat", "save_splat"]

_RECORD = np.dtype([("mean", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("rot", "u1", 4)])
_CHUNK = 1 << 16  # splats written at a time
_PLAUSIBLE = 0.9  # of the splats; a capture may hold a few broken ones


def load_splat(path: str | Path, *, strict: bool = False) -> Splats:
    """Read a .splat file. Non-finite values are kept, or with ``strict`` refused.

    Raises FormatError when the size is no multiple of 32 bytes. An empty file holds no splats.
    """
    with naming(path):
        with open_regular(path) as (file, _):
            data = file.read()
        if len(data) % _RECORD.itemsize:
            raise FormatError(f"a .splat file has 32 bytes a splat, but this one has {len(data)} bytes (truncated?)")
        rows = np.frombuffer(data, _RECORD)
        rgba = rows["rgba"].astype(np.float32) / 255
        quats = normalised((rows["rot"].astype(np.float32) - 128) / np.float32(128))
        sh = (rgba[:, None, :3] - np.float32(0.5)) / np.float32(SH_C0)
        splats = Splats.create(rows["mean"], quats, rows["scale"], rgba[:, 3], sh)
        return checked(splats, path, strict)


def looks_like_splat(data: bytes) -> bool:
    """Whether bytes without any magic can be a .splat: most positions finite, most scales positive, and no text."""
    # digits and blanks are small positive floats, but a quaternion has bytes of 128 and more
    if not data or len(data) % _RECORD.itemsize or data[:4096].isascii():
        return False
    rows = np.frombuffer(data, _RECORD)
    mean, scale = rows["mean"], rows["scale"]
    good = (np.abs(mean) < 1e9).all(axis=1) & (scale > 0).all(axis=1) & (scale < 1e6).all(axis=1)
    return bool(good.mean() >= _PLAUSIBLE)


def save_splat(splats: Splats, path: str | Path) -> None:
    """Write a .splat file: degree 0 of the colour only, colour, opacity and rotation rounded to 8 bits.

    Raises FormatError when ``path`` cannot be written.
    """
    replace_file(path, _packed(splats))


def _packed(splats: Splats) -> Iterator[bytes]:
    for at in range(0, len(splats), _CHUNK):
        part = slice(at, at + _CHUNK)
        rows = np.empty(len(splats.means[part]), _RECORD)
        rows["mean"], rows["scale"] = splats.means[part], splats.scales[part]
        rgba = np.hstack([splats.sh[part, 0] * np.float32(SH_C0) + np.float32(0.5), splats.opacities[part, None]])
        rows["rgba"] = np.rint(np.clip(np.nan_to_num(rgba), 0, 1) * 255)
        rows["rot"] = np.clip(np.rint(np.nan_to_num(splats.quats[part]) * 128 + 128), 0, 255)
        yield rows.tobytes()
