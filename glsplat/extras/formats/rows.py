"""This extra's formats in the registry."""

from __future__ import annotations

from glsplat.extras.formats.compressed_ply import COMPRESSED_PLY
from glsplat.extras.formats.ksplat import KSPLAT
from glsplat.extras.formats.obj import OBJ
from glsplat.extras.formats.person import PERSON
from glsplat.extras.formats.sog.sog import SOG
from glsplat.extras.formats.splat import SPLAT
from glsplat.extras.formats.spz import SPZ
from glsplat.formats.format import Format


def add_formats(formats: dict[str, Format]) -> None:
    """Add the formats to the registry."""
    formats |= {row.name: row for row in (COMPRESSED_PLY, SPLAT, KSPLAT, SPZ, SOG, OBJ, PERSON)}
