"""The folder that holds avatars made from photographs, with limits on its size."""

from __future__ import annotations

import io
import logging
import os
import re
import secrets
from pathlib import Path

from glsplat.avatar import Avatar
from glsplat.errors import FormatError, GlsplatError
from glsplat.formats import load_content
from glsplat.io.files import replace_file

SUFFIX = ".glb"
_LETTERS = "abcdefghijkmnpqrstuvwxyz23456789"  # without letters that look alike
_OWN_NAME = re.compile(f"photo-[{_LETTERS}]{{8}}")
MAX_NAME = 64  # characters of a name in a URL

log: logging.Logger = logging.getLogger("glsplat.net")


class NoRoomError(GlsplatError):
    """The folder is full."""


class UploadStore:
    """A folder of at most ``max_avatars`` avatars and ``max_bytes`` in all. The server chooses the names."""

    def __init__(self, folder: Path, max_avatars: int, max_bytes: int) -> None:
        self.folder, self._max_avatars, self._max_bytes = folder, max_avatars, max_bytes

    def open(self) -> None:
        """Create the folder, private to this user, if it is missing. Raises GlsplatError if it cannot be used."""
        try:
            self.folder.mkdir(mode=0o700, exist_ok=True)
        except OSError as error:
            raise GlsplatError(f"{self.folder}: avatars cannot be kept there ({error.strerror})") from None
        if not os.access(self.folder, os.R_OK | os.W_OK | os.X_OK):
            raise GlsplatError(f"{self.folder}: avatars cannot be kept there (no right to read and write)")

    def avatars(self) -> dict[str, Avatar]:
        """Return the avatars in the folder by name. Other files are skipped with a line in the log."""
        found: dict[str, Avatar] = {}
        for path in self._paths():
            try:
                if not (path.stem.isprintable() and path.stem.strip() == path.stem and len(path.stem) <= MAX_NAME):
                    raise FormatError(f"{path}: its name cannot be part of a URL")
                found[path.stem] = _avatar(load_content(path), str(path))
            except GlsplatError as error:
                log.warning("skipped: %s", error)
        return found

    def check(self, further: int = 0) -> None:
        """Raise NoRoomError unless an avatar of ``further`` bytes fits."""
        sizes = [size for path in self._paths() if (size := _size(path)) is not None]
        if len(sizes) >= self._max_avatars:
            raise NoRoomError(
                f"this server keeps {self._max_avatars} avatars and has no room for another; delete one first"
            )
        if sum(sizes) + further > self._max_bytes:
            raise NoRoomError(
                f"this server keeps {self._max_bytes / 1e6:g} MB of avatars, which are used up; delete one first"
            )

    def new_name(self) -> str:
        """Return a new name that cannot be guessed."""
        return "photo-" + "".join(secrets.choice(_LETTERS) for _ in range(8))

    def made_here(self, name: str) -> bool:
        """Return whether ``new_name`` made the name: clients can delete only these avatars."""
        return _OWN_NAME.fullmatch(name) is not None

    def put(self, name: str, data: bytes) -> Avatar:
        """Store a file atomically and return its avatar.

        Raises NoRoomError, or GlsplatError for a file without an avatar and on a full or failing disk.
        """
        avatar = _avatar(load_content(io.BytesIO(data), format="glb"), "what was made")
        self.check(len(data))
        try:
            replace_file(self._path(name), [data], private=True)
        except FormatError as error:
            log.error("%s", error)
            raise GlsplatError("the avatar could not be saved: the server cannot write to its disk") from None
        return avatar

    def remove(self, name: str) -> bool:
        """Delete an avatar; return False if there is none. Raises GlsplatError."""
        try:
            self._path(name).unlink()
        except FileNotFoundError:
            return False
        except OSError as error:
            raise GlsplatError(f"the avatar could not be deleted ({error.strerror})") from None
        return True

    def _path(self, name: str) -> Path:
        if not self.made_here(name):
            raise GlsplatError("only avatars that were made here can be changed")
        return self.folder / f"{name}{SUFFIX}"

    def _paths(self) -> list[Path]:
        try:
            return sorted(path for path in self.folder.iterdir() if path.suffix == SUFFIX)
        except OSError as error:
            raise NoRoomError(f"this server's folder of avatars cannot be read ({error.strerror})") from None


def _avatar(loaded: object, name: str) -> Avatar:
    if not isinstance(loaded, Avatar):
        raise FormatError(f"{name}: expected an avatar (.glb with a skin), found splats without a skeleton")
    return loaded


def _size(path: Path) -> int | None:
    try:
        return path.stat().st_size
    except OSError:  # deleted meanwhile
        return None
