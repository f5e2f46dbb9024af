"""Readers and writers of splats, avatars and meshes. ``load`` looks at the content, ``save`` at the suffix.

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
glTF, VRM of triangles      yes     no      meshes, rigged or standing (written by gltf.meshes.write)
OBJ (.obj)                  yes     no      standing meshes
a person or body (.npz)     yes     no      rigged meshes
==========================  ======  ======  ============================================================
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from glsplat import on_demand

if TYPE_CHECKING:
    from glsplat.formats.format import Format
    from glsplat.formats.gltf.splats import load_gltf, save_gltf
    from glsplat.formats.ply import load_ply, save_ply
    from glsplat.formats.registry import FORMATS, load, load_splats, losses, recognise, save, suffixes
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
    "load_splats",
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
    "load_splats": "registry",
    "losses": "registry",
    "recognise": "registry",
    "save": "registry",
    "save_gltf": "gltf.splats",
    "save_ply": "ply",
    "save_sog": "sog.sog",
    "save_splat": "splat",
    "suffixes": "registry",
}


__getattr__ = on_demand(__name__, _HOME)
