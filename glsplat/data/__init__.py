"""Embedded data: the default avatar, motions, a recording, participants, and the licences beside them."""

from __future__ import annotations

from functools import lru_cache
from importlib import resources
from pathlib import Path

from glsplat.avatar import Avatar
from glsplat.errors import FormatError
from glsplat.formats.gltf.splats import load_gltf

__all__ = ["default_avatar", "participants_folder"]


@lru_cache(maxsize=1)
def default_avatar() -> Avatar:
    """The embedded person (40,000 splats and its levels of detail; 55 SMPL-X joints; licence beside it).

    >>> glsplat.default_avatar().skeleton
    Skeleton(55 joints: pelvis, left_hip, right_hip, ...)
    """
    with resources.as_file(resources.files("glsplat.data") / "default_avatar.glb") as path:
        scene = load_gltf(path)
    assert isinstance(scene, Avatar)
    return scene


def participants_folder() -> Path:
    """The folder of the four synthetic people that ``glsplat evaluate`` takes where it is given no others.

    Raises FormatError where the package does not lie in files (a zip archive).
    """
    folder = resources.files("glsplat.data") / "participants"
    if not isinstance(folder, Path):
        raise FormatError("the participants are not files here; give a folder with --participants")
    return folder
