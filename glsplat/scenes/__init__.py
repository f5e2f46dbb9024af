"""Scenes from files: all that glsplat reads, by one door, scene files with what moves in them, and camera files."""

from __future__ import annotations

from typing import TYPE_CHECKING

from glsplat import on_demand

if TYPE_CHECKING:
    from glsplat.scenes.camera_file import camera_from_json, load_cameras, read_cameras
    from glsplat.scenes.loading import load
    from glsplat.scenes.scene_file import SceneFile, load_scene

__all__ = ["SceneFile", "camera_from_json", "load", "load_cameras", "load_scene", "read_cameras"]

_HOME = {
    **dict.fromkeys(("camera_from_json", "load_cameras", "read_cameras"), "camera_file"),
    **dict.fromkeys(("SceneFile", "load_scene"), "scene_file"),
    "load": "loading",
}

__getattr__ = on_demand(__name__, _HOME)
