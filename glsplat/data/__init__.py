"""Embedded data: three people, motions, a recording, participants, and the licences beside them."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from importlib import resources
from pathlib import Path
from types import MappingProxyType

from glsplat.avatar import Avatar
from glsplat.errors import FormatError
from glsplat.formats.gltf.splats import load_gltf

__all__ = ["PEOPLE", "default_avatar", "embedded_file", "participants_folder", "person"]

PEOPLE: Mapping[str, str] = MappingProxyType(
    {"anna": "people/anna.glb", "ben": "people/ben.glb", "chloe": "people/chloe.glb"}
)
"""The embedded people, and their files in this package."""

_DEFAULT = "ben"


def person(name: str = _DEFAULT) -> Avatar:
    """One of the embedded people (40,000 splats and levels of detail; 55 SMPL-X joints; 52 shapes of ARKit).

    Licences are beside the files. Raises FormatError for a name that is not in ``PEOPLE``.

    >>> glsplat.person("anna").skeleton
    Skeleton(55 joints: pelvis, left_hip, right_hip, ...)
    """
    if name not in PEOPLE:
        raise FormatError(f"the embedded people are {', '.join(PEOPLE)}, not {name!r}")
    return _loaded(name)


@lru_cache(maxsize=len(PEOPLE))
def _loaded(name: str) -> Avatar:
    with resources.as_file(resources.files("glsplat.data") / PEOPLE[name]) as path:
        scene = load_gltf(path)
    assert isinstance(scene, Avatar)
    return scene


def default_avatar() -> Avatar:
    """The embedded person that is shown where nobody says whom: ``person("ben")``.

    >>> glsplat.default_avatar().skeleton
    Skeleton(55 joints: pelvis, left_hip, right_hip, ...)
    """
    return person(_DEFAULT)


def embedded_file(name: str | Path) -> Path:
    """The file of the embedded person that ``name`` is, where no file of that name is there; else ``name`` itself.

    Commands take what follows as an avatar: ``anna``, ``./anna`` for a file of that name, ``me.glb``.
    """
    path = Path(name)
    if str(name) not in PEOPLE or path.exists():
        return path
    file = resources.files("glsplat.data") / PEOPLE[str(name)]
    return file if isinstance(file, Path) else path


def participants_folder() -> Path:
    """The folder of the four synthetic people that ``glsplat evaluate`` takes where it is given no others.

    Raises FormatError where the package does not lie in files (a zip archive).
    """
    folder = resources.files("glsplat.data") / "participants"
    if not isinstance(folder, Path):
        raise FormatError("the participants are not files here; give a folder with --participants")
    return folder
