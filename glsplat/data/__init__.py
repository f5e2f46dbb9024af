"""Embedded data: people, motions, a recording and participants, with their licences."""

from __future__ import annotations

from functools import lru_cache
from importlib import resources
from pathlib import Path

from glsplat.avatar import Avatar
from glsplat.errors import FormatError
from glsplat.formats.format import opened
from glsplat.formats.gltf.splats import read_gltf

__all__ = ["DEFAULT", "PEOPLE", "default_avatar", "embedded_file", "participants_folder", "person"]

PEOPLE: tuple[str, ...] = ("anna", "ben", "mei")
"""Names of the embedded people, each a file in people/ with an animated face."""

DEFAULT: str = "ben"
"""Name of the default person."""


@lru_cache(maxsize=len(PEOPLE))
def person(name: str) -> Avatar:
    """Return an embedded person (40,000 splats, 55 SMPL-X joints, 52 ARKit shapes).

    Raises FormatError for a name that is not in ``PEOPLE``.

    >>> from glsplat.data import person
    >>> person("anna").skeleton
    Skeleton(55 joints: pelvis, left_hip, right_hip, ...)
    """
    if name not in PEOPLE:
        raise FormatError(f"the embedded people are {', '.join(PEOPLE)}, not {name!r}")
    with resources.as_file(resources.files("glsplat.data") / "people" / f"{name}.glb") as path, opened(path) as start:
        scene = read_gltf(start)
    assert isinstance(scene, Avatar)
    return scene


def default_avatar() -> Avatar:
    """Return the default embedded person: ``person(DEFAULT)``.

    >>> glsplat.default_avatar().skeleton
    Skeleton(55 joints: pelvis, left_hip, right_hip, ...)
    """
    return person(DEFAULT)


def embedded_file(name: str | Path) -> Path:
    """Return the file of the embedded person ``name``; ``name`` itself if such a file exists or it is no person.

    Avatar arguments of commands are ``anna``, ``me.glb``, or ``./anna`` for a file of that name.
    """
    path = Path(name)
    if str(name) not in PEOPLE or path.exists():
        return path
    file = resources.files("glsplat.data") / "people" / f"{name}.glb"
    return file if isinstance(file, Path) else path


def participants_folder() -> Path:
    """Return the folder of the four synthetic people that are the default of ``glsplat evaluate``.

    Raises FormatError if the package is in a zip archive.
    """
    folder = resources.files("glsplat.data") / "participants"
    if not isinstance(folder, Path):
        raise FormatError("the participants are not files here; give a folder with --participants")
    return folder
