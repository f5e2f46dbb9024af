"""GLState: saves the state of a given context before glsplat draws in it, and restores it afterwards.

moderngl can query little of the GL state, so it is read by GL functions. docs/python.md lists the state that is not
restored.
"""

from __future__ import annotations

import ctypes
from typing import Any, NamedTuple

import moderngl

from glsplat.gl.functions import gl_functions
from glsplat.shaders.slots import UNITS

# name -> (enum, values, least GL version). One glGet each.
_INTEGERS: dict[str, tuple[int, int, int]] = {
    "program": (0x8B8D, 1, 330),
    "vertex_array": (0x85B5, 1, 330),
    "array_buffer": (0x8894, 1, 330),
    "pack_buffer": (0x88ED, 1, 330),
    "unpack_buffer": (0x88EF, 1, 330),
    "feedback": (0x8E25, 1, 400),
    "draw_framebuffer": (0x8CA6, 1, 330),
    "read_framebuffer": (0x8CAA, 1, 330),
    "active_texture": (0x84E0, 1, 330),
    "viewport": (0x0BA2, 4, 330),
    "scissor": (0x0C10, 4, 330),
    "colour_mask": (0x0C23, 4, 330),
    "depth_mask": (0x0B72, 1, 330),
    "depth_func": (0x0B74, 1, 330),
    "polygon_mode": (0x0B40, 2, 330),
    "blend_source": (0x80C9, 1, 330),
    "blend_target": (0x80C8, 1, 330),
    "blend_source_alpha": (0x80CB, 1, 330),
    "blend_target_alpha": (0x80CA, 1, 330),
    "blend_equation": (0x8009, 1, 330),
    "blend_equation_alpha": (0x883D, 1, 330),
    "clamp_read": (0x891C, 1, 330),
    "provoking_vertex": (0x8E4F, 1, 330),
    "clip_origin": (0x935C, 1, 450),
    "clip_depth": (0x935D, 1, 450),
}
# pixel store: enum -> value that moderngl's reads and writes need; None: moderngl sets it
_PIXEL_STORE = {
    0x0D00: 0,  # GL_PACK_SWAP_BYTES
    0x0D02: 0,  # ROW_LENGTH
    0x0D03: 0,  # SKIP_ROWS
    0x0D04: 0,  # SKIP_PIXELS
    0x0D05: None,  # ALIGNMENT
    0x806C: 0,  # IMAGE_HEIGHT
    0x806B: 0,  # SKIP_IMAGES
    0x0CF0: 0,  # GL_UNPACK_..., in the same order
    0x0CF2: 0,
    0x0CF3: 0,
    0x0CF4: 0,
    0x0CF5: None,
    0x806E: 0,
    0x806D: 0,
}
# enum -> (value that drawing needs, least GL version); None: moderngl sets it
_SWITCHES: dict[int, tuple[bool | None, int]] = {
    0x0BE2: (None, 330),  # BLEND
    0x0B71: (None, 330),  # DEPTH_TEST
    0x0B44: (None, 330),  # CULL_FACE
    0x8C89: (None, 330),  # RASTERIZER_DISCARD
    0x8642: (None, 330),  # PROGRAM_POINT_SIZE
    0x0C11: (False, 330),  # SCISSOR_TEST
    0x809E: (False, 330),  # SAMPLE_ALPHA_TO_COVERAGE
    0x809F: (False, 330),  # SAMPLE_ALPHA_TO_ONE
    0x0B90: (False, 330),  # STENCIL_TEST
    0x0BF2: (False, 330),  # COLOR_LOGIC_OP
    0x0BD0: (True, 330),  # DITHER: the default of a new context
    0x8F9D: (False, 330),  # PRIMITIVE_RESTART
    0x8D69: (False, 430),  # PRIMITIVE_RESTART_FIXED_INDEX
    0x8DB9: (False, 330),  # FRAMEBUFFER_SRGB
    0x809D: (True, 330),  # MULTISAMPLE
    0x80A0: (False, 330),  # SAMPLE_COVERAGE
    0x8E51: (False, 330),  # SAMPLE_MASK
    0x8C36: (False, 400),  # SAMPLE_SHADING
    0x8037: (False, 330),  # POLYGON_OFFSET_FILL
    0x0B41: (False, 330),  # POLYGON_SMOOTH
    0x864F: (False, 330),  # DEPTH_CLAMP
    **{0x3000 + i: (False, 330) for i in range(8)},  # CLIP_DISTANCEi
}
_ENABLE_ONLY = {  # switches that moderngl tracks itself
    0x0BE2: moderngl.BLEND,
    0x0B71: moderngl.DEPTH_TEST,
    0x0B44: moderngl.CULL_FACE,
    0x8C89: moderngl.RASTERIZER_DISCARD,
    0x8642: moderngl.PROGRAM_POINT_SIZE,
}
_ARRAY_UNITS = (UNITS["target"], UNITS["depth_sum"])  # where array textures are bound
_SPLAT_UNITS = (0, 1, 2)
_MESH_UNITS = tuple(sorted(set(UNITS.values()) - set(_SPLAT_UNITS)))  # of the passes of meshes alone
_STORAGE_SLOTS = range(5)  # of the GPU sorter; the draw reads records from the first
_UNIFORM, _STORAGE = (0x8A11, 0x8A28), (0x90D2, 0x90D3)  # target, binding
_FILL, _ADD, _LEQUAL, _LAST_VERTEX = 0x1B02, 0x8006, 0x0203, 0x8E4E
_VALUES = (("depth_func", "DepthFunc", _LEQUAL), ("provoking_vertex", "ProvokingVertex", _LAST_VERTEX))
_LOWER_LEFT, _NEGATIVE_ONE = 0x8CA1, 0x935E

_I, _U, _P, _L = ctypes.c_int, ctypes.c_uint, ctypes.c_void_p, ctypes.c_ssize_t
_F, _D = ctypes.c_float, ctypes.c_double
_SIGNATURES: dict[str, tuple[Any, ...]] = {
    "GetFloatv": (_U, _P),
    "GetInteger64i_v": (_U, _U, _P),
    "Enable": (_U,),
    "Disable": (_U,),
    "UseProgram": (_U,),
    "BindVertexArray": (_U,),
    "BindBuffer": (_U, _U),
    "BindBufferBase": (_U, _U, _U),
    "BindBufferRange": (_U, _U, _U, _L, _L),
    "BindFramebuffer": (_U, _U),
    "ActiveTexture": (_U,),
    "BindTexture": (_U, _U),
    "BindSampler": (_U, _U),
    "Viewport": (_I, _I, _I, _I),
    "Scissor": (_I, _I, _I, _I),
    "ColorMaski": (_U, _I, _I, _I, _I),
    "DepthMask": (_I,),
    "DepthFunc": (_U,),
    "DepthRange": (_D, _D),
    "PolygonMode": (_U, _U),
    "BlendFuncSeparate": (_U, _U, _U, _U),
    "BlendEquationSeparate": (_U, _U),
    "ClampColor": (_U, _U),
    "ProvokingVertex": (_U,),
    "ClearColor": (_F, _F, _F, _F),
    "ClearDepth": (_D,),
    "PixelStorei": (_U, _I),
    "ClipControl": (_U, _U),
    "GenTransformFeedbacks": (_I, _P),
    "BindTransformFeedback": (_U, _U),
    "DeleteTransformFeedbacks": (_I, _P),
}
_TESTS = tuple("Is" + kind for kind in "Framebuffer VertexArray Buffer Texture Sampler Program".split())


class Snapshot(NamedTuple):
    """GL state saved by ``GLState.save``."""

    integers: tuple[int, ...]
    floats: tuple[float, ...]  # clear colour, clear depth, depth range
    pixel_store: tuple[int, ...]
    switches: tuple[int, ...]
    units: list[tuple[int, int, int, int]]  # unit; 2D texture, 2D array texture, sampler
    slots: tuple[tuple[int, int, int, int, int, int], ...]  # target, binding, index; buffer, start, size
    framebuffer: Any  # as moderngl knows it
    native: Any


class GLState:
    """State of one context: ``snapshot = save()``, draw, ``restore(snapshot)``. The context has to be current."""

    def __init__(self, ctx: moderngl.Context) -> None:
        self._ctx = ctx
        version = ctx.version_code
        function = gl_functions(ctx)
        self._gl = {name: function(name, None, *arguments) for name, arguments in _SIGNATURES.items()}
        self._gl |= {name: function(name, ctypes.c_ubyte, _U) for name in _TESTS}
        # called dozens of times a frame: a call without declared arguments is a third cheaper
        self._get: Any = function("GetIntegerv", None)
        self._enabled: Any = function("IsEnabled", ctypes.c_ubyte)
        self._integers = (ctypes.c_int * 64)()
        self._floats = (ctypes.c_float * 8)()
        self._long = (ctypes.c_int64 * 1)()
        self._at: dict[str, int] = {}
        self._reads: list[tuple[int, Any]] = []
        start, here = 0, ctypes.addressof(self._integers)
        for name, (enum, count, least) in _INTEGERS.items():
            self._at[name] = start
            if version >= least:
                self._reads.append((enum, _P(here + 4 * start)))
            start += count
        self._count = start
        self._pixel_reads = [(enum, _P(here + 4 * (start + i))) for i, enum in enumerate(_PIXEL_STORE)]
        self._switches = [(enum, needed) for enum, (needed, least) in _SWITCHES.items() if version >= least]
        self._slots = [(*_UNIFORM, 0)]
        self._units: tuple[int, ...] = _SPLAT_UNITS
        self._saved: list[tuple[int, int, int, int]] = []  # the units of the last snapshot
        self._version = version
        self._own = ctypes.c_uint(0)  # own transform feedback, which keeps the user's slots unchanged
        if version >= 400:
            self._gl["GenTransformFeedbacks"](1, ctypes.byref(self._own))

    def save(self) -> Snapshot:
        """Return the current state, then set the state that the passes rely on but do not set."""
        snapshot = self._read()
        self._neutral(snapshot)
        return snapshot

    def include_storage(self) -> None:
        """Also save and restore the shader storage slots of the GPU sorter and the draw."""
        self._slots = [(*_UNIFORM, 0)] + [(*_STORAGE, i) for i in _STORAGE_SLOTS if self._version >= 430]

    def include_meshes(self) -> None:
        """Also save and restore the texture units of meshes; from now on, the present frame included."""
        if self._units == _SPLAT_UNITS:
            self._units = _SPLAT_UNITS + _MESH_UNITS
            found = self._read_units(_MESH_UNITS)
            self._saved += found
            self._unbind_samplers(found)

    def release(self) -> None:
        """Delete the own transform feedback."""
        if self._own.value:
            self._gl["DeleteTransformFeedbacks"](1, ctypes.byref(self._own))
            self._own.value = 0

    def _read(self) -> Snapshot:
        gl, integers = self._gl, self._integers
        get, enabled = self._get, self._enabled
        for enum, pointer in self._reads:
            get(enum, pointer)
        for enum, pointer in self._pixel_reads:
            get(enum, pointer)
        floats = self._floats
        gl["GetFloatv"](0x0C22, floats)  # GL_COLOR_CLEAR_VALUE
        gl["GetFloatv"](0x0B73, ctypes.byref(floats, 16))  # GL_DEPTH_CLEAR_VALUE
        gl["GetFloatv"](0x0B70, ctypes.byref(floats, 20))  # GL_DEPTH_RANGE
        switches = tuple([enabled(enum) for enum, _ in self._switches])
        values = tuple(integers[:])
        self._saved = self._read_units(self._units)
        gl["ActiveTexture"](values[self._at["active_texture"]])
        slots = []
        for target, binding, index in self._slots:
            where = [0, 0, 0]  # buffer, start, size
            for i in range(3):
                gl["GetInteger64i_v"](binding + i, index, self._long)
                where[i] = self._long[0]
                if not where[0]:
                    break
            slots.append((target, binding, index, where[0], where[1], where[2]))
        end = self._count + len(_PIXEL_STORE)
        return Snapshot(
            values[: self._count],
            tuple(floats),
            values[self._count : end],
            switches,
            self._saved,
            tuple(slots),
            self._ctx.fbo,
            self._ctx.mglo.fbo,
        )

    def _read_units(self, units: tuple[int, ...]) -> list[tuple[int, int, int, int]]:
        """Return the bindings of texture units. Another unit is active afterwards."""
        get, integers, found = self._get, self._integers, []
        for unit in units:
            self._gl["ActiveTexture"](0x84C0 + unit)
            get(0x8069, integers)  # GL_TEXTURE_BINDING_2D, _2D_ARRAY, GL_SAMPLER_BINDING
            get(0x8919, ctypes.byref(integers, 8))
            if unit in _ARRAY_UNITS:
                get(0x8C1D, ctypes.byref(integers, 4))
            found.append((unit, integers[0], integers[1], integers[2]))
        return found

    def _unbind_samplers(self, units: list[tuple[int, int, int, int]]) -> None:
        for unit, _, _, sampler in units:
            if sampler:
                self._gl["BindSampler"](unit, 0)

    def _neutral(self, was: Snapshot) -> None:
        gl, at, values = self._gl, self._at, was.integers
        for (switch, wanted), on in zip(self._switches, was.switches, strict=True):
            if wanted is not None and wanted != on:
                gl["Enable" if wanted else "Disable"](switch)
        self._ctx.enable_only(moderngl.NOTHING)
        for (enum, need), value in zip(_PIXEL_STORE.items(), was.pixel_store, strict=True):
            if need is not None and need != value:
                gl["PixelStorei"](enum, need)
        for name, target in (("pack_buffer", 0x88EB), ("unpack_buffer", 0x88EC)):
            if values[at[name]]:
                gl["BindBuffer"](target, 0)
        self._unbind_samplers(was.units)
        mode = at["polygon_mode"]
        if values[mode] != _FILL:
            gl["PolygonMode"](0x0408, _FILL)  # GL_FRONT_AND_BACK
        for name, function, needed in _VALUES:
            if values[at[name]] != needed:
                gl[function](needed)
        if values[at["blend_equation"] : at["blend_equation"] + 2] != (_ADD, _ADD):
            gl["BlendEquationSeparate"](_ADD, _ADD)
        if was.floats[5:7] != (0.0, 1.0):
            gl["DepthRange"](0.0, 1.0)
        if self._version >= 450 and values[at["clip_origin"] : at["clip_depth"] + 1] != (_LOWER_LEFT, _NEGATIVE_ONE):
            gl["ClipControl"](_LOWER_LEFT, _NEGATIVE_ONE)
        if self._version >= 400:
            gl["BindTransformFeedback"](0x8E22, self._own.value)

    def restore(self, was: Snapshot) -> None:
        """Restore a saved state. Objects that were deleted meanwhile stay unbound."""
        gl, at, values, ctx = self._gl, self._at, was.integers, self._ctx
        bind = gl["BindBuffer"]

        def value(name: str) -> int:
            return values[at[name]]

        def alive(kind: str, name: int) -> int:
            return name if name and gl[kind](name) else 0

        draw, read = value("draw_framebuffer"), value("read_framebuffer")
        deleted = was.framebuffer is not None and isinstance(was.framebuffer.mglo, moderngl.InvalidObject)
        if draw == alive("IsFramebuffer", draw) and not deleted:
            ctx.fbo = was.framebuffer
            ctx.mglo.fbo = was.native
        flags = 0
        for (switch, wanted), on in zip(self._switches, was.switches, strict=True):
            if switch in _ENABLE_ONLY:
                flags |= _ENABLE_ONLY[switch] if on else 0
            elif wanted != on:
                gl["Enable" if on else "Disable"](switch)
        ctx.enable_only(flags)
        gl["BindFramebuffer"](0x8CA9, alive("IsFramebuffer", draw))
        gl["BindFramebuffer"](0x8CA8, alive("IsFramebuffer", read))
        gl["Viewport"](*values[at["viewport"] : at["viewport"] + 4])
        gl["Scissor"](*values[at["scissor"] : at["scissor"] + 4])
        gl["ColorMaski"](0, *values[at["colour_mask"] : at["colour_mask"] + 4])
        gl["DepthMask"](value("depth_mask"))
        gl["ClearColor"](*was.floats[:4])
        gl["ClearDepth"](was.floats[4])
        for name, function, needed in _VALUES:
            if value(name) != needed:
                gl[function](value(name))
        if was.floats[5:7] != (0.0, 1.0):
            gl["DepthRange"](*was.floats[5:7])
        if value("polygon_mode") != _FILL:
            gl["PolygonMode"](0x0408, value("polygon_mode"))
        first = at["blend_source"]
        gl["BlendFuncSeparate"](*values[first : first + 4])
        if values[first + 4 : first + 6] != (_ADD, _ADD):
            gl["BlendEquationSeparate"](*values[first + 4 : first + 6])
        gl["ClampColor"](0x891C, value("clamp_read"))
        if self._version >= 450 and values[at["clip_origin"] : at["clip_depth"] + 1] != (_LOWER_LEFT, _NEGATIVE_ONE):
            gl["ClipControl"](value("clip_origin"), value("clip_depth"))
        for (enum, need), stored in zip(_PIXEL_STORE.items(), was.pixel_store, strict=True):
            if need != stored:
                gl["PixelStorei"](enum, stored)
        for unit, flat, layered, sampler in was.units:
            gl["ActiveTexture"](0x84C0 + unit)
            gl["BindTexture"](0x0DE1, alive("IsTexture", flat))
            if unit in _ARRAY_UNITS:
                gl["BindTexture"](0x8C1A, alive("IsTexture", layered))
            if sampler:
                gl["BindSampler"](unit, alive("IsSampler", sampler))
        gl["ActiveTexture"](value("active_texture"))
        if self._version >= 400:
            gl["BindTransformFeedback"](0x8E22, value("feedback"))
        for target, _, index, buffer, start, size in was.slots:
            if size and alive("IsBuffer", buffer):
                gl["BindBufferRange"](target, index, buffer, start, size)
            else:
                gl["BindBufferBase"](target, index, alive("IsBuffer", buffer))
        bind(0x8892, alive("IsBuffer", value("array_buffer")))
        for name, target in (("pack_buffer", 0x88EB), ("unpack_buffer", 0x88EC)):
            if value(name):
                bind(target, alive("IsBuffer", value(name)))
        gl["BindVertexArray"](alive("IsVertexArray", value("vertex_array")))
        gl["UseProgram"](alive("IsProgram", value("program")))  # a deleted program lived only while it was in use
