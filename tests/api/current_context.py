"""What is current on this thread, asked of the libraries themselves, and a driver of a context's own functions."""

from __future__ import annotations

import ctypes
from typing import Any

import moderngl


def asked() -> tuple[Any, ...]:
    """Context, display and draw surface by EGL, the same by GLX."""
    egl, glx = ctypes.CDLL("libEGL.so.1"), ctypes.CDLL("libGL.so.1")
    values = []
    for library, name, arguments in (
        (egl, "eglGetCurrentContext", ()),
        (egl, "eglGetCurrentDisplay", ()),
        (egl, "eglGetCurrentSurface", (0x3059,)),
        (glx, "glXGetCurrentContext", ()),
        (glx, "glXGetCurrentDrawable", ()),
    ):
        function = getattr(library, name)
        function.restype = ctypes.c_void_p
        values.append(function(*arguments))
    return tuple(values)


def nothing_current() -> None:
    """Leave this thread without a context of EGL's."""
    egl = ctypes.CDLL("libEGL.so.1")
    egl.eglGetCurrentDisplay.restype = ctypes.c_void_p
    egl.eglMakeCurrent.argtypes = [ctypes.c_void_p] * 4
    if display := egl.eglGetCurrentDisplay():
        egl.eglMakeCurrent(display, None, None, None)


class GL:
    """``gl.PolygonMode(...)``: any GL function of a context, with integers, floats (as c_float) and arrays."""

    def __init__(self, ctx: moderngl.Context) -> None:
        self._load = ctx.mglo._context.load_opengl_function  # type: ignore[attr-defined]

    def __getattr__(self, name: str) -> Any:
        function = ctypes.CFUNCTYPE(ctypes.c_uint)(self._load(f"gl{name}"))
        setattr(self, name, function)
        return function

    def integers(self, enum: int, count: int = 1) -> tuple[int, ...]:
        values = (ctypes.c_int * 16)(*[-77] * 16)
        self.GetIntegerv(enum, values)
        return tuple(values[:count])

    def indexed(self, enum: int, index: int) -> int:
        value = ctypes.c_int64(-77)
        self.GetInteger64i_v(enum, index, ctypes.byref(value))
        return value.value
