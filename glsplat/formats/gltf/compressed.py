"""Splats that lie in a glTF file as the bytes of another format (KHR_gaussian_splatting_compression_spz_2)."""

from __future__ import annotations

from typing import Any

from glsplat.errors import FormatError
from glsplat.formats.gltf.container import Container, Primitive
from glsplat.formats.spz import spz_splats
from glsplat.splats import Splats

__all__ = ["SPZ_EXTENSION", "packed_splats", "packed_view"]

SPZ_EXTENSION = "KHR_gaussian_splatting_compression_spz_2"


def packed_view(extension: Any, name: str) -> int | None:
    """The bufferView that the value of KHR_gaussian_splatting says the splats are packed into, None where they are not.

    Raises FormatError for another compression than SPZ.
    """
    nested = extension.get("extensions") if isinstance(extension, dict) else None
    if not isinstance(nested, dict) or not any("compression" in key for key in nested):
        return None
    payload = nested.get(SPZ_EXTENSION)
    index = payload.get("bufferView") if isinstance(payload, dict) else None
    if type(index) is not int or index < 0:
        raise FormatError(f"{name}: the splats are compressed ({next(iter(nested))[:60]}); export them uncompressed")
    return index


def packed_splats(container: Container, primitive: Primitive, index: int, name: str) -> Splats:
    """The splats of that bufferView. The attributes of such a primitive are placeholders, which have their count.

    Raises FormatError where the counts differ.
    """
    splats = spz_splats(container.view(index, f"{name} {SPZ_EXTENSION}"))
    position, accessors = primitive.attributes.get("POSITION"), container.gltf.accessors
    if position is not None and position < len(accessors) and accessors[position].count != len(splats):
        raise FormatError(f"{name}: POSITION has {accessors[position].count} elements, its SPZ data {len(splats)}")
    return splats
