"""Meta's WebXR emulator: fetched once by npm into pytest's cache, never a part of the project."""

from __future__ import annotations

import subprocess
import tarfile
import tempfile
from pathlib import Path

import pytest

from tests import needs

__all__ = ["EMULATE", "iwer_script"]

_PACKAGE = "iwer@2.5.0"
_FILE = "package/build/iwer.min.js"

# it refuses to install itself where the browser has WebXR of its own, which localhost has
EMULATE = """
globalThis.headset = new IWER.XRDevice(IWER.metaQuest3, {ipd: 0.063});
globalThis.headset.installRuntime({forceInstall: true});
globalThis.headset.position.set(0, 1.6, 0);
globalThis.headset.primaryInputMode = 'hand';
"""


def iwer_script(cache: Path) -> str:
    """The emulator's script, from ``cache`` or from npm. Skips the test where neither has it."""
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
