"""MeshPass: draw a scene's meshes before the splats: their colours, and the z that splats are tested against.

The views of a frame have a target each and are drawn in turn: moderngl cannot attach a layered depth buffer, and in one
target the coordinates of the second view would round differently from those of its own render. Bones are written once.
The background pass copies colours to the layers; the draw pass tests splats against z.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from typing import NamedTuple

import moderngl
import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera
from glsplat.config import RenderConfig
from glsplat.gl.context import Context
from glsplat.renderer.bounds import covered_pixels
from glsplat.renderer.frame_block import FrameBlock
from glsplat.renderer.mesh_buffers import INFLUENCES, MeshBuffers, fitted
from glsplat.renderer.owned import data_texture, owned
from glsplat.renderer.skin import Placement, near_eye
from glsplat.renderer.stats import Box
from glsplat.shaders import MeshVariant, Programs
from glsplat.shaders.slots import UNITS

_NO_MESH_Z = 3e38  # camera z where no mesh is: behind every splat
_LINEAR, _LOGARITHMIC = (MeshVariant(influences=INFLUENCES, logarithmic=n) for n in (0, 1))
_LINEAR_RANGE = 1000.0  # far / near up to which 24 bits of 1 / z resolve z to a 17,000th
_SAMPLE_DTYPE = "f1"  # as textures; floats would be 16 bytes a sample to clear, blend and average


class MeshPassKind(NamedTuple):
    """The pictures of its meshes that a frame needs."""

    centres: bool  # colour and z at the pixel centres; splats are tested against this z
    samples: int  # a pixel, for the colour; 1: the centres alone
    depth: bool  # without centres: also the mean z of a pixel, times coverage


class MeshPass:
    """Owns the targets of one size and number of views; keeps its pictures while nothing moves."""

    def __init__(
        self, context: Context, programs: Programs, size: tuple[int, int], views: int, kind: MeshPassKind, dtype: str
    ) -> None:
        ctx = context.ctx
        self._ctx, self._programs, self._kind = ctx, programs, kind
        self._drawn: object = None
        self.covered: Box = (0, 0, 0, 0)  # holds all pixels of the meshes
        self._centres: list[_Centres] = []
        self._samples: _Samples | None = None
        self._frames: list[FrameBlock] = []
        with ExitStack() as stack:  # releases everything if an allocation fails
            for _ in range(views):
                self._frames.append(owned(stack, FrameBlock(ctx, 1)))
                if kind.centres:
                    self._centres.append(_Centres(ctx, size, dtype, stack))
            if kind.samples > 1:
                self._samples = _Samples(ctx, size, views, kind, stack)
            self._owned = stack.pop_all()

    @property
    def nbytes(self) -> int:
        """GPU bytes of all targets."""
        return sum(centres.nbytes for centres in self._centres) + (self._samples.nbytes if self._samples else 0)

    def run(self, cameras: Sequence[Camera], items: Sequence[tuple[MeshBuffers, Placement]], state: object) -> None:
        """Draw the meshes for these views, unless ``state`` is that of the last call."""
        if state == self._drawn:
            return
        self._drawn = None
        bounds = (item.bounds.posed(at.transform, at.bones) for item, at in items)
        self.covered = covered_pixels(cameras, bounds, _NO_SPLATS)
        anchors = np.array([placement.anchor() for _, placement in items])
        origin = near_eye(anchors[0], anchors, cameras[0].position)  # float32 has no bits left far from zero
        for item, placement in items:
            item.place(placement, origin)
        self._ctx.enable_only(moderngl.DEPTH_TEST)
        try:
            for view, camera in enumerate(cameras):
                self._draw(view, camera, [item for item, _ in items], origin)
        finally:
            self._ctx.disable(moderngl.DEPTH_TEST)
        self._drawn = state

    def _draw(self, view: int, camera: Camera, items: Sequence[MeshBuffers], origin: NDArray[np.float64]) -> None:
        if self._centres:
            self._frames[view].write([camera], camera.viewmat, origin, _NO_SPLATS)
            self._centres[view].begin()
            for item in items:
                item.draw(self._programs, _LOGARITHMIC, 1)
        if self._samples is not None:
            depths = [item.depths(camera, origin) for item in items]
            near = fitted(camera, min(least for least, _ in depths), max(largest for _, largest in depths))
            fine = near.far <= _LINEAR_RANGE * near.near
            self._frames[view].write([near if fine else camera], camera.viewmat, origin, _NO_SPLATS)
            self._samples.begin()
            for item in items:
                item.draw(self._programs, _LINEAR if fine else _LOGARITHMIC, self._kind.samples)
            self._samples.resolve(self._ctx, view)

    def use(self) -> None:
        """Bind the targets for the background and draw passes."""
        for ending, centres in zip(_ENDINGS, self._centres, strict=False):
            centres.colour.use(UNITS["mesh_colour" + ending])
            centres.z.use(UNITS["mesh_z" + ending])
        if self._samples is not None:
            for ending, averaged in zip(_ENDINGS, self._samples.averaged, strict=False):
                averaged[0].use(UNITS["mesh_samples" + ending])
                for z in averaged[1:]:
                    z.use(UNITS["mesh_z" + ending])

    def release(self) -> None:
        """Delete the targets."""
        self._owned.close()


class _Centres:
    """Colour and camera z at the pixel centres of one view."""

    def __init__(self, ctx: moderngl.Context, size: tuple[int, int], dtype: str, stack: ExitStack) -> None:
        self.colour = data_texture(stack, ctx, size, 4, dtype=dtype)
        self.z = data_texture(stack, ctx, size, 1)
        depth = owned(stack, ctx.depth_renderbuffer(size))
        # two framebuffers: clear() gives every colour attachment the same value
        self._both = owned(stack, ctx.framebuffer([self.colour, self.z], depth))
        self._far = owned(stack, ctx.framebuffer([self.z]))
        self.nbytes: int = size[0] * size[1] * (_BYTES[dtype] + 4 + 4)

    def begin(self) -> None:
        """Clear and bind the framebuffer."""
        self._both.clear(0.0, 0.0, 0.0, 0.0, depth=1.0)
        self._far.clear(_NO_MESH_Z, 0.0, 0.0, 0.0)
        self._both.use()


class _Samples:
    """Samples of one view at a time, and their means for each view."""

    def __init__(
        self, ctx: moderngl.Context, size: tuple[int, int], views: int, kind: MeshPassKind, stack: ExitStack
    ) -> None:
        formats = [(4, _SAMPLE_DTYPE)] + ([(1, "f4")] if kind.depth and not kind.centres else [])
        drawn = [owned(stack, ctx.renderbuffer(size, n, samples=kind.samples, dtype=dtype)) for n, dtype in formats]
        depth = owned(stack, ctx.depth_renderbuffer(size, samples=kind.samples))
        self._drawn = owned(stack, ctx.framebuffer(drawn, depth))
        self.averaged: list[list[moderngl.Texture]] = []
        self._into: list[moderngl.Framebuffer] = []
        for _ in range(views):
            self.averaged.append([data_texture(stack, ctx, size, n, dtype=dtype) for n, dtype in formats])
            self._into.append(owned(stack, ctx.framebuffer(self.averaged[-1])))
        pixel = sum(_BYTES[dtype] * n // 4 for n, dtype in formats)
        self.nbytes: int = size[0] * size[1] * (pixel * views + (pixel + 4) * kind.samples)

    def begin(self) -> None:
        """Clear and bind the framebuffer."""
        self._drawn.clear(0.0, 0.0, 0.0, 0.0, depth=1.0)
        self._drawn.use()

    def resolve(self, ctx: moderngl.Context, view: int) -> None:
        """Average the samples into the textures of ``view``."""
        ctx.copy_framebuffer(self._into[view], self._drawn)


_NO_SPLATS = RenderConfig()  # for the fields of the frame block that meshes do not read
_BYTES = {"f1": 4, "f2": 8, "f4": 16}  # of four components
_ENDINGS = ("", "_2")  # of the samplers of each view (mesh_layer.glsl)
