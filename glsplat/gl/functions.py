"""GL functions that moderngl does not wrap, loaded by name from the context's own loader."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable
from typing import Any

import moderngl


def gl_functions(ctx: moderngl.Context) -> Callable[..., Any]:
    """Return a loader ``function(name, result, *arguments)`` of the C function "gl" + name; None where there is none.

    ``result`` and ``arguments`` are ctypes. A result of None is void; without arguments calls are not checked.
    """
    loader: Any = ctx.mglo._context
    load = getattr(loader, "load_opengl_function", None) or loader.load
    kind: Callable[..., Any] = ctypes.WINFUNCTYPE if os.name == "nt" else ctypes.CFUNCTYPE  # type: ignore[attr-defined]

    def function(name: str, result: Any, *arguments: Any) -> Any:
        address = load("gl" + name)
        return kind(result, *arguments)(address) if address else None

    return function
