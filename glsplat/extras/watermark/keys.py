"""The file that holds what a server marks with: its id in hex and its key in hex, in one line."""

from __future__ import annotations

import secrets
from pathlib import Path

from glsplat.errors import GlsplatError
from glsplat.extras.watermark.mark import KEY_BYTES, WatermarkKey
from glsplat.io.secret_files import warn_if_exposed

__all__ = ["new_watermark", "read_watermark", "text_of"]

_NEW_KEY = 32  # bytes
_MOST = 4096  # bytes of a file that can be one


def new_watermark() -> WatermarkKey:
    """An id and a key of chance."""
    return WatermarkKey(secrets.randbits(16), secrets.token_bytes(_NEW_KEY))


def text_of(watermark: WatermarkKey) -> str:
    """The line of the file."""
    return f"{watermark.server:04x} {watermark.key.hex()}\n"


def read_watermark(path: str | Path) -> WatermarkKey:
    """What a file holds. Raises GlsplatError naming it."""
    try:
        with Path(path).open("rb") as file:
            words = file.read(_MOST).decode("ascii").split()
    except OSError as error:
        raise GlsplatError(f"{path}: cannot read the watermark's key ({error.strerror})") from None
    except UnicodeError:
        words = []
    warn_if_exposed(path)
    try:
        server, key = words
        return WatermarkKey(int(server, 16), bytes.fromhex(key))
    except (ValueError, GlsplatError):
        raise GlsplatError(
            f"{path}: a watermark's key file is one line: the server's id as 4 hex digits, a blank, "
            f"and a key of {2 * KEY_BYTES} or more hex digits"
        ) from None
