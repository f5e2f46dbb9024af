"""Participants: people with a true mesh, and their captured photograph, video and notes."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from glsplat.camera import Camera
from glsplat.errors import FormatError
from glsplat.formats.camera_file import camera_from_json
from glsplat.formats.registry import load
from glsplat.io.files import read_json
from glsplat.meshes import RiggedMesh
from glsplat.skinning.pose import Pose

_MESHES = (".npz", ".glb")
_PICTURES = (".jpg", ".jpeg", ".png")
_VIDEOS = (".mp4", ".webm", ".mov", ".mkv", ".avi")
_LARGEST = 1 << 20  # bytes of a capture's note


@dataclass(frozen=True, eq=False)
class Participant:
    """One person. Files are read on first use, so that a broken one is reported in this participant's row."""

    name: str
    folder: Path
    height: float | None = None  # metres; None if unknown

    @property
    def mesh_file(self) -> Path:
        """The textured, rigged mesh that is the truth."""
        return _one_of(self.folder / self.name, _MESHES) or self.folder / f"{self.name}.npz"

    @property
    def photo(self) -> Path:
        """The photograph that methods may use. Raises FormatError if there is none."""
        found = _one_of(self._captured, _PICTURES)
        if found is None:
            raise FormatError(f"{self._captured}.jpg: no such picture; a participant needs a photograph")
        return found

    @property
    def video(self) -> Path | None:
        """A video of the turning person; None if there is none."""
        return _one_of(self._captured, _VIDEOS)

    @cached_property
    def mesh(self) -> RiggedMesh:
        """The truth in its zero pose, soles on y = 0. Raises FormatError."""
        found = load(self.mesh_file)
        if not isinstance(found, RiggedMesh) or len(found.skeleton) < 2:
            raise FormatError(f"{self.mesh_file}: a participant needs a textured mesh with a skeleton")
        return found

    @property
    def camera(self) -> Camera | None:
        """The photograph's camera; None if unknown."""
        if "camera" not in self._notes:
            return None
        return camera_from_json(self._notes["camera"], f"{self._note_file}: camera")

    @property
    def pose(self) -> Pose | None:
        """The pose of the mesh's skeleton in the photograph; None if unknown."""
        if "pose" not in self._notes:
            return None
        return Pose(self._notes["pose"], self._notes.get("trans", (0.0, 0.0, 0.0)))

    @property
    def light(self) -> Mapping[str, Any] | None:
        """The photograph's light from its note; None if unknown."""
        return self._notes.get("light")

    def digest(self) -> str:
        """Return a digest of height and all files. Raises FormatError if a file cannot be read."""
        total = hashlib.sha256(repr(self.height).encode())
        for file in (self.mesh_file, _one_of(self._captured, _PICTURES), self.video, self._note_file):
            if file is not None and file.is_file():
                total.update(f"{file.suffix} {digest_of(file)}".encode())
        return total.hexdigest()[:16]

    @property
    def _captured(self) -> Path:
        return self.folder / "capture" / self.name

    @property
    def _note_file(self) -> Path:
        return self.folder / "capture" / f"{self.name}.json"

    @cached_property
    def _notes(self) -> Mapping[str, Any]:
        if not self._note_file.is_file():
            return {}
        return _object(self._note_file)


def participants_in(folder: Path) -> list[Participant]:
    """Return a folder's participants, by name: NAME.npz or .glb is the truth, capture/NAME.jpg or .png the photograph.

    Optional files: ``capture/NAME.json`` with the photograph's camera, pose and light, ``capture/NAME.mp4`` of the
    turning person, ``participants.json`` with heights in metres ({"participants": [{"id", "height_m"}]}). Raises
    FormatError if there is nobody.
    """
    if not folder.is_dir():
        raise FormatError(f"{folder}: no such folder; participants are NAME.npz or NAME.glb in a folder")
    names = sorted({file.stem for file in folder.iterdir() if file.suffix in _MESHES and file.is_file()})
    for name in names:
        if not name.isprintable():  # written to files, pages and terminals
            raise FormatError(f"{folder}: a participant's name is printable text, not {name!r:.60}")
    if not names:
        raise FormatError(f"{folder}: nobody is here; participants are NAME.npz or NAME.glb")
    heights: dict[str, float] = {}
    table = folder / "participants.json"
    if table.is_file():
        try:
            for row in _object(table)["participants"]:
                heights[str(row["id"])] = float(row["height_m"])
        except (KeyError, TypeError, ValueError):
            raise FormatError(f'{table}: expected {{"participants": [{{"id": NAME, "height_m": metres}}]}}') from None
    return [Participant(name, folder, heights.get(name)) for name in names]


def digest_of(file: Path) -> str:
    """Return the SHA-256 of a file of any size, in hexadecimal. Raises FormatError if it cannot be read."""
    try:
        with file.open("rb") as opened:
            return hashlib.file_digest(opened, "sha256").hexdigest()
    except OSError as error:
        raise FormatError(f"{file}: cannot be read ({error.strerror})") from None


def _one_of(stem: Path, suffixes: tuple[str, ...]) -> Path | None:
    return next((file for suffix in suffixes if (file := stem.with_name(stem.name + suffix)).is_file()), None)


def _object(path: Path) -> Mapping[str, Any]:
    data = read_json(path, "a note", _LARGEST)
    if not isinstance(data, dict):
        raise FormatError(f"{path}: a note is a JSON object, not {type(data).__name__}")
    return data
