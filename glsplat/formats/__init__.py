"""Readers and writers of splat files. ``load`` looks at the content, ``save`` at the suffix; FORMATS is what there is.

==========================  ======  ======  ============================================================
format                      read    write   holds
==========================  ======  ======  ============================================================
3DGS PLY (.ply)             yes     yes     splats, SH degree 0 to 3
compressed PLY              yes     yes     splats, SH degree 0 to 3, 16 bytes and up to 45 more a splat
.splat (32 bytes a splat)   yes     yes     splats, 8-bit colour and rotation
KSPLAT (.ksplat)            yes     no      splats, SH degree 0 to 2
SPZ 1 to 4 (.spz)           yes     2, 3    splats, SH degree 0 to 3 of 5 and 4 bits, 24-bit positions
SOG (.sog, meta.json)       yes     yes     splats, SH degree 0 to 3 from tables
glTF (.glb, .gltf)          yes     yes     splats (KHR_gaussian_splatting), avatars (with a skin)
==========================  ======  ======  ============================================================
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from glsplat.formats.format import Format
    from glsplat.formats.gltf.splats import load_gltf, save_gltf
    from glsplat.formats.ply import load_ply, save_ply
    from glsplat.formats.registry import FORMATS, load, losses, recognise, save, suffixes
    from glsplat.formats.sog.sog import load_sog, save_sog
    from glsplat.formats.splat import load_splat, save_splat

__all__ = [
    "FORMATS",
    "Format",
    "load",
    "load_gltf",
    "load_ply",
    "load_sog",
    "load_splat",
    "losses",
    "recognise",
    "save",
    "save_gltf",
    "save_ply",
    "save_sog",
    "save_splat",
    "suffixes",
]

_HOME = {
    "FORMATS": "registry",
    "Format": "format",
    "load": "registry",
    "load_gltf": "gltf.splats",
    "load_ply": "ply",
    "load_sog": "sog.sog",
    "load_splat": "splat",
    "losses": "registry",
    "recognise": "registry",
    "save": "registry",
    "save_gltf": "gltf.splats",
    "save_ply": "ply",
    "save_sog": "sog.sog",
    "save_splat": "splat",
    "suffixes": "registry",
}


def __getattr__(name: str) -> object:
    # on demand, as the root: who needs one module loads that one
    if name in _HOME:
        value = getattr(import_module(f"glsplat.formats.{_HOME[name]}"), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module 'glsplat.formats' has no attribute {name!r}")
