"""MeshPass: a scene's opaque meshes, drawn before the splats: their colours, and what the splats are tested against.

The views of a frame have a target each and are drawn in turn: a layered depth buffer is beyond what moderngl can
attach, and in one target the second view's coordinates would round otherwise than those of a render of its own. Bones
are written once. The background pass copies colours to the layers; the draw pass tests splats against z.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from typing import Any, NamedTuple

import moderngl
import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera
from glsplat.config import RenderConfig
from glsplat.gl.context import Context
from glsplat.meshes import RiggedMesh
from glsplat.renderer.frame_block import FrameBlock
from glsplat.renderer.mesh_buffers import INFLUENCES, MeshBuffers
from glsplat.renderer.reach import depth_range, fitted, reach_of
from glsplat.renderer.skin import Placement, near_eye
from glsplat.shaders import MeshVariant, Programs
from glsplat.shaders.slots import UNITS
from glsplat.skinning.skin import Skin

__all__ = ["MeshItem", "MeshPass", "MeshPassKind"]

_NOWHERE = 3e38  # camera z where no mesh is: behind every splat
_LINEAR, _LOGARITHMIC = (MeshVariant(influences=INFLUENCES, logarithmic=n) for n in (0, 1))
_RANGE = 1000.0  # of far to near, up to which 24 bits of 1 / z are a 17,000th of z or finer
_SAMPLED = "f1"  # textures have no more, and four floats a sample would be 16 bytes to clear, blend and average


class MeshItem:
    """The buffers of one mesh of a scene, and where it is."""

    def __init__(self, context: Context, mesh: RiggedMesh, anisotropy: float) -> None:
        skin = Skin.create(mesh.joints, mesh.weights, len(mesh.skeleton), INFLUENCES)
        self._joints, self._reach = mesh.skeleton.joints, reach_of(mesh, skin)
        self._bones = np.zeros((len(mesh.skeleton), 3, 4))
        self.buffers: MeshBuffers = MeshBuffers(context.ctx, mesh, skin, min(anisotropy, context.ctx.max_anisotropy))
        self._arrays: dict[MeshVariant, moderngl.VertexArray] = {}

    def place(self, place: Placement, origin: NDArray[np.float64]) -> None:
        """Write the bones, about ``origin`` (world)."""
        assert place.bones is not None
        self._bones = place.size * (place.turn @ place.bones)
        self._bones[:, :, 3] += place.offset - origin
        self.buffers.bones.write(self._bones.astype(np.float32))

    def depths(self, camera: Camera, origin: NDArray[np.float64]) -> tuple[float, float]:
        """Least and largest camera z that it may have, metres."""
        return depth_range(camera, self._joints, self._reach, self._bones, origin)

    def draw(self, ctx: moderngl.Context, programs: Programs, variant: MeshVariant, samples: int) -> None:
        """All parts into the bound framebuffer, of so many samples."""
        if variant not in self._arrays:
            program = programs.draw("ground", "ground", variant)
            self._arrays[variant] = ctx.vertex_array(program, [self.buffers.content], index_buffer=self.buffers.faces)
        self.buffers.draw(ctx, self._arrays[variant], samples)

    def release(self) -> None:
        """Delete buffers, textures and vertex arrays."""
        for array in self._arrays.values():
            array.release()
        self._arrays.clear()
        self.buffers.release()


class MeshPassKind(NamedTuple):
    """What of the meshes a frame needs; neither ``samples`` above 1 nor ``centres``: nothing."""

    centres: bool  # colour and z at the pixel centres: what splats are tested against, and all there is of one sample
    samples: int  # above 1: colour by so many samples a pixel
    depth: bool  # without centres: z as well, its mean over the pixel times coverage


class MeshPass:
    """The targets of one size and number of views, and what was drawn into them last."""

    def __init__(
        self, context: Context, programs: Programs, size: tuple[int, int], views: int, kind: MeshPassKind, dtype: str
    ) -> None:
        ctx = context.ctx
        self._ctx, self._programs, self._kind = ctx, programs, kind
        self._drawn: object = None
        self._centres: list[_Centres] = []
        self._samples: _Samples | None = None
        self._frames: list[FrameBlock] = []
        with ExitStack() as stack:  # releases what was made if a later allocation fails
            for _ in range(views):
                self._frames.append(FrameBlock(ctx, 1))
                stack.callback(self._frames[-1].release)
                if kind.centres:
                    self._centres.append(_Centres(ctx, size, dtype, stack))
            if kind.samples > 1:
                self._samples = _Samples(ctx, size, views, kind, stack)
            self._owned = stack.pop_all()

    @property
    def nbytes(self) -> int:
        """GPU bytes of all targets."""
        return sum(centres.nbytes for centres in self._centres) + (self._samples.nbytes if self._samples else 0)

    def run(self, cameras: Sequence[Camera], items: Sequence[tuple[MeshItem, Placement]], state: object) -> None:
        """Draw the meshes for these views; nothing where ``state`` is what it was."""
        if state == self._drawn:
            return
        self._drawn = None
        anchors = np.array([place.anchor() for _, place in items])
        origin = near_eye(anchors[0], anchors, cameras[0].position)  # float32 has no bits left far from zero
        for item, place in items:
            item.place(place, origin)
        self._ctx.enable_only(moderngl.DEPTH_TEST)
        try:
            for view, camera in enumerate(cameras):
                self._draw(view, camera, [item for item, _ in items], origin)
        finally:
            self._ctx.enable_only(moderngl.NOTHING)
        self._drawn = state

    def _draw(self, view: int, camera: Camera, items: Sequence[MeshItem], origin: NDArray[np.float64]) -> None:
        if self._centres:
            self._frames[view].write([camera], camera.viewmat, origin, _NO_SPLATS)
            self._centres[view].begin()
            for item in items:
                item.draw(self._ctx, self._programs, _LOGARITHMIC, 1)
        if self._samples is not None:
            depths = [item.depths(camera, origin) for item in items]
            near = fitted(camera, min(least for least, _ in depths), max(largest for _, largest in depths))
            fine = near.far <= _RANGE * near.near
            self._frames[view].write([near if fine else camera], camera.viewmat, origin, _NO_SPLATS)
            self._samples.begin()
            for item in items:
                item.draw(self._ctx, self._programs, _LINEAR if fine else _LOGARITHMIC, self._kind.samples)
            self._samples.resolve(self._ctx, view)

    def use(self) -> None:
        """Bind what was drawn for the background and draw passes."""
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
    """Of one view: colour and camera z at the pixel centres."""

    def __init__(self, ctx: moderngl.Context, size: tuple[int, int], dtype: str, stack: ExitStack) -> None:
        self.colour = _texture(ctx, size, 4, dtype, stack)
        self.z = _texture(ctx, size, 1, "f4", stack)
        depth = _own(stack, ctx.depth_renderbuffer(size))
        # two framebuffers: clear() gives every colour attachment the same value
        self._both = _own(stack, ctx.framebuffer([self.colour, self.z], depth))
        self._far = _own(stack, ctx.framebuffer([self.z]))
        self.nbytes: int = size[0] * size[1] * (_BYTES[dtype] + 4 + 4)

    def begin(self) -> None:
        """Empty it and bind it."""
        self._both.clear(0.0, 0.0, 0.0, 0.0, depth=1.0)
        self._far.clear(_NOWHERE, 0.0, 0.0, 0.0)
        self._both.use()


class _Samples:
    """Samples of one view at a time, and their means for each."""

    def __init__(
        self, ctx: moderngl.Context, size: tuple[int, int], views: int, kind: MeshPassKind, stack: ExitStack
    ) -> None:
        formats = [(4, _SAMPLED)] + ([(1, "f4")] if kind.depth and not kind.centres else [])
        drawn = [_own(stack, ctx.renderbuffer(size, n, samples=kind.samples, dtype=dtype)) for n, dtype in formats]
        depth = _own(stack, ctx.depth_renderbuffer(size, samples=kind.samples))
        self._drawn = _own(stack, ctx.framebuffer(drawn, depth))
        self.averaged: list[list[moderngl.Texture]] = []
        self._into: list[moderngl.Framebuffer] = []
        for _ in range(views):
            self.averaged.append([_texture(ctx, size, n, dtype, stack) for n, dtype in formats])
            self._into.append(_own(stack, ctx.framebuffer(self.averaged[-1])))
        pixel = sum(_BYTES[dtype] * n // 4 for n, dtype in formats)
        self.nbytes: int = size[0] * size[1] * (pixel * views + (pixel + 4) * kind.samples)

    def begin(self) -> None:
        """Empty it and bind it."""
        self._drawn.clear(0.0, 0.0, 0.0, 0.0, depth=1.0)
        self._drawn.use()

    def resolve(self, ctx: moderngl.Context, view: int) -> None:
        """Keep the means of what was drawn."""
        ctx.copy_framebuffer(self._into[view], self._drawn)


_NO_SPLATS = RenderConfig()  # the frame block has room for what only splats need
_BYTES = {"f1": 4, "f2": 8, "f4": 16}  # of four components
_ENDINGS = ("", "_2")  # of the samplers of each view (ground.glsl)


def _own(stack: ExitStack, item: Any) -> Any:
    stack.callback(item.release)
    return item


def _texture(
    ctx: moderngl.Context, size: tuple[int, int], components: int, dtype: str, stack: ExitStack
) -> moderngl.Texture:
    texture: moderngl.Texture = _own(stack, ctx.texture(size, components, dtype=dtype))
    texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
    return texture
