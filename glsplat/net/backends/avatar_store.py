"""Avatars by name: given ones, those in a folder, and embedded ones that are loaded on demand."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

from glsplat.avatar import Avatar
from glsplat.data import person
from glsplat.errors import FormatError
from glsplat.formats import load_content
from glsplat.scene import Rigged


class AvatarStore(Mapping[str, Rigged]):
    """``given`` avatars by name, then NAME.glb in ``folder``, read each time; never the name of the ``scene``.

    Callers pass offered names only, so that none leads out of the folder.
    """

    def __init__(self, given: Mapping[str, Rigged], folder: Path, scene: str) -> None:
        self._given, self._folder, self._scene = dict(given), folder, scene

    def __getitem__(self, name: str) -> Rigged:
        if name in self._given:
            return self._given[name]
        if name not in self:
            raise KeyError(name)
        avatar = load_content(self._path(name))
        if not isinstance(avatar, Avatar):
            raise FormatError(f"{self._path(name)}: expected an avatar, found splats without a skeleton")
        return avatar

    def __contains__(self, name: object) -> bool:
        return name in self._given or (isinstance(name, str) and name != self._scene and self._path(name).is_file())

    def __iter__(self) -> Iterator[str]:
        yield from self._given
        yield from (path.stem for path in sorted(self._folder.glob("*.glb")) if path.stem not in self._given)

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def _path(self, name: str) -> Path:
        return self._folder / f"{name}.glb"


class LazyAvatars(Mapping[str, Rigged]):
    """``given`` avatars by name, then the embedded ``people`` of other names, loaded on first use.

    Only names of the embedded people are pickled; the process that draws loads its own.
    """

    def __init__(self, given: Mapping[str, Rigged], people: Collection[str]) -> None:
        self._given, self._people = given, tuple(people)

    def __getitem__(self, name: str) -> Rigged:
        if name in self._people and name not in self._given:
            return person(name)
        return self._given[name]

    def __contains__(self, name: object) -> bool:
        return name in self._given or name in self._people

    def __iter__(self) -> Iterator[str]:
        yield from self._given
        yield from (name for name in self._people if name not in self._given)

    def __len__(self) -> int:
        return sum(1 for _ in self)
