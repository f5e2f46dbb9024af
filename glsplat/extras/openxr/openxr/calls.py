"""pyopenxr, imported on demand, with its errors as GlsplatErrors; swapchains."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

from glsplat.errors import ContextError, ContextLostError

INSTALL = "pip install 'glsplat[openxr]'"

_PATIENCE = 2_000_000_000  # longest wait for an image, nanoseconds


def pyopenxr() -> Any:
    """Return the module ``xr``. Raises ContextError with the command that installs it."""
    os.environ.setdefault("XR_LOADER_DEBUG", "none")  # errors are reported here, in one line
    try:
        import xr
    except ModuleNotFoundError as error:
        raise ContextError(f"OpenXR needs pyopenxr ({error.name} is missing): {INSTALL}") from None
    except (ImportError, OSError, AttributeError) as error:  # its loader, or PyOpenGL's libraries
        raise ContextError(f"pyopenxr cannot be loaded: {str(error).splitlines()[0]:.160}") from None
    return xr


def quietly(destroy: Callable[[Any], None], handle: Any) -> None:
    """Destroy a handle; a lost runtime has no handles left."""
    with suppress(pyopenxr().exception.XrException):
        destroy(handle)


@contextmanager
def called(what: str) -> Iterator[None]:
    """Raise pyopenxr's errors as ContextLostError if the runtime is lost, else as ContextError.

    Qualified successes (a frame was discarded, a session is not focused) are ignored.
    """
    xr = pyopenxr()
    gone = (xr.InstanceLostError, xr.SessionLostError, xr.SessionLossPending, xr.RuntimeFailureError)
    try:
        yield
    except gone as error:
        raise ContextLostError(f"the OpenXR runtime is gone ({what}: {type(error).__name__})") from None
    except xr.exception.QualifiedSuccessResult:
        pass
    except xr.exception.ResultException as error:
        text = " ".join(str(error).split())
        raise ContextError(f"the OpenXR runtime refuses {what}: {type(error).__name__}: {text:.160}") from None


def function(instance: Any, name: str) -> Any:
    """Return an extension's C function whose wrapper in pyopenxr does not work; it raises pyopenxr's errors."""
    import ctypes

    xr = pyopenxr()
    call = ctypes.cast(xr.get_instance_proc_addr(instance, name), getattr(xr, f"PFN_{name}"))

    def checked(*arguments: Any) -> None:
        result = xr.exception.check_result(xr.Result(call(*arguments)))
        if result.is_exception():
            raise result

    return checked


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
