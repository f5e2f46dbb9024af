"""The folder of what a server keeps between its starts: only its user can read it; a lock, and the token."""

from __future__ import annotations

import os
import secrets
import stat
from contextlib import AbstractContextManager
from pathlib import Path

from glsplat.errors import GlsplatError
from glsplat.io.files import locked, replace_file
from glsplat.net.guard.access import read_token

__all__ = ["TOKEN", "kept_token", "lock_of", "state_folder"]

TOKEN = "token"
"""The name of the token's file in the folder."""
_BYTES = 18  # of chance in a token, 144 bits: 24 characters
_PATIENCE = 10.0  # seconds; who holds the lock makes a key meanwhile, which takes some milliseconds


def state_folder() -> Path:
    """``$XDG_STATE_HOME/glsplat`` (``~/.local/state/glsplat``), made where it is absent; nobody else can look into it.

    Raises GlsplatError when it cannot be made, or is somebody else's.
    """
    base = Path(os.environ.get("XDG_STATE_HOME", ""))
    if not base.is_absolute():  # as the XDG Base Directory Specification says
        try:
            base = Path.home() / ".local" / "state"
        except RuntimeError:
            raise GlsplatError("this user has no home folder: name one to keep files in by XDG_STATE_HOME") from None
    folder = base / "glsplat"
    try:
        base.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
        info = folder.stat()
        if hasattr(os, "getuid") and info.st_uid != os.getuid():
            raise GlsplatError(f"{folder}: belongs to another user; name another place by XDG_STATE_HOME")
        if stat.S_IMODE(info.st_mode) != 0o700:
            folder.chmod(0o700)
    except OSError as error:
        reason = error.strerror or error
        raise GlsplatError(f"{folder}: cannot be made ({reason}); name another place by XDG_STATE_HOME") from None
    return folder


def lock_of(folder: Path) -> AbstractContextManager[None]:
    """One process at a time: of two servers that start together, the second finds what the first made."""
    return locked(folder / "lock", _PATIENCE)


def kept_token(folder: Path) -> str:
    """The token in the folder, made at the first call. Raises GlsplatError naming the file."""
    path = folder / TOKEN
    with lock_of(folder):
        if not path.exists():
            replace_file(path, [secrets.token_urlsafe(_BYTES).encode() + b"\n"], private=True)
        try:
            return read_token(path)
        except GlsplatError as error:
            raise GlsplatError(f"{error}; delete it and the next start makes a new one") from None
