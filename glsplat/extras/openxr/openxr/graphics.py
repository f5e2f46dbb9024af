"""Graphics bindings of the current OpenGL context for XR_MNDX_egl_enable and XR_KHR_opengl_enable."""

from __future__ import annotations

import ctypes
import sys
from typing import Any

from glsplat.errors import ContextError
from glsplat.extras.openxr.openxr.calls import pyopenxr

OPENGL_ENABLE, EGL_ENABLE = "XR_KHR_opengl_enable", "XR_MNDX_egl_enable"
_P, _I = ctypes.c_void_p, ctypes.c_int


def _library(*names: str) -> Any:
    for name in names:
        try:
            return ctypes.CDLL(name)
        except OSError:
            continue
    return None


def _declared(library: Any, name: str, result: Any, *arguments: Any) -> Any:
    call = getattr(library, name)
    call.restype, call.argtypes = result, arguments
    return call


def api_in_use() -> str:
    """Return the API of this thread's current context: "egl", "glx" or "wgl". Raises ContextError if there is none."""
    if sys.platform == "win32":
        return "wgl"
    egl = _library("libEGL.so.1")
    if egl is not None and _declared(egl, "eglGetCurrentContext", _P)():
        return "egl"
    glx = _library("libGLX.so.0", "libGL.so.1")
    if glx is not None and _declared(glx, "glXGetCurrentContext", _P)():
        return "glx"
    raise ContextError("OpenXR needs an OpenGL context of EGL or GLX that is current; OSMesa's cannot be shared")


def graphics_binding(api: str) -> Any:
    """Return ``SessionCreateInfo.next`` for the current context."""
    if api == "egl":
        return _egl()
    return _glx() if api == "glx" else _wgl()


def _egl() -> Any:
    xr, egl = pyopenxr(), _library("libEGL.so.1")
    display = _declared(egl, "eglGetCurrentDisplay", _P)()
    context = _declared(egl, "eglGetCurrentContext", _P)()
    number = _I()
    query = _declared(egl, "eglQueryContext", ctypes.c_uint, _P, _P, _I, ctypes.POINTER(_I))
    query(display, context, 0x3028, ctypes.byref(number))  # EGL_CONFIG_ID
    config, count = _P(), _I()
    choose = _declared(egl, "eglChooseConfig", ctypes.c_uint, _P, _P, _P, _I, _P)
    choose(display, (_I * 3)(0x3028, number.value, 0x3038), ctypes.byref(config), 1, ctypes.byref(count))
    binding = xr.GraphicsBindingEGLMNDX()
    _fill(binding, get_proc_address=ctypes.cast(egl.eglGetProcAddress, _P).value, display=display)
    _fill(binding, config=config.value, context=context)
    return binding


def _glx() -> Any:
    xr, glx = pyopenxr(), _library("libGLX.so.0", "libGL.so.1")
    display = _declared(glx, "glXGetCurrentDisplay", _P)()
    context = _declared(glx, "glXGetCurrentContext", _P)()
    drawable = _declared(glx, "glXGetCurrentDrawable", ctypes.c_ulong)()
    query = _declared(glx, "glXQueryContext", _I, _P, _P, _I, ctypes.POINTER(_I))
    number, screen, visual, count = _I(), _I(), _I(), _I()
    query(display, context, 0x8013, ctypes.byref(number))  # GLX_FBCONFIG_ID
    query(display, context, 0x800C, ctypes.byref(screen))  # GLX_SCREEN
    choose = _declared(glx, "glXChooseFBConfig", ctypes.POINTER(_P), _P, _I, _P, ctypes.POINTER(_I))
    configs = choose(display, screen, (_I * 3)(0x8013, number.value, 0), ctypes.byref(count))
    config = configs[0] if configs and count.value else None
    if config is not None:
        attribute = _declared(glx, "glXGetFBConfigAttrib", _I, _P, _P, _I, ctypes.POINTER(_I))
        attribute(display, config, 0x800B, ctypes.byref(visual))  # GLX_VISUAL_ID
    binding = xr.GraphicsBindingOpenGLXlibKHR()
    _fill(binding, x_display=display, visualid=visual.value, glx_fbconfig=config)
    _fill(binding, glx_drawable=drawable, glx_context=context)
    return binding


def _wgl() -> Any:
    xr, wgl = pyopenxr(), ctypes.CDLL("opengl32")
    binding = xr.GraphicsBindingOpenGLWin32KHR()
    _fill(binding, h_dc=_declared(wgl, "wglGetCurrentDC", _P)(), h_glrc=_declared(wgl, "wglGetCurrentContext", _P)())
    return binding


def _fill(structure: Any, **handles: Any) -> None:
    """Set handles; their types depend on PyOpenGL's libraries."""
    kinds = dict(type(structure)._fields_)
    for name, value in handles.items():
        try:
            setattr(structure, name, value)
        except TypeError:
            setattr(structure, name, ctypes.cast(value, kinds[name]))
