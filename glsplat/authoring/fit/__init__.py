"""The open body fitted to pictures of a person: landmarks, then silhouettes, then clothes as a smooth offset."""

from __future__ import annotations

from typing import TYPE_CHECKING

from glsplat import on_demand

if TYPE_CHECKING:
    from glsplat.authoring.fit.details import fit_details
    from glsplat.authoring.fit.eyes import read_eyes

__all__ = ["fit_details", "read_eyes"]

_HOME = {"fit_details": "details", "read_eyes": "eyes"}

__getattr__ = on_demand(__name__, _HOME)
