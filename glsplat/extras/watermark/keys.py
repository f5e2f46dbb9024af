"""File of a server's watermark: its id and its key in hexadecimal, in one line."""

from __future__ import annotations

import secrets
from pathlib import Path

from glsplat.errors import GlsplatError
from glsplat.extras.watermark.mark import KEY_BYTES, WatermarkKey
from glsplat.io.files import replace_file
from glsplat.io.secret_files import warn_if_exposed
from glsplat.net.guard.state_dir import lock_of

_NEW_KEY_BYTES = 32
MAX_FILE_BYTES = 4096


def new_watermark() -> WatermarkKey:
    """Return a random id and key."""
    return WatermarkKey(secrets.randbits(16), secrets.token_bytes(_NEW_KEY_BYTES))


def text_of(watermark: WatermarkKey) -> str:
    """Return the line of the file."""
    return f"{watermark.server:04x} {watermark.key.hex()}\n"


def read_watermark(path: str | Path) -> WatermarkKey:
    """Return the id and key in a file. Raises GlsplatError naming it."""
    try:
        with Path(path).open("rb") as file:
            words = file.read(MAX_FILE_BYTES).decode("ascii").split()
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


WATERMARK = "watermark"
"""The file's name in the folder."""


def kept_watermark(folder: Path) -> WatermarkKey:
    """Return the id and key in the folder, created at the first call. Raises GlsplatError naming the file."""
    path = folder / WATERMARK
    with lock_of(folder):
        if not path.exists():
            replace_file(path, [text_of(new_watermark()).encode()], private=True)
        return read_watermark(path)
