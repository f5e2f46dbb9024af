"""An invisible mark in the rendered avatar that leads from a leaked clip to the session that was served it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from glsplat import on_demand

if TYPE_CHECKING:
    from glsplat.watermark.mark import Watermark

__all__ = ["Watermark", "detect"]  # the second is a module

_HOME = {"Watermark": "mark"}

__getattr__ = on_demand(__name__, _HOME)
