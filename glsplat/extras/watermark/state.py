"""The server's watermark, in its state folder."""

from __future__ import annotations

from pathlib import Path

from glsplat.extras.watermark.keys import new_watermark, read_watermark, text_of
from glsplat.extras.watermark.mark import WatermarkKey
from glsplat.io.files import replace_file
from glsplat.net.guard.state_dir import lock_of

WATERMARK = "watermark"
"""The file's name in the folder."""


def kept_watermark(folder: Path) -> WatermarkKey:
    """Return the id and key in the folder, created at the first call. Raises GlsplatError naming the file."""
    path = folder / WATERMARK
    with lock_of(folder):
        if not path.exists():
            replace_file(path, [text_of(new_watermark()).encode()], private=True)
        return read_watermark(path)
