"""Making avatars: from meshes, photographs, videos and other makers' files, offline; nothing here runs with a frame.

The packages are the steps, in this order, and none imports a later one: photo, segment, check, fit, dress, paint,
sample, optimize, faces and light, finish. Below them are compute, models, geometry, networks and body; importers,
video and reconstruct call them.
"""

from glsplat.optional import require_package

__all__ = ["mesh_truth"]

REQUIRES = ("formats", "rigs")

require_package("making avatars", "scipy", "authoring")
