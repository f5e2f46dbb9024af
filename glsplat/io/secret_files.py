"""Files that hold secrets (tokens, keys, accounts): a warning where others can read or change one."""

from __future__ import annotations

import logging
import os
import shlex
import stat
from pathlib import Path

log: logging.Logger = logging.getLogger("glsplat.files")


def exposure(path: str | Path) -> str:
    """Return how others can access a secret file and the repair, in one line; "" if they cannot.

    Checks the mode bits of the file and of its folder, on POSIX systems alone.
    """
    if os.name != "posix":
        return ""
    folder = Path(path).parent
    try:
        info, among = os.stat(path), stat.S_IMODE(os.stat(folder).st_mode)
    except OSError:
        return ""
    mode, own, name = stat.S_IMODE(info.st_mode), info.st_uid == os.geteuid(), shlex.quote(str(path))
    # systemd provides credentials as files of another user, readable by the group
    deeds = [deed for deed, bits in (("read", 0o044 if own else 0o004), ("change", 0o022)) if mode & bits]
    if deeds:
        repair = f"chmod 600 {name}" if own else f"chown it to the user who reads it, then chmod 600 {name}"
        return f"{path}: others can {' and '.join(deeds)} it: expected mode 0600, got {mode:04o}; {repair}"
    if among & 0o002 and not among & stat.S_ISVTX:
        return f"{path}: others can replace it: its folder has mode {among:04o}; chmod o-w {shlex.quote(str(folder))}"
    return ""


def warn_if_exposed(path: str | Path) -> None:
    """Log ``exposure`` as a warning, if there is any."""
    if line := exposure(path):
        log.warning("%s", line)
