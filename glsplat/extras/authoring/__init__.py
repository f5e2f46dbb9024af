"""Making avatars: from meshes, scans and other makers' files, offline; nothing here runs with a frame."""

from glsplat.optional import require_package

__all__ = ["mesh_truth"]

REQUIRES = ("formats", "rigs")

require_package("making avatars", "scipy", "authoring")
