"""EyePass: copies a stereo pair's float layers into the images of a headset's runtime, with one draw if possible."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from glsplat.errors import ContextError
from glsplat.gl.context import Context
from glsplat.gl.functions import gl_functions
from glsplat.renderer.targets import Target
from glsplat.shaders import Variant, flatten, link, set_uniforms
from glsplat.shaders.slots import UNITS

_FRAMEBUFFER, _COLOUR, _DEPTH, _COMPLETE = 0x8D40, 0x8CE0, 0x8D00, 0x8CD5
_ALWAYS, _LEQUAL = 0x0207, 0x0203
_U, _I = ctypes.c_uint, ctypes.c_int


@dataclass(frozen=True, slots=True)
class EyeImages:
    """The runtime's GL textures: one array texture of two layers, or a plain texture for each eye."""

    colour: tuple[int, ...]
    depth: tuple[int, ...] = ()  # as many, or none


@dataclass(frozen=True, slots=True)
class DepthRange:
    """Range of a depth image: z = near is 0, z = far is 1, with OpenGL's perspective between them."""

    near: float  # metres
    far: float


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Mirror and floor for eyes.frag.glsl, made by ``openxr.placing``; arrays [2, ...] have a row for each eye."""

    glass_from_pixel: NDArray[np.float64]  # [2, 3, 3]
    floor_from_pixel: NDArray[np.float64]  # [2, 3, 3]
    glass: tuple[float, float, float, float]  # half of its width, bottom, top, width of the frame; metres
    extent: tuple[float, float, float]  # of the floor
    eyes: NDArray[np.float64]  # [2, 2] x and z


class EyePass:
    """Owns framebuffers of a runtime's images; call ``forget`` before these are destroyed."""

    def __init__(self, context: Context, linear: bool = False) -> None:
        """Create the pass; ``linear``: the images' format is not sRGB and takes linear light."""
        self._context, self._ctx, self._linear = context, context.ctx, linear
        function = gl_functions(self._ctx)
        self._gl: dict[str, Any] = {
            "GenFramebuffers": function("GenFramebuffers", None, _I, ctypes.c_void_p),
            "DeleteFramebuffers": function("DeleteFramebuffers", None, _I, ctypes.c_void_p),
            "BindFramebuffer": function("BindFramebuffer", None, _U, _U),
            "FramebufferTexture": function("FramebufferTexture", None, _U, _U, _U, _I),
            "FramebufferTextureLayer": function("FramebufferTextureLayer", None, _U, _U, _U, _I, _I),
            "CheckFramebufferStatus": function("CheckFramebufferStatus", _U, _U),
            "Viewport": function("Viewport", None, _I, _I, _I, _I),
            "DepthFunc": function("DepthFunc", None, _U),
            "DepthMask": function("DepthMask", None, _I),
        }
        self._framebuffers: dict[EyeImages, tuple[int, ...]] = {}
        self._arrays: dict[tuple[int, ...], moderngl.VertexArray] = {}

    def run(
        self,
        target: Target,
        images: EyeImages,
        depth: DepthRange | None = None,
        around: Surroundings | None = None,
    ) -> None:
        """Fill ``images`` of the target's size; formats of 8 bits are rounded as by resolve.frag.glsl."""
        with self._context.entered("EyePass.run()"):
            views, height, width, _ = target.shape
            framebuffers = self._framebuffers_of(images)
            eyes = views // len(framebuffers)  # in a draw
            array = self._array(eyes, self._linear, bool(images.depth), target.lift is not None, around is not None)
            self._set(array.program, target, depth, around)
            array.program["corner"] = 0.0, 0.0, 1.0
            target.texture.use(UNITS["target"])
            if images.depth:
                if target.depth is None or depth is None:
                    raise ContextError("images of depth need a picture with depth and the range of their numbers")
                target.depth.use(UNITS["depth_sum"])
            self._ctx.enable_only(moderngl.DEPTH_TEST if images.depth else moderngl.NOTHING)
            if images.depth:  # depths are written only with a depth test
                self._gl["DepthFunc"](_ALWAYS)
                self._gl["DepthMask"](1)
            try:
                for first, framebuffer in enumerate(framebuffers):
                    self._gl["BindFramebuffer"](_FRAMEBUFFER, framebuffer)
                    self._gl["Viewport"](0, 0, width, height)
                    array.program["first"] = first
                    array.render(moderngl.TRIANGLES, vertices=3, instances=eyes)
            finally:
                if images.depth:
                    self._gl["DepthFunc"](_LEQUAL)
                self._ctx.enable_only(moderngl.NOTHING)
                self._context.scratch.use()  # bind again what moderngl believes is bound, with its masks

    def show(
        self,
        target: Target,
        framebuffer: moderngl.Framebuffer,
        size: tuple[int, int],
        around: Surroundings | None = None,
        eye: int = 0,
    ) -> None:
        """Draw one eye's picture into a window of ``size`` pixels, as large as it fits.

        It is not filtered: a smaller window skips pixels.
        """
        with self._context.entered("EyePass.show()"):
            _, height, width, _ = target.shape
            pixels = max(width / size[0], height / size[1])
            shown = max(1, int(width / pixels)), max(1, int(height / pixels))
            left, low = (size[0] - shown[0]) // 2, (size[1] - shown[1]) // 2
            array = self._array(1, False, False, target.lift is not None, around is not None)
            self._set(array.program, target, None, around)
            array.program["corner"] = float(left), float(low), pixels
            array.program["first"] = eye
            framebuffer.use()
            framebuffer.clear()
            self._ctx.enable_only(moderngl.NOTHING)
            target.texture.use(UNITS["target"])
            self._gl["Viewport"](left, low, *shown)
            array.render(moderngl.TRIANGLES, vertices=3)
            self._context.scratch.use()

    def forget(self) -> None:
        """Delete the framebuffers, before their images are destroyed."""
        with self._context.entered("EyePass.forget()"):
            for framebuffers in self._framebuffers.values():
                names = (_U * len(framebuffers))(*framebuffers)
                self._gl["DeleteFramebuffers"](len(framebuffers), names)
            self._framebuffers.clear()

    def release(self) -> None:
        """Delete framebuffers, programs and vertex arrays."""
        self.forget()
        with self._context.entered("EyePass.release()"):
            arrays, self._arrays = self._arrays, {}
            for array in arrays.values():
                array.program.release()
                array.release()

    def _set(
        self, program: moderngl.Program, target: Target, depth: DepthRange | None, around: Surroundings | None
    ) -> None:
        values: dict[str, Any] = {"rows": target.shape[1]}
        if target.lift is not None:
            values |= {"first_background": target.lift[0], "second_background": target.lift[-1]}
        if depth is not None:
            values["depth_range"] = depth.near, depth.far, target.depth_unit
        if around is not None:
            values |= {
                "glass_from_pixel": _columns(around.glass_from_pixel),
                "floor_from_pixel": _columns(around.floor_from_pixel),
                "glass": around.glass,
                "extent": around.extent,
                "eye": [tuple(row) for row in around.eyes.tolist()],
            }
        set_uniforms(program, values)

    def _array(self, eyes: int, linear: bool, depth: bool, lifted: bool, room: bool) -> moderngl.VertexArray:
        """Return the vertex array of a variant, compiled on first use."""
        key = (eyes, int(linear), int(depth), int(lifted), int(room))
        if key not in self._arrays:
            flags = Variant(views=eyes).defines()
            own = {"LINEAR": int(linear), "DEPTH": int(depth), "LIFTED": int(lifted), "ROOM": int(room)}
            stages = {
                "vertex_shader": flatten("screen.vert.glsl", flags),
                "fragment_shader": flatten("eyes.frag.glsl", flags | own),
            }
            self._arrays[key] = self._ctx.vertex_array(link(self._ctx, "eyes", stages), [])
        return self._arrays[key]

    def _framebuffers_of(self, images: EyeImages) -> tuple[int, ...]:
        """Return one framebuffer if a draw can write both layers, else one for each eye."""
        if images not in self._framebuffers:
            layered = len(images.colour) == 1
            if layered and self._context.vertex_layers:
                made = [self._framebuffer(images, 0, None)]
            else:
                made = [self._framebuffer(images, 0 if layered else eye, eye if layered else None) for eye in (0, 1)]
            self._framebuffers[images] = tuple(made)
        return self._framebuffers[images]

    def _framebuffer(self, images: EyeImages, index: int, layer: int | None) -> int:
        name = _U()
        self._gl["GenFramebuffers"](1, ctypes.byref(name))
        self._gl["BindFramebuffer"](_FRAMEBUFFER, name.value)
        for point, textures in ((_COLOUR, images.colour), (_DEPTH, images.depth)):
            if textures and layer is None:
                self._gl["FramebufferTexture"](_FRAMEBUFFER, point, textures[index], 0)
            elif textures:
                self._gl["FramebufferTextureLayer"](_FRAMEBUFFER, point, textures[index], 0, layer)
        status = self._gl["CheckFramebufferStatus"](_FRAMEBUFFER)
        if status != _COMPLETE:
            self._context.scratch.use()
            self._gl["DeleteFramebuffers"](1, ctypes.byref(name))
            raise ContextError(f"the driver cannot draw into the images of the runtime (status {status:#x})")
        return name.value


def _columns(matrices: NDArray[np.float64]) -> Sequence[tuple[float, ...]]:
    """Return the columns of a mat3[2] in GLSL's order."""
    return [tuple(matrix.T.ravel().tolist()) for matrix in matrices]
