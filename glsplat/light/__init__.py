"""Light that falls on avatars, and what splats know of the surface it falls on. Values: nothing here draws."""

from __future__ import annotations

from typing import TYPE_CHECKING

from glsplat import on_demand

if TYPE_CHECKING:
    from glsplat.light.light import Light
    from glsplat.light.surface import Surface

__all__ = ["Light", "Surface"]

__getattr__ = on_demand(__name__, {"Light": "light", "Surface": "surface"})
