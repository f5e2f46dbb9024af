"""GLSL: chunks put together to programs by a variant, compiled for a context or handed to a page."""

from __future__ import annotations

from typing import TYPE_CHECKING

from glsplat import on_demand

if TYPE_CHECKING:
    from glsplat.shaders.programs import Programs, link
    from glsplat.shaders.source import Source, flatten
    from glsplat.shaders.variant import (
        MeshVariant,
        ResolveVariant,
        SkinVariant,
        Variant,
        record_layout,
        variant_for,
    )

__all__ = [
    "MeshVariant",
    "Programs",
    "ResolveVariant",
    "SkinVariant",
    "Source",
    "Variant",
    "flatten",
    "link",
    "record_layout",
    "variant_for",
]

_HOME = {
    **dict.fromkeys(("Programs", "link"), "programs"),
    **dict.fromkeys(("Source", "flatten"), "source"),
    **dict.fromkeys(
        ("MeshVariant", "ResolveVariant", "SkinVariant", "Variant", "record_layout", "variant_for"), "variant"
    ),
}

__getattr__ = on_demand(__name__, _HOME)
