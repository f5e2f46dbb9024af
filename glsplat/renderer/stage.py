"""ItemBuffers: the splats of one item of a scene on the GPU, staged once, and the pass that writes them posed.

A scene without a skeleton stays as it was loaded where it stands alone and unmoved; otherwise place.vert.glsl, or
skin.vert.glsl for an avatar, writes its range of the arena, once a movement and whatever the number of views.
"""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from glsplat.gl.context import Context
from glsplat.renderer.shape_buffers import ShapeBuffers
from glsplat.rotations import is_rigid, rodrigues_parameters, signed_axes
from glsplat.shaders import Programs, SkinVariant, Variant
from glsplat.shaders.slots import UNITS
from glsplat.shaders.variant import COLOUR_TEXELS, ROW_BITS
from glsplat.skinning.shapes import Shapes
from glsplat.skinning.skin import Skin
from glsplat.splats import Splats

__all__ = ["NEAR", "ROW", "ItemBuffers", "Placement", "near_eye", "numbers_of", "upload_rows", "write_rows"]

ROW = 1 << ROW_BITS["330"]
"""Splats a row of the arena's textures (arena.glsl)."""

NEAR = 16.0
"""Metres from the origin within which float32 is left alone."""

_APART = 1000.0
"""Metres from their origin within which items lie at least as exactly as anybody sees: 0.06 mm."""

_POSED = ("posed_mean", "posed_x", "posed_y", "posed_z")


@dataclass(frozen=True, slots=True, eq=False)
class Placement:
    """Where an item stands: x -> size * turn x + offset, and the bones of its pose in its own space."""

    turn: NDArray[np.float64]  # [3, 3] rotation
    offset: NDArray[np.float64]  # [3] metres
    size: float
    bones: NDArray[np.float64] | None = None  # [J, 3, 4] skinning matrices; None: no skeleton
    opacity: float = 1.0  # by which all opacities are multiplied
    weights: NDArray[np.float64] | None = None  # [T] of the avatar's shapes; None: all 0

    @property
    def unmoved(self) -> bool:
        """Whether it leaves everything where it is."""
        return self.size == 1 and not self.offset.any() and np.array_equal(self.turn, np.eye(3))

    @property
    def moved(self) -> bool:
        """Whether things without a skeleton are drawn otherwise than they were loaded."""
        return self.opacity != 1 or not self.unmoved

    def same(self, other: Placement | None) -> bool:
        """Whether the other one puts every splat at the same place."""
        if other is None or (self.size, self.opacity) != (other.size, other.opacity):
            return False
        pairs = [(self.turn, other.turn), (self.offset, other.offset)]
        for mine, theirs in ((self.bones, other.bones), (self.weights, other.weights)):
            if (mine is None) != (theirs is None):
                return False
            if mine is not None and theirs is not None:
                pairs.append((mine, theirs))
        return all(np.array_equal(a, b) for a, b in pairs)


def near_eye(
    origin: NDArray[np.float64], anchors: NDArray[np.float64], eye: NDArray[np.float64]
) -> NDArray[np.float64]:
    """``origin`` [3] where all ``anchors`` [I, 3] are near it, else that of them which is nearest to the eye."""
    if len(anchors) and np.abs(anchors - origin).max() > _APART:
        return np.asarray(anchors[np.linalg.norm(anchors - eye, axis=1).argmin()])
    return origin


class ItemBuffers:
    """Static attributes and skin of one item. Splats that no camera can ever draw are left out and counted."""

    def __init__(
        self,
        context: Context,
        programs: Programs,
        splats: Splats,
        skin: Skin | None,
        joints: int,
        raw: bool,  # skinning by the blended matrix
        shapes: Shapes | None = None,
    ) -> None:
        usable = splats.drawable()
        self.skipped: int = int(len(splats) - usable.sum())
        if self.skipped:
            splats = splats.take(usable)
        self.splats = splats  # on the host: the arena packs colours and cones from it
        self.count: int = len(splats)
        self.skinned: bool = skin is not None
        self._programs = programs
        # Far from the world's origin float32 has no bits left for the splats themselves: move them near zero
        self.centre = np.zeros(3)
        if self.count:
            median = np.median(splats.means[:: max(1, self.count // 65536)].astype(np.float64), axis=0)
            self.centre = median if np.abs(median).max() > NEAR else np.zeros(3)
        self.rest: moderngl.Texture | None = None
        self._shapes: ShapeBuffers | None = None
        self._arrays: dict[SkinVariant | Variant, moderngl.VertexArray] = {}
        ctx = self._ctx = context.ctx
        self._place = Variant(numbered=int(not context.vertex_ids))
        with ExitStack() as stack:  # releases what was made if a later allocation fails
            self._content: list[tuple[object, ...]] = []
            self._buffers: list[moderngl.Buffer] = []  # static, joints, weights
            if skin is None:
                rows = np.zeros((self.count, 12), np.float32)
                self._fill(rows)
                self.rest = upload_rows(ctx, rows, 3, 4, stack)
                if self._place.numbered:
                    self._buffers.append(numbers_of(ctx, self.count))
                    stack.callback(self._buffers[0].release)
                    self._content = [(self._buffers[0], "1u4", "number")]
            else:
                static = np.empty((self.count, 11), np.float32)
                self._fill(static)
                self._skin = SkinVariant(influences=skin.influences, raw=int(raw))
                kept = usable if self.skipped else slice(None)
                parts: list[NDArray[Any]] = [static, skin.joints[kept], skin.weights[kept]]
                for part in parts:
                    self._buffers.append(_buffer(ctx, part))
                    stack.callback(self._buffers[-1].release)
                self._content = _content(self._buffers, skin.influences)
                self.bones = ctx.texture((3, joints), 4, dtype="f4")
                stack.callback(self.bones.release)
                self.bones.filter = (moderngl.NEAREST, moderngl.NEAREST)
                if shapes is not None and len(shapes.targets):
                    self._shapes = ShapeBuffers(ctx, shapes.take(usable) if self.skipped else shapes, stack)
            self._owned = stack.pop_all()

    @property
    def nbytes(self) -> int:
        """GPU bytes without the bone texture."""
        rest = 0 if self.rest is None else self.rest.width * self.rest.height * 16
        shapes = 0 if self._shapes is None else self._shapes.nbytes
        return rest + shapes + sum(buffer.size for buffer in self._buffers)

    def anchor(self, place: Placement) -> NDArray[np.float64]:
        """[3] world position near which all of it lies: its root, or its centre."""
        local = self.centre if place.bones is None else place.bones[0, :, 3]
        return place.size * (place.turn @ local) + place.offset

    def prepare(
        self, place: Placement, origin: NDArray[np.float64], turned: bool, opacity: float
    ) -> moderngl.VertexArray:
        """Set bones and uniforms for a run about ``origin`` (world); returns what to draw with transform feedback."""
        if place.bones is None:
            array = self._array(self._place)
            program = array.program
            program["turn"] = tuple(place.turn.T.ravel())  # columns
            program["rodrigues"] = tuple(rodrigues_parameters(place.turn))
            program["offset"] = tuple(place.size * (place.turn @ self.centre) + place.offset - origin)
            assert self.rest is not None
            self.rest.use(UNITS["splats"])
        else:
            shaped = self._shapes is not None and place.weights is not None
            array = self._array(replace(self._skin, turned=int(turned), shaped=int(shaped)))
            program = array.program
            shift = program.get("shift", None)
            if isinstance(shift, moderngl.Uniform):
                shift.value = 1.0 if is_rigid(place.bones) else 3.0
            self.bones.write(self._local_bones(place, origin).astype(np.float32))
            self.bones.use(UNITS["bones"])
            if self._shapes is not None and place.weights is not None:
                self._shapes.use(place.weights)
        program["size"], program["signed_opacity"] = place.size, opacity
        return array

    def release(self) -> None:
        """Delete all buffers, textures and vertex arrays."""
        for array in self._arrays.values():
            array.release()
        self._arrays.clear()
        self._owned.close()

    def _local_bones(self, place: Placement, origin: NDArray[np.float64]) -> NDArray[np.float64]:
        """The bones from splats about ``centre`` to the scene about ``origin``; the scale stays out of them."""
        assert place.bones is not None
        local = place.bones.copy()
        if not place.unmoved:
            local = place.turn @ local
            local[:, :, 3] += place.offset / place.size
        local[:, :, 3] += local[:, :, :3] @ self.centre
        local[:, :, 3] -= origin / place.size
        return local

    def _array(self, variant: SkinVariant | Variant) -> moderngl.VertexArray:
        if variant not in self._arrays:
            name = "skin" if self.skinned else "place"
            program = self._programs.feedback(name, variant, _POSED)
            content = self._content
            if self._shapes is not None and isinstance(variant, SkinVariant) and variant.shaped:
                content = [*content, self._shapes.content]
            self._arrays[variant] = self._ctx.vertex_array(program, content)
        return self._arrays[variant]

    def _fill(self, rows: NDArray[np.float32]) -> None:
        """[N, 11 or more]: mean about the centre, opacity, quaternion wxyz, scale."""
        rows[:, :3] = self.splats.means - self.centre
        rows[:, 3] = self.splats.opacities
        rows[:, 4:8] = self.splats.quats
        rows[:, 8:11] = self.splats.scales

    def surfaces(self) -> NDArray[np.float32]:
        """[N, 8] as light.glsl reads them: normal in the splat's own axes, occlusion, 1 / shade, nothing."""
        rows = np.zeros((self.count, 8), np.float32)
        surface = self.splats.surface
        if surface is not None:
            rows[:, :3] = surface.in_axes(signed_axes(self.splats.quats, self.splats.scales))
            rows[:, 3] = surface.ao
            rows[:, 4:7] = 1 / surface.shades
        return rows

    def colours(self, degree: int) -> NDArray[np.float32]:
        """[N, floats] coefficients as sh.glsl reads them in a scene of ``degree``, rgb after rgb; higher ones are 0."""
        sh = self.splats.sh
        used = min((degree + 1) ** 2, sh.shape[1])
        flat = sh[:, :used].reshape(len(sh), used * 3)
        wanted = COLOUR_TEXELS[degree] * (4 if degree else 3)
        return np.pad(flat, ((0, 0), (0, wanted - flat.shape[1]))) if flat.shape[1] < wanted else flat


def numbers_of(ctx: moderngl.Context, count: int) -> moderngl.Buffer:
    """0, 1, 2 ... as uint32, for drivers whose gl_VertexID does not count (Context.vertex_ids)."""
    return ctx.buffer(np.arange(max(count, 4), dtype=np.uint32))


def upload_rows(
    ctx: moderngl.Context,
    rows: NDArray[np.float32],  # [N, texels * components]
    texels: int,
    components: int,
    stack: ExitStack,
    height: int = 0,  # rows of the texture, if more than the splats need
) -> moderngl.Texture:
    """A texture of ``texels`` a splat, ROW splats a row; what is left of the last row is zero."""
    texture = ctx.texture((ROW * texels, max(1, height, -(-len(rows) // ROW))), components, dtype="f4")
    stack.callback(texture.release)
    texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
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


def _content(buffers: list[moderngl.Buffer], k: int) -> list[tuple[object, ...]]:
    """Attributes of skin.vert.glsl."""
    static, joints, weights = buffers
    content: list[tuple[object, ...]] = [(static, "4f 4f 3f", "mean_opacity", "quat", "scale")]
    if k == 8:
        return [*content, (joints, "4u2 4u2", "joints0", "joints1"), (weights, "4f 4f", "weights0", "weights1")]
    return [*content, (joints, f"{k}u2", "joints0"), (weights, f"{k}f", "weights0")]


def _buffer(ctx: moderngl.Context, array: NDArray[np.generic]) -> moderngl.Buffer:
    # OpenGL has no empty buffers; a scene of no splats keeps one byte it never reads
    return ctx.buffer(np.ascontiguousarray(array)) if array.size else ctx.buffer(reserve=16)
