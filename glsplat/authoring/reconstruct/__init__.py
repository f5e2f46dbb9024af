"""From pictures of a person to an avatar."""

from __future__ import annotations

from typing import TYPE_CHECKING

from glsplat import on_demand

if TYPE_CHECKING:
    from glsplat.authoring.reconstruct.photos import check_photos, from_photos, mesh_from_photos, reconstruct
    from glsplat.authoring.reconstruct.reconstructor import Options
    from glsplat.authoring.reconstruct.video import from_video

__all__ = ["Options", "check_photos", "from_photos", "from_video", "mesh_from_photos", "reconstruct"]

_HOME = {
    "Options": "reconstructor",
    "check_photos": "photos",
    "from_photos": "photos",
    "from_video": "video",
    "mesh_from_photos": "photos",
    "reconstruct": "photos",
}

__getattr__ = on_demand(__name__, _HOME)
