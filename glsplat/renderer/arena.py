"""Arena: all visible splats of a scene in one index space. Key, sort, project and draw see only this.

Each item has a range for each of its levels of detail in use; a picture shows some of the ranges. One texture holds
the geometry: as loaded (three texels a splat) of a single unmoved item, else posed (four texels). One holds the
colours. Ranges begin with a row of ROW splats; the padding at the end of a row has opacity 0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack

import moderngl
import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera
from glsplat.config import RenderConfig
from glsplat.errors import ContextError
from glsplat.gl.context import Context
from glsplat.renderer.bounds import covered_pixels
from glsplat.renderer.owned import LruCache, OwnsObjects, Sized, data_texture, owned
from glsplat.renderer.skin import Placement, SkinPass, near_eye
from glsplat.renderer.stage import NEAR_M, ROW, ItemBuffers, numbers_of, rows_of, upload_rows, write_rows
from glsplat.renderer.stats import Box
from glsplat.shaders import Variant
from glsplat.shaders.slots import UNITS
from glsplat.shaders.variant import COLOUR_TEXELS

_MAX_PIPELINES = 8
_MAX_PIPELINE_BYTES = 256 * 2**20  # of those that are not in use

Part = tuple[int, int]
"""Number of a visible item, and its level of detail."""

PipelineKey = tuple[Variant, tuple[int, int], int]
"""Variant, size in pixels, and number of the pass in its call."""


class Arena(OwnsObjects):
    """The splats of some items, in their order, and the pipelines that draw them. The items are borrowed."""

    def __init__(
        self,
        context: Context,
        parts: Sequence[Part],  # the items' numbers and levels; a picture shows one level of each number at most
        items: Sequence[ItemBuffers],
        *,
        posed: bool,  # False: a single item without a skeleton, where it was loaded
        degree: int,  # of the colours
        signed: bool = False,  # some items ask for opacity compensation and some do not (variant.antialias 2)
        culled: Sequence[bool] = (),  # [I] whether an item's hidden splats are culled by their cones
    ) -> None:
        ctx = context.ctx
        self.parts, self.items, self.posed, self.degree = tuple(parts), tuple(items), posed, degree
        self.version = 0  # grows with every movement
        self.runs = 0  # of the skin pass
        self.origin = np.zeros(3)  # world position of the scene's zero
        self.shown: tuple[int, ...] = tuple(range(len(items)))
        self.pipelines: LruCache[PipelineKey, Sized] = LruCache(_MAX_PIPELINES, _MAX_PIPELINE_BYTES)
        self._signs = [-1.0 if signed and item.splats.antialias else 1.0 for item in items]
        self._written: list[Placement | None] = [None] * len(items)
        rows = [rows_of(item.count) for item in items]
        self.first = np.concatenate([[0], np.cumsum(rows)])  # [I + 1] first row of each item, and the end
        height = int(self.first[-1])
        alone = len(items) == 1
        self.count: int = items[0].count if alone else height * ROW
        largest: dict[int, int] = {}  # rows by the item's number
        for (number, _), size in zip(parts, rows, strict=True):
            largest[number] = max(size, largest.get(number, 0))
        self.most: int = (
            self.count if alone else sum(largest.values()) * ROW
        )  # upper bound of the indices in ``ranges``
        texels, components = COLOUR_TEXELS[degree], 4 if degree else 3
        limit = int(ctx.info["GL_MAX_TEXTURE_SIZE"])
        if max(height, ROW * texels) > limit:
            raise ContextError(
                f"{self.count} splats of SH degree {degree} need textures larger than the {limit} texels of "
                f"{ctx.info['GL_RENDERER']}; use fewer splats or a lower sh_degree"
            )
        with ExitStack() as stack:  # releases everything if an allocation fails
            if alone:
                self.colours = upload_rows(ctx, items[0].colours(degree), texels, components, stack)
            else:
                self.colours = upload_rows(ctx, np.empty((0, 1), np.float32), texels, components, stack, height)
                for item, first in zip(items, self.first, strict=False):
                    write_rows(self.colours, int(first), item.colours(degree), texels, components)
            self.cones = owned(stack, ctx.buffer(self._packed_cones(culled))) if any(culled) else None
            self.numbers = None if context.vertex_ids else owned(stack, numbers_of(ctx, self.count))
            self.splats: moderngl.Texture
            self._skin: SkinPass | None = None
            if posed:
                self.splats = data_texture(stack, ctx, (ROW * 4, max(1, height)), 4)
                self._skin = owned(stack, SkinPass(context, max(rows, default=1)))
            else:
                (item,) = items
                assert item.rest is not None
                self.splats, self.origin = item.rest, item.centre
            self._surfaces: moderngl.Texture | None = None  # made with the first light
            self._ctx, self._height = ctx, height
            stack.callback(self.pipelines.release)
            self._owned = stack.pop_all()

    @property
    def nbytes(self) -> int:
        """GPU bytes of the arena and its pipelines."""
        return self.geometry_nbytes + self.colour_nbytes + self.pipelines.nbytes

    @property
    def geometry_nbytes(self) -> int:
        """GPU bytes of the posed geometry, the scratch buffer, the cones and the surfaces."""
        textures = [self.splats if self.posed else None, self._surfaces]
        buffers = [self._skin.scratch if self._skin else None, self.cones, self.numbers]
        return sum(t.width * t.height * 16 for t in textures if t is not None) + sum(
            buffer.size for buffer in buffers if buffer is not None
        )

    @property
    def colour_nbytes(self) -> int:
        """GPU bytes of the colours."""
        return self.colours.width * self.colours.height * (16 if self.degree else 12)

    @property
    def ranges(self) -> tuple[tuple[int, int], ...]:
        """First index and number of indices of the shown parts, padding included; adjacent ranges are joined."""
        if len(self.shown) == len(self.items):
            return ((0, self.count),)
        found: list[tuple[int, int]] = []
        for index in self.shown:
            first, end = int(self.first[index]) * ROW, int(self.first[index + 1]) * ROW
            if found and sum(found[-1]) == first:
                found[-1] = found[-1][0], end - found[-1][0]
            else:
                found.append((first, end - first))
        return tuple(found)

    @property
    def shown_items(self) -> list[ItemBuffers]:
        """The items that this frame shows, each at one level of detail."""
        return [self.items[index] for index in self.shown]

    @property
    def shown_starts(self) -> NDArray[np.intp]:
        """[S] where each shown item begins among the indices of ``ranges``, taken one after the other."""
        rows = np.diff(self.first)[list(self.shown)]
        return (np.cumsum(rows) - rows) * ROW

    @property
    def shown_splats(self) -> int:
        """Splats of the shown parts."""
        return sum(item.count for item in self.shown_items)

    @property
    def padding(self) -> int:
        """Indices in ``ranges`` without a splat."""
        return sum(count for _, count in self.ranges) - self.shown_splats

    @property
    def surfaced(self) -> bool:
        """Whether any item has a surface for relighting."""
        return any(item.splats.surface is not None for item in self.items)

    def show(self, placements: Mapping[Part, Placement], eye: NDArray[np.float64]) -> bool:
        """Show these parts, in the arena's order; pose and place items that moved. Return whether any did.

        ``eye`` [3] is the position of the first view.
        """
        placed = {self.parts.index(part): placement for part, placement in placements.items()}
        self.shown = tuple(placed)
        if not self.posed:
            return False
        before = self.version
        origin = self._origin(placed, eye)
        if not np.array_equal(origin, self.origin):
            self._written = [None] * len(self.items)
            self.origin = origin
        for index, placement in placed.items():
            if not placement.same(self._written[index]):
                self._written[index] = None  # until it is written: an interrupted write must not count
                self.version += 1
                self._write(index, placement)
                self._written[index] = placement
        return self.version != before

    def covered(self, views: Sequence[Camera], config: RenderConfig) -> Box:
        """Return a box that holds all pixels of the shown items, from their bones (bounds.py)."""
        still = Placement(np.eye(4))
        placed = [(self.items[index], self._written[index] or still) for index in self.shown]
        bounds = (i.bounds(config.max_sigma).posed(at.transform, at.bones, at.weights) for i, at in placed)
        return covered_pixels(views, bounds, config)

    def use(self) -> None:
        """Bind the textures for the passes of a frame."""
        self.splats.use(UNITS["splats"])
        self.colours.use(UNITS["colours"])

    def use_surfaces(self) -> None:
        """Bind the surfaces (light.glsl). The first call uploads them, so that a scene without light has none."""
        if self._surfaces is None:
            with ExitStack() as stack:
                made = upload_rows(self._ctx, np.empty((0, 1), np.float32), 2, 4, stack, self._height)
                for item, first in zip(self.items, self.first, strict=False):
                    write_rows(made, int(first), item.surfaces(), 2, 4)
                stack.pop_all()
            self._surfaces = owned(self._owned, made)
        self._surfaces.use(UNITS["surfaces"])

    @property
    def written(self) -> bool:
        """Whether the range of the first item holds its last placement."""
        return self._written[0] is not None

    def read(self) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
        """Read back world means [N, 3] and shapes [N, 3, 3] of the first item, which is posed."""
        rows = np.frombuffer(self.splats.read(), np.float32).reshape(-1, 16)[: self.items[0].count]
        shapes = np.stack([rows[:, 4 + 4 * i : 7 + 4 * i] for i in range(3)], axis=-1)
        return rows[:, :3] + self.origin, shapes

    def _write(self, index: int, placement: Placement) -> None:
        assert self._skin is not None
        first, opacity = int(self.first[index]), self._signs[index] * placement.opacity
        self.runs += 1
        self._skin.run(
            self.items[index], placement, self.splats, first, self.origin, turned=self.degree > 0, opacity=opacity
        )

    def _origin(self, placements: Mapping[int, Placement], eye: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return an origin [3] near the items, as float32 coordinates are too coarse far from it."""
        anchors = np.array([placement.anchor(self.items[index].centre) for index, placement in placements.items()])
        if len(self.items) == 1 == len(anchors):  # nothing else has to move with it
            return anchors[0] if np.abs(anchors[0]).max() > NEAR_M else np.zeros(3)
        middle = np.median(anchors, axis=0) if len(anchors) else np.zeros(3)
        middle = near_eye(middle, anchors, eye)
        wanted = np.rint(middle / NEAR_M) * NEAR_M if np.abs(middle).max() > NEAR_M else np.zeros(3)
        return wanted if np.abs(wanted - self.origin).max() > 2 * NEAR_M else self.origin

    def _packed_cones(self, culled: Sequence[bool]) -> NDArray[np.int8]:
        """Return visibility cones [count, 4]; items that are not culled get cones that hide nothing."""
        out = np.zeros((max(1, self.count), 4), np.int8)
        out[:, 3] = -127  # the smallest cosine there is
        for item, first, mine in zip(self.items, self.first, culled, strict=False):
            if mine and item.splats.cones is not None:
                out[first * ROW : first * ROW + item.count] = item.splats.cones
        return out
