"""The page's modules in Node, where tests compare them with their twins in Python."""

from __future__ import annotations

import subprocess
from pathlib import Path

from glsplat.net.pages.site import page_files
from tests.needs import program, require

__all__ = ["run_script", "write_modules"]


def write_modules(folder: Path) -> Path:
    """Write the page's modules and tables, by their paths below /vr, into ``folder``; return it."""
    for path, body in page_files().items():
        if path.endswith((".js", ".json")):
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_bytes(body)
    (folder / "package.json").write_text('{"type": "module"}')  # Node before 22 takes .js for CommonJS
    return folder


def run_script(folder: Path, script: str, given: str = "") -> str:
    """Return what a module prints that lies beside the page's, ``given`` as its standard input."""
    require("node")
    (write_modules(folder) / "script.js").write_text(script, encoding="utf-8")
    node = [program("node"), str(folder / "script.js")]
    return subprocess.run(node, input=given, stdout=subprocess.PIPE, check=True, text=True, timeout=120).stdout
