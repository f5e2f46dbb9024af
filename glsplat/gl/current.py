"""Query and switch the current OpenGL context of this thread through the C functions of EGL, GLX and OSMesa.

Where none of the three is loaded (Windows, macOS), nothing is switched: the maker of a context keeps it current.
"""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Callable
from typing import Any, NamedTuple

from glsplat.errors import ContextError

Handle = int | None


class Binding(NamedTuple):
    """Arguments that make a context current in one of the APIs."""

    api: _Api
    context: int
    rest: tuple[Any, ...]  # display and surfaces, or OSMesa's buffer


class _Api:
    """An API that makes contexts current. A library that this process has not loaded cannot have made one."""

    libraries: tuple[str, ...]

    def __init__(self) -> None:
        self._lib: Any = None
        self.context: Any = None
        self._display: Any = None
        self._surfaces: Callable[[], tuple[Any, Any]] = lambda: (None, None)  # draw, read
        self._make: Any = None

    def find(self) -> None:
        for name in () if self._lib else self.libraries:
            try:
                self._lib = ctypes.CDLL(name, mode=os.RTLD_NOLOAD | os.RTLD_LAZY)
            except OSError:
                continue
            self._declare()
            return

    def _declare(self) -> None: ...

    def current(self) -> Binding | None:
        context = self.context() if self._lib else None
        return Binding(self, context, (self._display(), *self._surfaces())) if context else None

    def bind(self, binding: Binding) -> bool:
        return bool(self._make(*binding.rest, binding.context))

    def unbind(self) -> None:
        if self._lib and self.context():
            self._make(self._display(), None, None, None)

    def _function(self, name: str, result: Any, *arguments: Any) -> Callable[..., Any]:
        function = getattr(self._lib, name)
        function.restype, function.argtypes = result, arguments
        return function


_P = ctypes.c_void_p


class _Egl(_Api):
    libraries = ("libEGL.so.1", "libEGL.so")

    def _declare(self) -> None:
        self.context = self._function("eglGetCurrentContext", _P)
        self._display = self._function("eglGetCurrentDisplay", _P)
        surface = self._function("eglGetCurrentSurface", _P, ctypes.c_int)
        self._surfaces = lambda: (surface(0x3059), surface(0x305A))
        self._make = self._function("eglMakeCurrent", ctypes.c_uint, _P, _P, _P, _P)


class _Glx(_Api):
    libraries = ("libGLX.so.0", "libGL.so.1", "libGL.so")

    def _declare(self) -> None:
        self.context = self._function("glXGetCurrentContext", _P)
        self._display = self._function("glXGetCurrentDisplay", _P)
        draw = self._function("glXGetCurrentDrawable", ctypes.c_ulong)
        read = self._function("glXGetCurrentReadDrawable", ctypes.c_ulong)
        self._surfaces = lambda: (draw(), read())
        make = self._function("glXMakeContextCurrent", ctypes.c_int, _P, ctypes.c_ulong, ctypes.c_ulong, _P)
        self._make = lambda display, drawn, shown, context: make(display, drawn or 0, shown or 0, context)


class _OSMesa(_Api):
    """OSMesa shares Mesa's current context with EGL and GLX, but does not notify them of a change."""

    libraries = ("libOSMesa.so.8", "libOSMesa.so.6", "libOSMesa.so")

    def __init__(self) -> None:
        super().__init__()
        self._as_seen: dict[int, Handle] = {}  # handle of EGL or GLX -> OSMesa's handle while it is current

    def _declare(self) -> None:
        self.context = self._function("OSMesaGetCurrentContext", _P)
        self._make = self._function(
            "OSMesaMakeCurrent", ctypes.c_ubyte, _P, _P, ctypes.c_uint, ctypes.c_int, ctypes.c_int
        )
        out = ctypes.POINTER(ctypes.c_int)
        self._colour = self._function("OSMesaGetColorBuffer", ctypes.c_ubyte, _P, out, out, out, ctypes.POINTER(_P))
        self._get = self._function("OSMesaGetIntegerv", None, ctypes.c_int, out)

    def current(self, other: Binding | None = None) -> Binding | None:
        """Return the binding unless it is ``other``, the context that EGL or GLX report as current."""
        context = self.context() if self._lib else None
        if not context or (other is not None and self._as_seen.get(other.context, context) == context):
            return None
        width, height, kind, buffer = ctypes.c_int(), ctypes.c_int(), ctypes.c_int(), _P()
        self._colour(context, width, height, kind, buffer)
        self._get(0x23, kind)  # OSMESA_TYPE
        return Binding(self, context, (buffer, kind.value, width.value, height.value))

    def holds(self, other: int) -> bool:
        """Return whether ``other``, which EGL or GLX report as current, still is."""
        return self._lib is None or (other in self._as_seen and self._as_seen[other] == self.context())

    def note(self, other: int) -> None:
        """Record that EGL or GLX just made ``other`` current."""
        if self._lib:
            self._as_seen[other] = self.context()

    def bind(self, binding: Binding) -> bool:
        return bool(self._make(binding.context, *binding.rest))

    def unbind(self) -> None:
        if self._lib and self.context():
            self._make(None, None, 0, 0, 0)


_EGL, _GLX, _OSMESA = _Egl(), _Glx(), _OSMesa()
_APIS: tuple[_Api, ...] = (_EGL, _GLX, _OSMESA)


_find_symbol: Any = getattr(ctypes.CDLL(None), "dlsym", None) if sys.platform.startswith("linux") else None
if _find_symbol is not None:
    _find_symbol.restype, _find_symbol.argtypes = _P, (_P, ctypes.c_char_p)


def look() -> None:
    """Find the libraries that this process has loaded. Takes 0.1 ms; call it where contexts are made."""
    for api in _APIS:
        api.find()


def _look_for_osmesa() -> None:
    # a library such as PyOpenGL may have loaded OSMesa after our contexts were made
    if _OSMESA._lib is None and _find_symbol is not None and _find_symbol(None, b"OSMesaGetCurrentContext"):
        look()


def binding() -> Binding | None:
    """Return the current context of this thread."""
    _look_for_osmesa()
    other = _EGL.current() or _GLX.current()
    return _OSMESA.current(other) or other


def is_current(mine: Binding) -> bool:
    """Return whether GL calls of this thread go to ``mine``."""
    _look_for_osmesa()
    if mine.api is _OSMESA:
        return bool(_OSMESA.context() == mine.context)
    return bool(mine.api.context() == mine.context) and _OSMESA.holds(mine.context)


def bind(mine: Binding) -> None:
    """Make ``mine`` current. Raises ContextError if it cannot be."""
    _look_for_osmesa()
    if mine.api is _OSMESA:
        if _GLX._lib and _GLX.context():
            _GLX.unbind()
        _EGL.unbind()
    else:
        if _OSMESA._lib:  # EGL and GLX skip a context that they believe current: unbind first
            _OSMESA.unbind()
            mine.api.unbind()
        (_GLX if mine.api is _EGL else _EGL).unbind()
    if not mine.api.bind(mine):
        raise ContextError(
            "the OpenGL context cannot become current: is it current on another thread, or was it (or its window) "
            "destroyed? release it there first"
        )
    if mine.api is not _OSMESA:
        _OSMESA.note(mine.context)


def give_back(former: Binding | None) -> None:
    """Make ``former`` current again; leave no context current if it is None or was destroyed."""
    if former is None:
        unbind()
    elif not is_current(former):
        try:
            bind(former)
        except ContextError:
            unbind()


def unbind() -> None:
    """Leave this thread without a context."""
    for api in reversed(_APIS):
        api.unbind()
