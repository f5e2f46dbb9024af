"""Stage: upload the splats of an item, once for each level of detail that is drawn.

Splats without a skeleton go into a texture. A single unmoved item is drawn from it directly; the skin pass (skin.py)
writes all others posed into the arena.
"""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from glsplat.errors import ContextError
from glsplat.gl.context import Context
from glsplat.renderer.bounds import Bounds
from glsplat.renderer.owned import OwnsObjects, data_texture, owned
from glsplat.rotations import signed_axes
from glsplat.shaders import Programs, SkinVariant, Variant
from glsplat.shaders.slots import UNITS
from glsplat.shaders.variant import COLOUR_TEXELS, ROW_BITS
from glsplat.skinning.shapes import Shapes
from glsplat.skinning.skin import Skin
from glsplat.splats import Splats

ROW = 1 << ROW_BITS["330"]
"""Splats per row of the arena's textures (arena.glsl)."""

NEAR_M = 16.0
"""Metres from the origin up to which float32 coordinates need no offset."""

_ENTRIES_PER_ROW = 1024  # of the texture of shapes (shapes.glsl)
_SMALLEST = 16  # bytes: OpenGL has no empty buffers

_POSED = ("posed_mean", "posed_x", "posed_y", "posed_z")


class ItemBuffers(OwnsObjects):
    """Splats and skin of one item at one level of detail. Splats that no camera can draw are left out and counted."""

    def __init__(
        self,
        context: Context,
        programs: Programs,
        splats: Splats,
        skin: Skin | None = None,
        joints: int = 0,
        raw: bool = False,  # skin by the blended matrix instead of its nearest rotation
        shapes: Shapes | None = None,
    ) -> None:
        usable = splats.drawable()
        self.skipped: int = int(len(splats) - usable.sum())
        if self.skipped:
            splats = splats.take(usable)
        self.splats = splats  # on the host: the arena packs colours and cones from it
        self.count: int = len(splats)
        self._ctx, self._programs = context.ctx, programs
        self._skin = skin if skin is None or not self.skipped else skin.take(usable)
        self._shapes = shapes if shapes is None or not self.skipped else shapes.take(usable)
        self._joints = max(joints, 1)
        self._bounds: Bounds | None = None  # measured when they are first needed
        self.centre = np.zeros(3)  # metres; means are uploaded about it, as float32 is too coarse far from zero
        if self.count:
            median = np.median(splats.means[:: max(1, self.count // 65536)].astype(np.float64), axis=0)
            self.centre = median if np.abs(median).max() > NEAR_M else np.zeros(3)
        self.rest: moderngl.Texture | None = None  # without a skeleton
        self.shapes: ShapeBuffers | None = None
        self.variant: SkinVariant | Variant = Variant(numbered=int(not context.vertex_ids))
        self._arrays: dict[SkinVariant | Variant, moderngl.VertexArray] = {}
        self._buffers: list[moderngl.Buffer] = []
        self._content: list[tuple[object, ...]] = []
        with ExitStack() as stack:  # releases everything if an allocation fails
            if skin is None:
                self.rest = upload_rows(context.ctx, self._static(12), 3, 4, stack)
                if not context.vertex_ids:
                    self._buffers.append(owned(stack, numbers_of(context.ctx, self.count)))
                    self._content = [(self._buffers[0], "1u4", "number")]
            else:
                assert self._skin is not None
                self.variant = SkinVariant(influences=skin.influences, raw=int(raw))
                arrays: list[NDArray[Any]] = [self._static(11), self._skin.joints, self._skin.weights]
                for array in arrays:
                    content = np.ascontiguousarray(array) if array.size else bytes(_SMALLEST)
                    self._buffers.append(owned(stack, context.ctx.buffer(content)))
                self._content = _attributes(self._buffers, skin.influences)
                self.bones = data_texture(stack, context.ctx, (3, joints), 4)
                if self._shapes is not None and len(self._shapes.targets):
                    self.shapes = ShapeBuffers(context.ctx, self._shapes, stack)
            self._owned = stack.pop_all()

    @property
    def nbytes(self) -> int:
        """GPU bytes without the bone texture."""
        rest = 0 if self.rest is None else self.rest.width * self.rest.height * 16
        shapes = 0 if self.shapes is None else self.shapes.nbytes
        return rest + shapes + sum(buffer.size for buffer in self._buffers)

    def array(self, variant: SkinVariant | Variant) -> moderngl.VertexArray:
        """Return the vertex array of the splats for the program of ``variant``, a form of ``self.variant``."""
        if variant not in self._arrays:
            skinned = isinstance(variant, SkinVariant)
            program = self._programs.feedback("skin" if skinned else "place", variant, _POSED)
            shaped = self.shapes is not None and isinstance(variant, SkinVariant) and variant.shaped
            content = [*self._content, self.shapes.content] if shaped and self.shapes else self._content
            self._arrays[variant] = owned(self._owned, self._ctx.vertex_array(program, content))
        return self._arrays[variant]

    def bounds(self, max_sigma: float) -> Bounds:
        """Return the extents of the splats, up to ``max_sigma`` standard deviations; the same in every call."""
        if self._bounds is None:
            self._bounds = Bounds.of_splats(self.splats, max_sigma, self._skin, self._joints, self._shapes)
        return self._bounds

    def colours(self, degree: int) -> NDArray[np.float32]:
        """Return SH coefficients [N, floats] as sh.glsl reads them at ``degree``; missing ones are 0."""
        sh = self.splats.sh
        used = min((degree + 1) ** 2, sh.shape[1])
        flat = sh[:, :used].reshape(len(sh), used * 3)
        wanted = COLOUR_TEXELS[degree] * (4 if degree else 3)
        return np.pad(flat, ((0, 0), (0, wanted - flat.shape[1]))) if flat.shape[1] < wanted else flat

    def surfaces(self) -> NDArray[np.float32]:
        """Return [N, 8] as light.glsl reads them: normal in the splat's own axes, occlusion, 1 / shade, 0."""
        rows = np.zeros((self.count, 8), np.float32)
        surface = self.splats.surface
        if surface is not None:
            rows[:, :3] = surface.in_axes(signed_axes(self.splats.quats, self.splats.scales))
            rows[:, 3] = surface.ao
            rows[:, 4:7] = 1 / surface.shades
        return rows

    def _static(self, floats: int) -> NDArray[np.float32]:
        """Return [N, floats]: mean about the centre, opacity, quaternion wxyz, scale, padding."""
        rows = np.zeros((self.count, floats), np.float32)
        rows[:, :3] = self.splats.means - self.centre
        rows[:, 3] = self.splats.opacities
        rows[:, 4:8] = self.splats.quats
        rows[:, 8:11] = self.splats.scales
        return rows


class ShapeBuffers:
    """The shapes of an avatar: entries, each splat's range of them, and a texture of weights. ``stack`` owns them."""

    def __init__(self, ctx: moderngl.Context, shapes: Shapes, stack: ExitStack) -> None:
        entries = shapes.texels()
        height = -(-len(entries) // _ENTRIES_PER_ROW)
        limit = int(ctx.info["GL_MAX_TEXTURE_SIZE"])
        if height > limit:
            most = limit * _ENTRIES_PER_ROW
            raise ContextError(f"{len(entries)} entries of shapes, but this driver's textures hold {most}")
        padded = np.zeros((height * _ENTRIES_PER_ROW, 4), np.uint32)
        padded[: len(entries)] = entries
        self._shapes = shapes
        self._entries = data_texture(stack, ctx, (_ENTRIES_PER_ROW, height), 4, padded, "u4")
        self._amounts = data_texture(stack, ctx, (len(shapes), 1), 2)
        ranges = np.stack([shapes.starts[:-1], shapes.starts[1:]], axis=1).astype(np.uint32)
        self._ranges: moderngl.Buffer = owned(stack, ctx.buffer(ranges))

    @property
    def nbytes(self) -> int:
        """GPU bytes."""
        return _ENTRIES_PER_ROW * self._entries.height * 16 + self._amounts.width * 8 + self._ranges.size

    @property
    def content(self) -> tuple[object, ...]:
        """The attribute of shapes.glsl."""
        return (self._ranges, "2u4", "range")

    def use(self, weights: NDArray[np.float64]) -> None:
        """Write the weights [T] and bind the textures."""
        self._amounts.write(self._shapes.amounts(weights))
        self._entries.use(UNITS["entries"])
        self._amounts.use(UNITS["amounts"])


def rows_of(count: int) -> int:
    """Return the rows that ``count`` splats take in the arena's textures, at least one."""
    return max(1, -(-count // ROW))


def numbers_of(ctx: moderngl.Context, count: int) -> moderngl.Buffer:
    """Return a buffer of 0, 1, 2 ... as uint32, for drivers whose gl_VertexID does not count (Context.vertex_ids)."""
    return ctx.buffer(np.arange(max(count, 4), dtype=np.uint32))


def upload_rows(
    ctx: moderngl.Context,
    rows: NDArray[np.float32],  # [N, texels * components]
    texels: int,
    components: int,
    stack: ExitStack,
    height: int = 0,  # rows of the texture, if more than the splats need
) -> moderngl.Texture:
    """Return a texture of ``texels`` a splat, ROW splats a row; the rest of the last row is zero."""
    texture = data_texture(stack, ctx, (ROW * texels, max(height, rows_of(len(rows)))), components)
    write_rows(texture, 0, rows, texels, components)
    return texture


def write_rows(texture: moderngl.Texture, first: int, rows: NDArray[np.float32], texels: int, components: int) -> None:
    """Write splats from row ``first`` of a texture on, and zeros to the end of their last row."""
    whole = len(rows) // ROW
    if whole:
        texture.write(np.ascontiguousarray(rows[: whole * ROW]), (0, first, ROW * texels, whole))
    rest = len(rows) - whole * ROW
    if rest or not len(rows):
        padded = np.zeros((ROW, texels * components), np.float32)
        padded[:rest] = rows[whole * ROW :]
        texture.write(padded, (0, first + whole, ROW * texels, 1))


def _attributes(buffers: list[moderngl.Buffer], influences: int) -> list[tuple[object, ...]]:
    """Return the buffers as attributes of skin.vert.glsl."""
    static, joints, weights = buffers
    content: list[tuple[object, ...]] = [(static, "4f 4f 3f", "mean_opacity", "quat", "scale")]
    if influences == 8:
        return [*content, (joints, "4u2 4u2", "joints0", "joints1"), (weights, "4f 4f", "weights0", "weights1")]
    return [*content, (joints, f"{influences}u2", "joints0"), (weights, f"{influences}f", "weights0")]
