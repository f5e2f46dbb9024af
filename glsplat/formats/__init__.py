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

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
