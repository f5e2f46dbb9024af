"""Splat files of other programs: SOG, SPZ, KSPLAT, .splat, compressed PLY; meshes in OBJ."""

REQUIRES = ()
