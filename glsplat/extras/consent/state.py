"""The server's key that signs consents, in its state folder."""

from __future__ import annotations

from pathlib import Path

from glsplat.extras.consent.keys import PrivateKey, new_key, private_key
from glsplat.net.guard.state_dir import lock_of

_KEY = "consent-key"


def kept_key(folder: Path) -> PrivateKey:
    """Return the key in the folder, created at the first call. Raises GlsplatError naming the file."""
    path = folder / _KEY
    with lock_of(folder):
        return private_key(path) if path.exists() else new_key(path)


def known_key(folder: Path) -> PrivateKey | None:
    """Return the key in the folder; None if none was created. Raises GlsplatError naming the file."""
    path = folder / _KEY
    return private_key(path) if path.exists() else None
