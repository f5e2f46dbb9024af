"""Drivers that draw on the processor, by the names that they give themselves."""

from __future__ import annotations

__all__ = ["is_software"]

_NAMES = ("llvmpipe", "softpipe", "lavapipe", "swrast", "swiftshader")


def is_software(driver: str) -> bool:
    """Whether that driver (GL_RENDERER) shares the processor with everything else."""
    return any(name in driver.lower() for name in _NAMES)
