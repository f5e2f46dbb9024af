"""Skin: write an item's splats into the arena, posed and placed, by transform feedback.

skin.vert.glsl blends an avatar's bones; place.vert.glsl moves splats without a skeleton. An item is written once
per movement, for any number of views.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import moderngl
import numpy as np
from numpy.typing import NDArray

from glsplat.gl.context import Context
from glsplat.renderer.stage import ROW, ItemBuffers, rows_of
from glsplat.rotations import is_rigid, rodrigues_parameters
from glsplat.shaders import SkinVariant, set_uniforms
from glsplat.shaders.slots import UNITS

_BATCH_ROWS = 64  # rows written at a time; limits the scratch buffer to 4 MB
_POSED_BYTES = 64  # a splat

_FAR_M = 1000.0
"""Metres from the common origin up to which float32 positions are exact enough: to 0.06 mm."""


@dataclass(frozen=True, slots=True, eq=False)
class Placement:
    """Transform of an item, x -> size * turn x + offset, and the bones of its pose in its own space."""

    transform: NDArray[np.float64]  # [4, 4] scene from item
    bones: NDArray[np.float64] | None = None  # [J, 3, 4] skinning matrices; None: no skeleton
    opacity: float = 1.0  # factor of all opacities
    weights: NDArray[np.float64] | None = None  # [T] of the avatar's shapes; None: all 0
    unmoved: bool = field(init=False)  # the item stands where it was loaded
    size: float = field(init=False)

    def __post_init__(self) -> None:
        unmoved = np.array_equal(self.transform, np.eye(4))
        object.__setattr__(self, "unmoved", unmoved)
        object.__setattr__(self, "size", 1.0 if unmoved else float(np.cbrt(np.linalg.det(self.transform[:3, :3]))))

    @property
    def turn(self) -> NDArray[np.float64]:
        """Rotation [3, 3]."""
        return self.transform[:3, :3] / self.size

    @property
    def offset(self) -> NDArray[np.float64]:
        """Translation [3] in metres."""
        return self.transform[:3, 3]

    @property
    def moved(self) -> bool:
        """Whether splats without a skeleton differ from the loaded ones."""
        return self.opacity != 1 or not self.unmoved

    def same(self, other: Placement | None) -> bool:
        """Return whether the other placement puts every splat at the same position."""
        names = ("transform", "bones", "opacity", "weights")
        return other is not None and all(np.array_equal(getattr(self, n), getattr(other, n)) for n in names)

    def anchor(self, centre: NDArray[np.float64] | None = None) -> NDArray[np.float64]:
        """Return a scene position [3] near the item: its root joint, or its ``centre`` [3]."""
        local = centre if self.bones is None else self.bones[0, :, 3]
        assert local is not None
        return self.size * (self.turn @ local) + self.offset

    def local_bones(self, centre: NDArray[np.float64], origin: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return bones from splats about ``centre`` to the scene about ``origin``, both [3], without the scale."""
        assert self.bones is not None
        local = self.bones.copy()
        if not self.unmoved:
            local = self.turn @ local
            local[:, :, 3] += self.offset / self.size
        local[:, :, 3] += local[:, :, :3] @ centre
        local[:, :, 3] -= origin / self.size
        return local


class SkinPass:
    """Writes items into rows of a texture, by way of a scratch buffer that it owns."""

    def __init__(self, context: Context, rows: int) -> None:
        self._framebuffer = context.scratch
        self.scratch: moderngl.Buffer = context.ctx.buffer(reserve=min(_BATCH_ROWS, max(1, rows)) * ROW * _POSED_BYTES)

    def run(
        self,
        item: ItemBuffers,
        placement: Placement,
        into: moderngl.Texture,
        first_row: int,
        origin: NDArray[np.float64],  # [3] world position of the scene's zero
        *,
        turned: bool,  # SH colours turn with the splats
        opacity: float,  # factor; negative marks splats that ask for opacity compensation
    ) -> None:
        """Write the item's splats, and zeros to the end of their last row."""
        array = (
            _skinned(item, placement, origin, turned)
            if placement.bones is not None
            else _placed(item, placement, origin)
        )
        set_uniforms(array.program, {"size": placement.size, "signed_opacity": opacity})
        self._framebuffer.use()  # without a complete framebuffer transform feedback silently writes nothing
        for start in range(0, max(item.count, 1), _BATCH_ROWS * ROW):
            count = min(_BATCH_ROWS * ROW, item.count - start)
            rows = rows_of(count)
            if count:
                array.transform(self.scratch, moderngl.POINTS, vertices=count, first=start)
            if count < rows * ROW:
                self.scratch.write(bytes((rows * ROW - count) * _POSED_BYTES), offset=count * _POSED_BYTES)
            into.write(self.scratch, (0, first_row + start // ROW, ROW * 4, rows))

    def release(self) -> None:
        """Delete the scratch buffer."""
        self.scratch.release()


def near_eye(
    origin: NDArray[np.float64], anchors: NDArray[np.float64], eye: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return ``origin`` [3] if all ``anchors`` [I, 3] are near it, else the anchor nearest to ``eye`` [3]."""
    if len(anchors) and np.abs(anchors - origin).max() > _FAR_M:
        return np.asarray(anchors[np.linalg.norm(anchors - eye, axis=1).argmin()])
    return origin


def _placed(item: ItemBuffers, placement: Placement, origin: NDArray[np.float64]) -> moderngl.VertexArray:
    array = item.array(item.variant)
    uniforms = {
        "turn": tuple(placement.turn.T.ravel()),  # columns
        "rodrigues": tuple(rodrigues_parameters(placement.turn)),
        "offset": tuple(placement.anchor(item.centre) - origin),
    }
    set_uniforms(array.program, uniforms)
    assert item.rest is not None
    item.rest.use(UNITS["splats"])
    return array


def _skinned(
    item: ItemBuffers, placement: Placement, origin: NDArray[np.float64], turned: bool
) -> moderngl.VertexArray:
    assert isinstance(item.variant, SkinVariant) and placement.bones is not None
    shapes = item.shapes if placement.weights is not None else None
    array = item.array(replace(item.variant, turned=int(turned), shaped=int(shapes is not None)))
    set_uniforms(array.program, {"shift": 1.0 if is_rigid(placement.bones) else 3.0})
    item.bones.write(placement.local_bones(item.centre, origin).astype(np.float32))
    item.bones.use(UNITS["bones"])
    if shapes is not None and placement.weights is not None:
        shapes.use(placement.weights)
    return array
