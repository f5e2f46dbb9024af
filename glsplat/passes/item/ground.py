"""Ground: the meshes of a scene, opaque, drawn before the splats: colour and camera z of each pixel centre.

All views lie in one plain target, one below the other, and are drawn at once: layers would need a layered depth buffer,
which moderngl cannot attach. The background pass copies colours to the layers; the draw pass tests splats against z.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack

import moderngl
import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera
from glsplat.config import RenderConfig
from glsplat.errors import ContextError
from glsplat.gl.context import Context
from glsplat.meshes import RiggedMesh
from glsplat.passes.block import FrameBlock
from glsplat.passes.item.buffers import Placement
from glsplat.passes.item.mesh_buffers import INFLUENCES, MeshBuffers
from glsplat.shaders import MeshVariant, Programs
from glsplat.shaders.slots import UNITS
from glsplat.skinning.skin import Skin

__all__ = ["Ground", "MeshItem"]

_CLIP_DISTANCES = (0x3000, 0x3001)  # GL_CLIP_DISTANCE0 and 1; moderngl has no names for them
_NOWHERE = 3e38  # camera z where no mesh is: behind every splat


class MeshItem:
    """The buffers of one mesh of a scene."""

    def __init__(self, context: Context, mesh: RiggedMesh) -> None:
        skin = Skin.create(mesh.joints, mesh.weights, len(mesh.skeleton), INFLUENCES)
        self.buffers = MeshBuffers(context.ctx, mesh, skin, context.ctx.max_anisotropy)
        self._arrays: dict[MeshVariant, moderngl.VertexArray] = {}

    def anchor(self, place: Placement) -> NDArray[np.float64]:
        """[3] world position near which it lies."""
        assert place.bones is not None
        return place.size * (place.turn @ place.bones[0, :, 3]) + place.offset

    def draw(
        self,
        ctx: moderngl.Context,
        programs: Programs,
        variant: MeshVariant,
        place: Placement,
        origin: NDArray[np.float64],
    ) -> None:
        """All parts into the bound framebuffer, about ``origin`` (world)."""
        assert place.bones is not None
        bones = place.size * (place.turn @ place.bones)
        bones[:, :, 3] += place.offset - origin
        self.buffers.bones.write(bones.astype(np.float32))
        self.buffers.bones.use(UNITS["bones"])
        if variant not in self._arrays:
            program = programs.draw("ground", "ground", variant)
            self._arrays[variant] = ctx.vertex_array(program, [self.buffers.content], index_buffer=self.buffers.faces)
        array = self._arrays[variant]
        parts = zip(self.buffers.ranges, self.buffers.textures, self.buffers.cutouts, strict=True)
        for (first, count), texture, cutout in parts:
            texture.use(UNITS["skin_texture"])
            array.program["lowest"] = 0.5 if cutout else 0.0
            array.render(moderngl.TRIANGLES, vertices=count, first=first, instances=variant.views)

    def release(self) -> None:
        """Delete buffers, textures and vertex arrays."""
        for array in self._arrays.values():
            array.release()
        self._arrays.clear()
        self.buffers.release()


class Ground:
    """The target of one size and number of views, and what was drawn into it last."""

    def __init__(self, context: Context, programs: Programs, size: tuple[int, int], views: int, dtype: str) -> None:
        width, height = size[0], size[1] * views
        if height > context.max_size:
            raise ContextError(
                f"{views} views of {size[0]}x{size[1]} pixels with meshes need {height} rows, "
                f"{context.driver} has {context.max_size}; use a smaller size"
            )
        ctx = context.ctx
        self._ctx, self._programs, self._variant = ctx, programs, MeshVariant(influences=INFLUENCES, views=views)
        self._drawn: object = None
        with ExitStack() as stack:
            self._frame = FrameBlock(ctx, views)
            stack.callback(self._frame.release)
            self.colour = ctx.texture((width, height), 4, dtype=dtype)
            stack.callback(self.colour.release)
            self.z = ctx.texture((width, height), 1, dtype="f4")
            stack.callback(self.z.release)
            self.z.filter = self.colour.filter = (moderngl.NEAREST, moderngl.NEAREST)
            depth = ctx.depth_renderbuffer((width, height))
            stack.callback(depth.release)
            # two framebuffers: clear() gives every colour attachment the same value
            self._both = ctx.framebuffer([self.colour, self.z], depth)
            stack.callback(self._both.release)
            self._far = ctx.framebuffer([self.z])
            stack.callback(self._far.release)
            self._owned = stack.pop_all()

    @property
    def nbytes(self) -> int:
        """GPU bytes of colour, z and depth buffer."""
        return self.z.width * self.z.height * (4 + 4 + {"f1": 4, "f2": 8, "f4": 16}[self.colour.dtype])

    def run(self, cameras: Sequence[Camera], items: Sequence[tuple[MeshItem, Placement]], state: object) -> None:
        """Draw the meshes for these views; nothing where ``state`` is what it was."""
        if state == self._drawn:
            return
        self._drawn = None
        origin = items[0][0].anchor(items[0][1])  # float32 has no bits left far from zero
        self._frame.write(cameras, cameras[0].viewmat, origin, _NO_SPLATS)
        self._both.clear(0.0, 0.0, 0.0, 0.0, depth=1.0)
        self._far.clear(_NOWHERE, 0.0, 0.0, 0.0)
        self._both.use()
        self._ctx.enable_only(moderngl.DEPTH_TEST)
        for plane in _CLIP_DISTANCES:
            self._ctx.enable_direct(plane)
        try:
            for item, place in items:
                item.draw(self._ctx, self._programs, self._variant, place, origin)
        finally:
            for plane in _CLIP_DISTANCES:
                self._ctx.disable_direct(plane)
            self._ctx.enable_only(moderngl.NOTHING)
        self._drawn = state

    def use(self) -> None:
        """Bind colour and z for the background and draw passes."""
        self.colour.use(UNITS["mesh_colour"])
        self.z.use(UNITS["mesh_z"])

    def release(self) -> None:
        """Delete the target."""
        self._owned.close()


_NO_SPLATS = RenderConfig()  # the frame block has room for what only splats need
