"""Speech: sound to the weights of a speaking mouth, the same in Python and in the page (docs/speech.md)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from glsplat import on_demand

if TYPE_CHECKING:
    from glsplat.speech.sound import Sound, read_wav
    from glsplat.speech.speaking import Speaking

__all__ = ["Sound", "Speaking", "read_wav"]

_HOME = {"Sound": "sound", "Speaking": "speaking", "read_wav": "sound"}

__getattr__ = on_demand(__name__, _HOME)
