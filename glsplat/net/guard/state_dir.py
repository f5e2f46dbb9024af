"""The state folder of a server, which only its user can read: a lock, and the token."""

from __future__ import annotations

import os
import secrets
import stat
from contextlib import AbstractContextManager
from pathlib import Path

from glsplat.errors import GlsplatError
from glsplat.io.files import locked, replace_file
from glsplat.net.guard.access import read_token

TOKEN = "token"  # name of its file
_TOKEN_BYTES = 18  # 144 random bits: 24 characters
_LOCK_TIMEOUT_S = 10.0  # a process holds it for some milliseconds, to make a key


def state_folder() -> Path:
    """Return ``$XDG_STATE_HOME/glsplat`` (``~/.local/state/glsplat``); it is made with mode 0700 where it is absent.

    Raises GlsplatError when it cannot be made, or belongs to another user.
    """
    base = Path(os.environ.get("XDG_STATE_HOME", ""))
    if not base.is_absolute():  # as the XDG Base Directory Specification says
        try:
            base = Path.home() / ".local" / "state"
        except RuntimeError:
            raise GlsplatError("this user has no home folder: set XDG_STATE_HOME to a folder for files") from None
    folder = base / "glsplat"
    try:
        base.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
        info = folder.stat()
        if hasattr(os, "getuid") and info.st_uid != os.getuid():
            raise GlsplatError(f"{folder}: belongs to another user; set XDG_STATE_HOME to another folder")
        if stat.S_IMODE(info.st_mode) != 0o700:
            folder.chmod(0o700)
    except OSError as error:
        reason = error.strerror or error
        raise GlsplatError(f"{folder}: cannot be made ({reason}); set XDG_STATE_HOME to another folder") from None
    return folder


def lock_of(folder: Path) -> AbstractContextManager[None]:
    """Lock the folder: of two servers that start together, the second finds the files of the first."""
    return locked(folder / "lock", _LOCK_TIMEOUT_S)


def kept_token(folder: Path) -> str:
    """Return the token in the folder, made at the first call. Raises GlsplatError naming the file."""
    path = folder / TOKEN
    with lock_of(folder):
        if not path.exists():
            replace_file(path, [secrets.token_urlsafe(_TOKEN_BYTES).encode() + b"\n"], private=True)
        try:
            return read_token(path)
        except GlsplatError as error:
            raise GlsplatError(f"{error}; delete it and the next start makes a new one") from None
