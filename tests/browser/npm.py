"""A file of an npm package: fetched once into pytest's cache, never a part of the project."""

from __future__ import annotations

import subprocess
import tarfile
import tempfile
from pathlib import Path

import pytest

from tests import needs

__all__ = ["file_of"]


def file_of(package: str, name: str, cache: Path) -> str:
    """The text of ``name`` in ``package`` (NAME@VERSION), from ``cache`` or from npm. Skips where neither has it."""
    stored = cache / f"{package}.js"
    if not stored.exists():
        needs.require("npm")
        # a folder of its own: another process of the same run may be fetching it, too
        with tempfile.TemporaryDirectory(dir=cache) as folder:
            command = ["npm", "pack", "--silent", package]
            done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120)
            if done.returncode:
                lines = (done.stderr or done.stdout or "no word from npm").strip().splitlines()
                pytest.skip(f"npm cannot fetch {package}: {lines[0]:.200}")
            with tarfile.open(Path(folder) / done.stdout.strip().splitlines()[-1]) as files:
                member = files.extractfile(name)
                assert member is not None, f"{package} has no {name}"
                whole = Path(folder) / "script.js"
                whole.write_bytes(member.read())
            whole.replace(stored)
    return stored.read_text(encoding="utf-8")
