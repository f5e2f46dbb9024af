"""OpenGL contexts without a window: EGL on a chosen device, OSMesa through its C library, or a given context.

The abilities of a driver are probed by rendering, not read from extension strings (docs/shaders.md has the reasons).
"""

from __future__ import annotations

import ctypes
import ctypes.util
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import NoneType, TracebackType
from typing import Any

import moderngl
import numpy as np

from glsplat.arrays import instance
from glsplat.errors import ContextError, ShaderError
from glsplat.gl import current
from glsplat.gl.owner import ContextGuard, Owner, check_process, destroy_when_dropped, owner_of, release_dropped
from glsplat.gl.software import is_software
from glsplat.gl.state import GLState
from glsplat.shaders import Variant, flatten, link

REQUIRED = 330
INSTALL = (
    "install Mesa's software driver (Debian/Ubuntu: apt-get install libegl1 libgl1 libegl-mesa0 libgl1-mesa-dri)"
    " or your GPU's driver"
)


@dataclass(frozen=True, eq=False)
class Context:
    """A moderngl context and its abilities. It belongs to the thread that made it (docs/python.md).

    glsplat makes it current by itself. For your own OpenGL calls use ``with context:``, which makes it current and
    restores the previous context afterwards.
    """

    ctx: moderngl.Context
    backend: str  # egl, osmesa or given
    vertex_layers: bool  # the vertex shader can write gl_Layer (probed)
    vertex_ids: bool  # gl_VertexID counts beyond the first 4096 points of a draw (probed)
    compute: bool  # OpenGL 4.3
    vertex_storage: bool  # OpenGL 4.3 with storage buffers in vertex shaders
    software: bool  # a software rasterizer
    scratch: moderngl.Framebuffer  # 1x1, bound between frames
    owner: Owner
    state: GLState | None = None  # saves and restores the state of a given context
    _guards: list[ContextGuard] = field(default_factory=list)

    @property
    def driver(self) -> str:
        """Return the renderer and version strings of the driver."""
        return f"{self.ctx.info['GL_RENDERER']}, {self.ctx.info['GL_VERSION']}"

    @property
    def max_size(self) -> int:
        """Return the largest width or height of a target in pixels."""
        info = self.ctx.info
        return min(info["GL_MAX_TEXTURE_SIZE"], *info["GL_MAX_VIEWPORT_DIMS"])

    @property
    def released(self) -> bool:
        """Return whether release() was called."""
        return isinstance(self.scratch.mglo, moderngl.InvalidObject)

    def entered(self, call: str) -> ContextGuard:
        """Return a context manager that makes this context current and restores everything afterwards.

        It raises ContextError, which names ``call``, on another thread, in a forked child and after release().
        """
        if self.released:
            raise ContextError(f"{call}: this context was released; make a new one")
        return ContextGuard(self.owner, call, self.state)

    def __enter__(self) -> Context:
        guard = ContextGuard(self.owner, "Context", None, draws=False)
        guard.__enter__()
        self._guards.append(guard)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._guards.pop().__exit__(kind, error, trace)

    def break_cycle(self) -> None:
        """Break the reference cycle through the bound framebuffer, so that the last reference frees the context."""
        if self.ctx.fbo is self.scratch:
            self.ctx.fbo = None  # type: ignore[assignment]  # as moderngl leaves a new context

    def release(self) -> None:
        """Destroy the context unless it was given; may be called twice. Raises ContextError on another thread."""
        if self.released or self.owner.forked:
            return
        with self.entered("Context.release()"):
            if self.state is None:
                self.scratch.use()  # moderngl rebinds the previous framebuffer, and fails if it is deleted
            else:
                self.state.release()
            for texture in self.scratch.color_attachments:
                texture.release()
            self.scratch.release()
        if self.backend != "given":
            self.owner.destroyed = True
            self.owner.leave()
            self.ctx.release()


def create_context(
    device: int | str | None = None,
    backend: str | None = None,
    given: moderngl.Context | None = None,
) -> Context:
    """Return a context that can render, with its abilities probed.

    ``device`` is an index or a part of a name in ``egl_devices()``; by default GLSPLAT_DEVICE, else the first.
    ``backend`` is egl or osmesa; by default GLSPLAT_BACKEND, else EGL and, where EGL has no device, OSMesa.
    ``given`` is your own moderngl context, current on this thread; its state is restored after every call. A new
    context stays current if none was. Raises ContextError with the list of devices or the packages to install.

    >>> context = glsplat.create_context()
    >>> renderer = glsplat.Renderer(glsplat.default_avatar(), size=(320, 240), context=context)
    >>> renderer.release()
    >>> context.release()
    """
    check_process()
    kinds = (int, str, NoneType)
    if isinstance(device, bool) or not isinstance(device, kinds) or not isinstance(backend, (str, NoneType)):
        raise ContextError(
            f"device needs an index or a name and backend a name, not {device!r:.40} and {backend!r:.40}"
        )
    instance(given, (moderngl.Context, NoneType), "given", ContextError, "make it with moderngl.create_context()")
    current.look()
    release_dropped()
    if given is not None:
        return _given(given)
    with _kept_current():
        current.unbind()  # a library refuses to make a context current over one of another library
        return _created(device, backend)


def _created(device: int | str | None, backend: str | None) -> Context:
    backend = backend or os.environ.get("GLSPLAT_BACKEND") or None
    if backend not in (None, "egl", "osmesa"):
        raise ContextError(f"backend needs egl or osmesa, not {backend}")
    if backend == "osmesa":
        return _own(_osmesa(), "osmesa")
    device = device if device is not None else os.environ.get("GLSPLAT_DEVICE") or None
    try:
        return _own(_egl(device), "egl")
    except ContextError:
        if backend == "egl" or device is not None or not _osmesa_library():
            raise
        return _own(_osmesa(), "osmesa")


def egl_devices() -> list[str]:
    """Return the names of the EGL devices in index order, e.g. ["NVIDIA (cuda 0)", "Mesa software"]; [] without EGL."""
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
            listed = ", ".join(f"{i} = {name}" for i, name in enumerate(names))
            raise ContextError(f"no EGL device {text!r:.40}; give an index or a part of a name: {listed}")
        index = matches[0]
    # glcontext lets this variable override the argument it is given
    variable = os.environ.pop("GLCONTEXT_DEVICE_INDEX", None)
    try:
        return _made(standalone=True, backend="egl", device_index=index)
    except Exception as error:  # glcontext raises bare Exception
        raise ContextError(f"EGL device {index} ({names[index]}) gives no OpenGL 3.3: {error}; {INSTALL}") from None
    finally:
        if variable is not None:
            os.environ["GLCONTEXT_DEVICE_INDEX"] = variable


def _made(**settings: Any) -> moderngl.Context:
    """Return a new context without making it moderngl's default context, which belongs to the user."""
    store = getattr(moderngl, "_store", None)
    default = getattr(store, "default_context", None)
    try:
        return moderngl.create_context(require=REQUIRED, **settings)
    finally:
        if store is not None:
            store.default_context = default


def _osmesa_library() -> str | None:
    return ctypes.util.find_library("OSMesa")


class _OSMesa:
    """moderngl's interface of a context object on OSMesa's C functions."""

    def __init__(self) -> None:
        path = _osmesa_library()
        if path is None:
            raise ContextError("no OSMesa library; Debian/Ubuntu: apt-get install libosmesa6")
        lib = self._lib = ctypes.CDLL(path)
        current.look()
        lib.OSMesaCreateContextAttribs.restype = ctypes.c_void_p
        lib.OSMesaCreateContextAttribs.argtypes = [ctypes.c_void_p, ctypes.c_void_p]
        lib.OSMesaMakeCurrent.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_uint, ctypes.c_int, ctypes.c_int]
        lib.OSMesaGetProcAddress.restype = ctypes.c_void_p
        lib.OSMesaGetProcAddress.argtypes = [ctypes.c_char_p]
        lib.OSMesaDestroyContext.argtypes = [ctypes.c_void_p]
        # format RGBA, profile core, version 3.3 at least (names from GL/osmesa.h)
        attributes = (ctypes.c_int * 9)(0x22, 0x1908, 0x33, 0x34, 0x36, 3, 0x37, 3, 0)
        self._handle = lib.OSMesaCreateContextAttribs(attributes, None)
        self._pixels = ctypes.create_string_buffer(16 * 16 * 4)  # never drawn to, but OSMesa requires a buffer
        if not self._handle:
            raise ContextError("OSMesa gives no OpenGL 3.3 core context; update Mesa")
        self.__enter__()

    def load_opengl_function(self, name: str) -> int:
        """Return the address of a GL function, 0 if there is none."""
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
    return _made(context=_OSMesa())


def _own(ctx: moderngl.Context, backend: str) -> Context:
    current.look()
    owner = owner_of(ctx, current.binding())
    destroy_when_dropped(ctx, owner, f"a context of glsplat ({backend})")
    return _probed(ctx, backend, owner)


def _given(given: moderngl.Context) -> Context:
    if given.version_code < REQUIRED:
        raise ContextError(f"OpenGL 3.3 is needed, this context has {given.version_code / 100:.1f}; {INSTALL}")
    with _kept_current(always=True):
        try:
            given.mglo.__enter__()  # makes a context of moderngl current
        except Exception:  # the context of a window may lack this method: it has to be current already
            pass
        owner, state = owner_of(given, current.binding()), GLState(given)
        with owner.entered("create_context()", state):
            return _probed(given, "given", owner, state)


@contextmanager
def _kept_current(always: bool = False) -> Iterator[None]:
    """Make the previous context current again. Without one, unbind only after an error, or ``always``."""
    former = current.binding()
    try:
        yield
    except BaseException:
        always = True
        raise
    finally:
        if former is not None or always:
            current.give_back(former)


def _probed(ctx: moderngl.Context, backend: str, owner: Owner, state: GLState | None = None) -> Context:
    software = is_software(ctx.info["GL_RENDERER"])
    scratch = ctx.framebuffer([ctx.texture((1, 1), 4)])
    layers = _vertex_layers(ctx, scratch)
    ids = _vertex_ids(ctx)
    compute = ctx.version_code >= 430
    storage = compute and ctx.info["GL_MAX_VERTEX_SHADER_STORAGE_BLOCKS"] > 0  # OpenGL 4.3 allows 0
    return Context(ctx, backend, layers, ids, compute, storage, software, scratch, owner, state)


def _vertex_ids(ctx: moderngl.Context) -> bool:
    """Return whether gl_VertexID counts all points of a draw: Mesa's softpipe (22.3.6) restarts it every 4096."""
    text = "out float id; void main() { id = float(gl_VertexID); gl_Position = vec4(0.0); }"
    source = flatten("probe.vert.glsl", {}, overrides={"probe.vert.glsl": text})
    program = link(ctx, "probe", {"vertex_shader": source}, ("id",))
    array = ctx.vertex_array(program, [])
    count = 5000
    result = ctx.buffer(reserve=count * 4)
    try:
        array.transform(result, moderngl.POINTS, vertices=count)
        return bool(np.array_equal(np.frombuffer(result.read(), np.float32), np.arange(count)))
    finally:
        result.release()
        array.release()
        program.release()


def _vertex_layers(ctx: moderngl.Context, scratch: moderngl.Framebuffer) -> bool:
    """Return whether the vertex shader can route a pixel to each of two layers."""
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
    except (moderngl.Error, ShaderError):  # a driver that rejects the shader cannot either
        return False
    finally:
        scratch.use()
        framebuffer.release()
        texture.release()
