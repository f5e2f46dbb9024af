"""axe-core, which finds faults of accessibility: fetched once by npm into pytest's cache, no part of the project."""

from __future__ import annotations

import subprocess
import tarfile
import tempfile
from pathlib import Path
from typing import Any

import pytest

from tests import needs

__all__ = ["axe_script", "violations"]

_PACKAGE = "axe-core@4.10.3"
_FILE = "package/axe.min.js"


def axe_script(cache: Path) -> str:
    """The script, from ``cache`` or from npm. Skips the test where neither has it."""
    stored = cache / f"{_PACKAGE}.js"
    if not stored.exists():
        needs.require("npm")
        # a folder of its own: another process of the same run may be fetching it, too
        with tempfile.TemporaryDirectory(dir=cache) as folder:
            command = ["npm", "pack", "--silent", _PACKAGE]
            done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120)
            if done.returncode:
                lines = (done.stderr or done.stdout or "no word from npm").strip().splitlines()
                pytest.skip(f"npm cannot fetch {_PACKAGE}: {lines[0]:.200}")
            with tarfile.open(Path(folder) / done.stdout.strip().splitlines()[-1]) as files:
                member = files.extractfile(_FILE)
                assert member is not None, f"{_PACKAGE} has no {_FILE}"
                whole = Path(folder) / "script.js"
                whole.write_bytes(member.read())
            whole.replace(stored)
    return stored.read_text(encoding="utf-8")


def violations(page: Any, script: str) -> list[str]:
    """What axe finds on a page of Playwright, by all rules of WCAG 2.1 A and AA and best practice, a line each."""
    page.evaluate(script)
    found = page.evaluate("async () => (await axe.run(document)).violations")
    return [f"{one['id']}: {one['help']}: {[node['html'][:160] for node in one['nodes'][:4]]}" for one in found]
