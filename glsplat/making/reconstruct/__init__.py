"""From pictures of a person to an avatar."""

from .photos import from_photos, mesh_from_photos

__all__ = ["from_photos", "mesh_from_photos"]
