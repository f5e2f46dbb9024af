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
    """``given`` avatars by name, then NAME.glb in ``folder``, read each time, then the embedded ``people``.

    A file with the name of the ``scene`` is no avatar. Callers pass offered names only, so that none leads out of the
    folder. Only names of the embedded people are pickled; the process that draws loads its own on first use.
    """

    def __init__(
        self, given: Mapping[str, Rigged], folder: Path | None = None, scene: str = "", people: Collection[str] = ()
    ) -> None:
        self._given, self._folder, self._scene, self._people = dict(given), folder, scene, tuple(people)

    def __getitem__(self, name: str) -> Rigged:
        if name in self._given:
            return self._given[name]
        path = self._path(name)
        if path is None:
            if name in self._people:
                return person(name)
            raise KeyError(name)
        avatar = load_content(path)
        if not isinstance(avatar, Avatar):
            raise FormatError(f"{path}: expected an avatar, found splats without a skeleton")
        return avatar

    def __contains__(self, name: object) -> bool:
        return name in self._given or name in self._people or (isinstance(name, str) and self._path(name) is not None)

    def __iter__(self) -> Iterator[str]:
        files = () if self._folder is None else (path.stem for path in sorted(self._folder.glob("*.glb")))
        yield from dict.fromkeys((*self._given, *files, *self._people))

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def _path(self, name: str) -> Path | None:
        """Return the file of an avatar; None where there is none."""
        path = None if self._folder is None or name == self._scene else self._folder / f"{name}.glb"
        return path if path is not None and path.is_file() else None
