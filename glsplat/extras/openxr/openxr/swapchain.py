"""Swapchain: images of the runtime to acquire, draw into and release, in that order (OpenXR 1.1, 11.3)."""

from __future__ import annotations

from typing import Any

from glsplat.errors import ContextLostError
from glsplat.extras.openxr.openxr.calls import called, quietly

_PATIENCE = 2_000_000_000  # longest wait for an image, nanoseconds


class Swapchain:
    """A swapchain; ``textures`` are the GL names of its images, of ``layers`` layers each (1: a plain texture)."""

    def __init__(self, xr: Any, handle: Any, size: tuple[int, int], layers: int, textures: list[int]) -> None:
        self._xr = xr
        self.handle: Any = handle
        self.size: tuple[int, int] = size
        self.layers: int = layers
        self.textures: list[int] = textures

    def acquire(self) -> int:
        """Acquire the next image and wait for it; return its index."""
        xr = self._xr
        with called("xrAcquireSwapchainImage"):
            index = int(xr.acquire_swapchain_image(self.handle, xr.SwapchainImageAcquireInfo()))
        done = False
        with called("xrWaitSwapchainImage"):
            xr.wait_swapchain_image(self.handle, xr.SwapchainImageWaitInfo(timeout=_PATIENCE))
            done = True
        if not done:  # XR_TIMEOUT_EXPIRED
            raise ContextLostError("the OpenXR runtime does not give its images back")
        return index

    def release(self) -> None:
        """Release the acquired image."""
        with called("xrReleaseSwapchainImage"):
            self._xr.release_swapchain_image(self.handle, self._xr.SwapchainImageReleaseInfo())

    def close(self) -> None:
        """Destroy the swapchain."""
        quietly(self._xr.destroy_swapchain, self.handle)
