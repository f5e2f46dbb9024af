"""OpenGL contexts without a window: EGL with device choice, OSMesa through its C library, or one that is given.

What a driver can do is probed by rendering, not read from extension strings (docs/shaders.md has the reasons).
"""

from __future__ import annotations

import ctypes
import ctypes.util
import os
from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np

from glsplat.errors import ContextError, ShaderError
from glsplat.shaders import Variant, flatten, link

__all__ = ["Context", "create_context", "egl_devices"]

REQUIRED = 330
INSTALL = "install Mesa's software driver (Debian/Ubuntu: apt-get install libegl1 libgl1-mesa-dri) or your GPU's driver"


@dataclass(frozen=True, eq=False)
class Context:
    """A moderngl context and what it can do. Belongs to the thread that made it."""

    ctx: moderngl.Context
    backend: str  # egl, osmesa or given
    vertex_layers: bool  # the vertex shader can write gl_Layer (probed)
    compute: bool  # OpenGL 4.3
    software: bool  # a software rasterizer
    scratch: moderngl.Framebuffer  # 1x1; what is bound while nothing is drawn

    @property
    def driver(self) -> str:
        """Renderer and version strings of the driver."""
        return f"{self.ctx.info['GL_RENDERER']}, {self.ctx.info['GL_VERSION']}"

    @property
    def max_size(self) -> int:
        """Largest width or height of a target in pixels."""
        info = self.ctx.info
        return min(info["GL_MAX_TEXTURE_SIZE"], *info["GL_MAX_VIEWPORT_DIMS"])

    def release(self) -> None:
        """Destroy the context unless it was given."""
        for texture in self.scratch.color_attachments:
            texture.release()
        self.scratch.release()
        if self.backend != "given":
            self.ctx.release()


def create_context(
    device: int | str | None = None,
    backend: str | None = None,
    given: moderngl.Context | None = None,
) -> Context:
    """A context that can render, with its abilities probed.

    ``device`` is an index or a part of a name in ``egl_devices()``; by default GLSPLAT_DEVICE, else the first.
    ``backend`` is egl or osmesa; by default GLSPLAT_BACKEND, else EGL and, where EGL has no device, OSMesa.
    Raises ContextError with the list of devices or what to install.

    >>> context = glsplat.create_context()
    >>> renderer = glsplat.Renderer(glsplat.default_avatar(), size=(320, 240), context=context)
    >>> renderer.release()
    >>> context.release()
    """
    if given is not None:
        return _probed(given, "given")
    backend = backend or os.environ.get("GLSPLAT_BACKEND") or None
    if backend not in (None, "egl", "osmesa"):
        raise ContextError(f"backend needs egl or osmesa, not {backend}")
    if backend == "osmesa":
        return _probed(_osmesa(), "osmesa")
    device = device if device is not None else os.environ.get("GLSPLAT_DEVICE") or None
    try:
        return _probed(_egl(device), "egl")
    except ContextError:
        if backend == "egl" or device is not None or not _osmesa_library():
            raise
        return _probed(_osmesa(), "osmesa")


def egl_devices() -> list[str]:
    """Names of the EGL devices in index order, e.g. ["NVIDIA (cuda 0)", "Mesa software"]; empty without EGL."""
    path = ctypes.util.find_library("EGL")
    if path is None:
        return []
    try:
        egl = ctypes.CDLL(path)
    except OSError:
        return []
    egl.eglGetProcAddress.restype = ctypes.c_void_p
    egl.eglGetProcAddress.argtypes = [ctypes.c_char_p]

    def function(name: bytes, result: Any, *arguments: Any) -> Any:
        address = egl.eglGetProcAddress(name)
        return ctypes.CFUNCTYPE(result, *arguments)(address) if address else None

    query = function(b"eglQueryDevicesEXT", ctypes.c_uint, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)
    string = function(b"eglQueryDeviceStringEXT", ctypes.c_char_p, ctypes.c_void_p, ctypes.c_int)
    attribute = function(
        b"eglQueryDeviceAttribEXT", ctypes.c_uint, ctypes.c_void_p, ctypes.c_int, ctypes.POINTER(ctypes.c_ssize_t)
    )
    if query is None or string is None:
        return []
    handles = (ctypes.c_void_p * 32)()
    count = ctypes.c_int()
    if not query(32, handles, ctypes.byref(count)):
        return []
    names = []
    for handle in handles[: count.value]:
        extensions = (string(handle, 0x3055) or b"").decode()  # EGL_EXTENSIONS
        value = ctypes.c_ssize_t()
        if "EGL_NV_device_cuda" in extensions and attribute and attribute(handle, 0x323A, ctypes.byref(value)):
            names.append(f"NVIDIA (cuda {value.value})")
        elif "EGL_MESA_device_software" in extensions:
            names.append("Mesa software")
        elif "EGL_EXT_device_drm" in extensions:
            names.append((string(handle, 0x3233) or b"drm device").decode())  # EGL_DRM_DEVICE_FILE_EXT
        else:
            names.append("unnamed")
    return names


def _egl(wanted: int | str | None) -> moderngl.Context:
    names = egl_devices()
    if not names:
        raise ContextError(f"found 0 EGL devices; {INSTALL}")
    index = 0
    if wanted is not None:
        text = str(wanted)
        matches = [i for i, name in enumerate(names) if text.lower() in name.lower()]
        if text.isdecimal():
            matches = [int(text)] if int(text) < len(names) else []
        if not matches:
            listed = "; ".join(f"{i}: {name}" for i, name in enumerate(names))
            raise ContextError(f"no EGL device {text!r}; there are {listed}")
        index = matches[0]
    # glcontext lets this variable override the argument it is given
    os.environ.pop("GLCONTEXT_DEVICE_INDEX", None)
    try:
        # moderngl's stub types the loader's settings as dicts
        settings: dict[str, Any] = {"backend": "egl", "device_index": index}
        return moderngl.create_context(standalone=True, require=REQUIRED, **settings)
    except Exception as error:  # glcontext raises bare Exception
        raise ContextError(f"EGL device {index} ({names[index]}) gives no OpenGL 3.3: {error}; {INSTALL}") from None


def _osmesa_library() -> str | None:
    return ctypes.util.find_library("OSMesa")


class _OSMesa:
    """What moderngl asks of a context object, on OSMesa's C functions."""

    def __init__(self) -> None:
        path = _osmesa_library()
        if path is None:
            raise ContextError("no OSMesa library; Debian/Ubuntu: apt-get install libosmesa6")
        lib = self._lib = ctypes.CDLL(path)
        lib.OSMesaCreateContextAttribs.restype = ctypes.c_void_p
        lib.OSMesaCreateContextAttribs.argtypes = [ctypes.c_void_p, ctypes.c_void_p]
        lib.OSMesaMakeCurrent.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_uint, ctypes.c_int, ctypes.c_int]
        lib.OSMesaGetProcAddress.restype = ctypes.c_void_p
        lib.OSMesaGetProcAddress.argtypes = [ctypes.c_char_p]
        lib.OSMesaDestroyContext.argtypes = [ctypes.c_void_p]
        # format RGBA, profile core, version 3.3 at least (names from GL/osmesa.h)
        attributes = (ctypes.c_int * 9)(0x22, 0x1908, 0x33, 0x34, 0x36, 3, 0x37, 3, 0)
        self._handle = lib.OSMesaCreateContextAttribs(attributes, None)
        self._pixels = ctypes.create_string_buffer(16 * 16 * 4)  # never drawn to; OSMesa wants one
        if not self._handle:
            raise ContextError("OSMesa gives no OpenGL 3.3 core context; update Mesa")
        self.__enter__()

    def load_opengl_function(self, name: str) -> int:
        """Address of a GL function, as moderngl asks for it."""
        return self._lib.OSMesaGetProcAddress(name.encode()) or 0

    def __enter__(self) -> _OSMesa:
        if not self._lib.OSMesaMakeCurrent(self._handle, self._pixels, 0x1401, 16, 16):  # GL_UNSIGNED_BYTE
            raise ContextError("OSMesa could not make its context current")
        return self

    def __exit__(self, *_: object) -> None: ...

    def release(self) -> None:
        """Destroy the context."""
        if self._handle:
            self._lib.OSMesaDestroyContext(self._handle)
            self._handle = None


def _osmesa() -> moderngl.Context:
    settings: dict[str, Any] = {"context": _OSMesa()}
    return moderngl.create_context(require=REQUIRED, **settings)


def _probed(ctx: moderngl.Context, backend: str) -> Context:
    if ctx.version_code < REQUIRED:
        raise ContextError(f"OpenGL 3.3 is needed, this context has {ctx.version_code / 100:.1f}; {INSTALL}")
    renderer = ctx.info["GL_RENDERER"].lower()
    software = any(name in renderer for name in ("llvmpipe", "softpipe", "swrast", "swiftshader"))
    scratch = ctx.framebuffer([ctx.texture((1, 1), 4)])
    layers = _vertex_layers(ctx, scratch)
    return Context(ctx, backend, layers, ctx.version_code >= 430, software, scratch)


def _vertex_layers(ctx: moderngl.Context, scratch: moderngl.Framebuffer) -> bool:
    """Draw one pixel into each of two layers, routed by the vertex shader, and look."""
    variant = Variant(views=2)
    vertex = flatten("screen.vert.glsl", variant.defines())
    fragment = flatten(
        "probe.frag.glsl",
        {},
        overrides={"probe.frag.glsl": "flat in int layer; out vec4 f; void main() { f = vec4(layer == 1 ? 1 : 0.5); }"},
    )
    texture = ctx.texture_array((1, 1, 2), 4)
    framebuffer = ctx.framebuffer([texture])
    try:
        framebuffer.clear()
        framebuffer.use()
        program = link(ctx, "probe", {"vertex_shader": vertex, "fragment_shader": fragment})
        array = ctx.vertex_array(program, [])
        array.render(moderngl.TRIANGLES, vertices=3, instances=2)
        layers = np.frombuffer(texture.read(), np.uint8).reshape(2, 4)[:, 0]
        array.release()
        program.release()
        return bool(abs(int(layers[0]) - 128) <= 1 and layers[1] == 255)
    except (moderngl.Error, ShaderError):  # a driver that rejects the shader answers the question as well
        return False
    finally:
        scratch.use()
        framebuffer.release()
        texture.release()
