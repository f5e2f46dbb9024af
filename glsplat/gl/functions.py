"""GL functions that moderngl has no call for, by their names, from whatever made the context."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable
from typing import Any

import moderngl

__all__ = ["gl_functions"]


def gl_functions(ctx: moderngl.Context) -> Callable[..., Any]:
    """``function(name, result, *arguments)``: the C function "gl" + name of a context; None where it has none.

    ``result`` and ``arguments`` are ctypes; None as a result is void, no arguments are not checked.
    """
    loader: Any = ctx.mglo._context  # whatever made the context
    load = getattr(loader, "load_opengl_function", None) or loader.load
    kind: Callable[..., Any] = ctypes.WINFUNCTYPE if os.name == "nt" else ctypes.CFUNCTYPE  # type: ignore[attr-defined]

    def function(name: str, result: Any, *arguments: Any) -> Any:
        address = load("gl" + name)
        return kind(result, *arguments)(address) if address else None

    return function
