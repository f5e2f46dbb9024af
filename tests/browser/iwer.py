"""Meta's WebXR emulator as a plain script, with a headset put on: fetched once by npm into pytest's cache."""

from __future__ import annotations

from pathlib import Path

from tests.browser.npm import file_of

__all__ = ["EMULATE", "iwer_script"]

# it refuses to install itself where the browser has WebXR of its own, which localhost has
EMULATE = """
globalThis.headset = new IWER.XRDevice(IWER.metaQuest3, {ipd: 0.063});
globalThis.headset.installRuntime({forceInstall: true});
globalThis.headset.position.set(0, 1.6, 0);
globalThis.headset.primaryInputMode = 'hand';
"""


def iwer_script(cache: Path) -> str:
    """The emulator's script, that of plain pages: what glsplat serves for ?emulate is a module."""
    return file_of("iwer@2.5.0", "package/build/iwer.min.js", cache)
