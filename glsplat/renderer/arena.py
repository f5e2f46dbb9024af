"""Arena: all visible splats of a scene in one index space, a range an item. Key, sort, project and draw see only this.

An item has a range for each of its levels of detail that are in use; a picture shows some of the ranges.

One texture holds the geometry (as loaded, three texels a splat, if a single item stands where it was loaded; else
posed, four texels), one the colours. Ranges begin with a row of ROW splats; what is left of a row has opacity 0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from typing import TypeVar

import moderngl
import numpy as np
from numpy.typing import NDArray

from glsplat.errors import ContextError
from glsplat.gl.context import Context
from glsplat.renderer.stage import NEAR, ROW, ItemBuffers, Placement, near_eye, numbers_of, upload_rows, write_rows
from glsplat.shaders.slots import UNITS
from glsplat.shaders.variant import COLOUR_TEXELS

__all__ = ["Arena"]

_RUN = 64
"""Rows that are posed at a time: bounds the scratch buffer to 4 MB."""

_POSED_BYTES = 64


class Arena:
    """The splats of some items, in their order. Made anew when an item comes or goes; the items are borrowed."""

    def __init__(
        self,
        context: Context,
        items: Sequence[ItemBuffers],
        *,
        posed: bool,  # False: a single item without a skeleton, where it was loaded
        degree: int,  # of the colours
        signed: bool = False,  # some items ask for opacity compensation and some do not (variant.antialias 2)
        culled: Sequence[bool] = (),  # of which items the hidden splats are left out, by their cones
        kinds: Sequence[int] = (),  # of items that are the same number a picture shows one at most; default: all
    ) -> None:
        ctx = context.ctx
        self.items, self.posed, self.degree = tuple(items), posed, degree
        self.version = 0  # grows with every movement
        self.runs = 0  # of item passes so far
        self.origin = np.zeros(3)  # world position of the scene's zero
        self._signs = [-1.0 if signed and item.splats.antialias else 1.0 for item in items]
        self._scratch_target = context.scratch
        rows = [max(1, -(-item.count // ROW)) for item in items]
        self.first = np.concatenate([[0], np.cumsum(rows)])  # [I + 1] first row of each item, and the end
        height = int(self.first[-1])
        alone = len(items) == 1
        self.count: int = items[0].count if alone else height * ROW
        self.shown: tuple[int, ...] = tuple(range(len(items)))
        largest: dict[int, int] = {}
        for kind, size in zip(kinds or range(len(items)), rows, strict=True):
            largest[kind] = max(size, largest.get(kind, 0))
        self.most: int = self.count if alone else sum(largest.values()) * ROW  # indices that a picture shows at most
        self._written: list[Placement | None] = [None] * len(items)
        limit = int(ctx.info["GL_MAX_TEXTURE_SIZE"])
        if max(height, ROW * COLOUR_TEXELS[degree]) > limit:
            raise ContextError(
                f"{self.count} splats of SH degree {degree} need textures larger than the {limit} texels of "
                f"{ctx.info['GL_RENDERER']}; use fewer splats or a lower sh_degree"
            )
        with ExitStack() as stack:
            texels, components = COLOUR_TEXELS[degree], 4 if degree else 3
            if alone:
                self.colours = upload_rows(ctx, items[0].colours(degree), texels, components, stack)
            else:
                self.colours = upload_rows(ctx, np.empty((0, 1), np.float32), texels, components, stack, height)
                for item, first in zip(items, self.first, strict=False):
                    write_rows(self.colours, int(first), item.colours(degree), texels, components)
            self.cones = _own(stack, ctx.buffer(self._packed_cones(culled))) if any(culled) else None
            self.numbers = None if context.vertex_ids else _own(stack, numbers_of(ctx, self.count))
            self.splats: moderngl.Texture
            self._run: moderngl.Buffer | None = None
            if posed:
                self.splats = _own(stack, ctx.texture((ROW * 4, max(1, height)), 4, dtype="f4"))
                self.splats.filter = (moderngl.NEAREST, moderngl.NEAREST)
                self._run = _own(stack, ctx.buffer(reserve=min(_RUN, max(rows, default=1)) * ROW * _POSED_BYTES))
            else:
                (item,) = items
                assert item.rest is not None
                self.splats, self.origin = item.rest, item.centre
            self._surfaces: moderngl.Texture | None = None  # made once there is light
            self._ctx, self._height = ctx, height
            self._owned = stack.pop_all()

    @property
    def nbytes(self) -> int:
        """GPU bytes of the posed geometry, the scratch buffer, the cones and the surfaces."""
        posed = self.splats.width * self.splats.height * 16 if self.posed else 0
        surfaces = 0 if self._surfaces is None else self._surfaces.width * self._surfaces.height * 16
        return (
            posed
            + surfaces
            + sum(buffer.size for buffer in (self._run, self.cones, self.numbers) if buffer is not None)
        )

    @property
    def colour_nbytes(self) -> int:
        """GPU bytes of the colours."""
        return self.colours.width * self.colours.height * (16 if self.degree else 12)

    @property
    def ranges(self) -> tuple[tuple[int, int], ...]:
        """First index and number of indices of what is shown, adjacent ranges in one, with what fills up their rows."""
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
    def shown_starts(self) -> NDArray[np.intp]:
        """[S] where each shown item begins among the indices of ``ranges``, taken one after the other."""
        rows = np.diff(self.first)[list(self.shown)]
        return (np.cumsum(rows) - rows) * ROW

    @property
    def shown_splats(self) -> int:
        """Splats of what is shown."""
        return sum(self.items[index].count for index in self.shown)

    @property
    def padding(self) -> int:
        """Indices in ``ranges`` that are nobody's splat."""
        return sum(count for _, count in self.ranges) - self.shown_splats

    def place(self, places: Mapping[int, Placement], eye: NDArray[np.float64]) -> bool:
        """Show the items of these numbers, in their order; pose and place what moved. True if anything moved.

        ``eye`` [3]: where they are looked at from, in the world.
        """
        self.shown = tuple(places)
        if not self.posed:
            return False
        before = self.version
        origin = self._origin(places, eye)
        if not np.array_equal(origin, self.origin):
            self._written = [None] * len(self.items)
            self.origin = origin
        for index, place in places.items():
            if place.same(self._written[index]):
                continue
            self._written[index] = None  # until it is there: what is half written must not be taken for finished
            self.version += 1
            self._write(index, place)
            self._written[index] = place
        return self.version != before

    def use(self) -> None:
        """Bind the textures for the passes of a frame."""
        self.splats.use(UNITS["splats"])
        self.colours.use(UNITS["colours"])

    @property
    def surfaced(self) -> bool:
        """Whether any of its splats know the surface they lie on."""
        return any(item.splats.surface is not None for item in self.items)

    def use_surfaces(self) -> None:
        """Bind what light falls on (light.glsl), uploaded the first time: without light nobody pays for it."""
        if self._surfaces is None:
            with ExitStack() as stack:
                made = upload_rows(self._ctx, np.empty((0, 1), np.float32), 2, 4, stack, self._height)
                for item, first in zip(self.items, self.first, strict=False):
                    write_rows(made, int(first), item.surfaces(), 2, 4)
                stack.pop_all()
            self._surfaces = _own(self._owned, made)
        self._surfaces.use(UNITS["surfaces"])

    def written(self, index: int = 0) -> bool:
        """Whether the range of an item holds what it was last asked to hold."""
        return self._written[index] is not None

    def read(self, index: int = 0) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
        """World means [N, 3] and shapes [N, 3, 3] of a posed item, on the host."""
        first, item = int(self.first[index]), self.items[index]
        rows = np.frombuffer(self.splats.read(), np.float32).reshape(-1, 16)[first * ROW :][: item.count]
        shapes = np.stack([rows[:, 4 + 4 * i : 7 + 4 * i] for i in range(3)], axis=-1)
        return rows[:, :3] + self.origin, shapes

    def release(self) -> None:
        """Delete textures and buffers, not the items."""
        self._owned.close()

    def _origin(self, places: Mapping[int, Placement], eye: NDArray[np.float64]) -> NDArray[np.float64]:
        """Near the items: float32 has no bits left for splats far from it."""
        anchors = np.array([self.items[index].anchor(place) for index, place in places.items()])
        if len(self.items) == 1 == len(anchors):  # nothing else has to move with it
            return anchors[0] if np.abs(anchors[0]).max() > NEAR else np.zeros(3)
        middle = np.median(anchors, axis=0) if len(anchors) else np.zeros(3)
        middle = near_eye(middle, anchors, eye)
        wanted = np.rint(middle / NEAR) * NEAR if np.abs(middle).max() > NEAR else np.zeros(3)
        return wanted if np.abs(wanted - self.origin).max() > 2 * NEAR else self.origin

    def _write(self, index: int, place: Placement) -> None:
        item, first = self.items[index], int(self.first[index])
        array = item.prepare(place, self.origin, self.degree > 0, self._signs[index] * place.opacity)
        assert self._run is not None
        self._scratch_target.use()  # without a complete framebuffer transform feedback silently writes nothing
        self.runs += 1
        for start in range(0, max(item.count, 1), _RUN * ROW):
            count = min(_RUN * ROW, item.count - start)
            rows = max(1, -(-count // ROW))
            if count:
                array.transform(self._run, moderngl.POINTS, vertices=count, first=start)
            if count < rows * ROW:
                self._run.write(bytes((rows * ROW - count) * _POSED_BYTES), offset=count * _POSED_BYTES)
            self.splats.write(self._run, (0, first + start // ROW, ROW * 4, rows))

    def _packed_cones(self, culled: Sequence[bool]) -> NDArray[np.int8]:
        """[count, 4]; the other items get one that hides nothing."""
        out = np.zeros((max(1, self.count), 4), np.int8)
        out[:, 3] = -127  # the smallest cosine there is
        for item, first, mine in zip(self.items, self.first, culled, strict=False):
            if mine and item.splats.cones is not None:
                out[first * ROW : first * ROW + item.count] = item.splats.cones
        return out


T = TypeVar("T", moderngl.Texture, moderngl.Buffer)


def _own(stack: ExitStack, item: T) -> T:
    stack.callback(item.release)
    return item
