"""Embedded data: the default avatar and its licence, motions and a recording."""

from __future__ import annotations

from functools import lru_cache
from importlib import resources

from glsplat.avatar import Avatar
from glsplat.formats.gltf import load_gltf

__all__ = ["default_avatar"]


@lru_cache(maxsize=1)
def default_avatar() -> Avatar:
    """The embedded person (about 40,000 splats, 55 SMPL-X joints; licence beside the file).

    >>> glsplat.default_avatar().skeleton
    Skeleton(55 joints: pelvis, left_hip, right_hip, ...)
    """
    with resources.as_file(resources.files("glsplat.data") / "default_avatar.glb") as path:
        scene = load_gltf(path)
    assert isinstance(scene, Avatar)
    return scene
