"""SOG as a Format: load, save, recognise, and list losses."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from glsplat.avatar import Avatar, splats_of
from glsplat.errors import FormatError
from glsplat.extras.formats.sog.meta import MOST_SPLATS
from glsplat.extras.formats.sog.output import write_folder, write_zip
from glsplat.extras.formats.sog.package import META, is_zip
from glsplat.extras.formats.sog.palette import palette_size
from glsplat.extras.formats.sog.read import read_sog
from glsplat.extras.formats.sog.write import drawn, packed, stored_order
from glsplat.formats.format import Format, Opened, clamped_opacities
from glsplat.io.files import Source, naming
from glsplat.splats import Splats

_LARGEST = 1 << 20  # bytes of a meta.json


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
