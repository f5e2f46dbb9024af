"""The page's modules in Node, where tests compare them with their twins in Python."""

from __future__ import annotations

from pathlib import Path

from glsplat.net.pages import page_files

__all__ = ["write_modules"]


def write_modules(folder: Path) -> Path:
    """Write the page's modules and tables, by their paths below /vr, into ``folder``; return it."""
    for path, body in page_files().items():
        if path.endswith((".js", ".json")):
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_bytes(body)
    (folder / "package.json").write_text('{"type": "module"}')  # Node before 22 takes .js for CommonJS
    return folder
