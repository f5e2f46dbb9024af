"""Recognise software rasterizers by their driver names."""

from __future__ import annotations

_NAMES = ("llvmpipe", "softpipe", "lavapipe", "swrast", "swiftshader")


def is_software(driver: str) -> bool:
    """Return whether ``driver`` (GL_RENDERER) renders on the CPU."""
    return any(name in driver.lower() for name in _NAMES)
