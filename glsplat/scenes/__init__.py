"""Scenes from files: everything that glsplat reads, by one door, and scene files with what moves in them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from glsplat import on_demand

if TYPE_CHECKING:
    from glsplat.scenes.loading import load
    from glsplat.scenes.scene_file import SceneFile, load_scene

__all__ = ["SceneFile", "load", "load_scene"]

_HOME = {"SceneFile": "scene_file", "load": "loading", "load_scene": "scene_file"}

__getattr__ = on_demand(__name__, _HOME)
