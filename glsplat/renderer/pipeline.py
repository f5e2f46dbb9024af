"""Pipeline: the steps of a frame for one arena and one shader variant: key, sort, project, draw, resolve, read."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera
from glsplat.config import RenderConfig
from glsplat.gl.context import Context
from glsplat.light.light import Light
from glsplat.pictures import lifted
from glsplat.renderer.arena import Arena
from glsplat.renderer.draw import BackgroundPass, DrawPass, Slices, corners_of, fits
from glsplat.renderer.frame_block import FrameBlock
from glsplat.renderer.gpu_sort import GpuSorter, gpu_sorts_faster
from glsplat.renderer.key import BLOCK_PIXELS, KeyPass
from glsplat.renderer.mesh_pass import MeshPass
from glsplat.renderer.owned import OwnsObjects, owned
from glsplat.renderer.project import ProjectPass
from glsplat.renderer.read_back import Transfer, read_bytes, read_floats
from glsplat.renderer.resolve import ResolvePass, ResolveStep
from glsplat.renderer.sort import FIRST_CULLED, count_culled, covered_box, sorted_indices
from glsplat.renderer.stats import Box, FrameStats, union
from glsplat.renderer.targets import ByteTarget, Target
from glsplat.shaders import Programs, Variant
from glsplat.timing import StageTimer


class Pipeline(OwnsObjects):
    """Owns the work buffers and vertex arrays of a variant; arena and programs are borrowed."""

    variant: Variant

    def __init__(
        self, context: Context, programs: Programs, variant: Variant, arena: Arena, config: RenderConfig
    ) -> None:
        ctx, count = context.ctx, arena.most
        if variant.pulled and not fits(ctx, variant, count):
            variant = replace(variant, pulled=0)
        self._arena, self._config, self.variant = arena, config, variant
        self._scratch = context.scratch
        self._seen: tuple[Any, ...] | None = None  # the state that the records were made for
        self._counted = True
        self._order: NDArray[np.uint32] = np.empty(0, np.uint32)  # indices among the shown ranges, far to near
        self._recorded = self._order  # those of them that have records
        self._shown: tuple[int, ...] = ()  # parts of the arena that are in the order
        self._order_age = config.debug.sort_period  # moved frames since the sort; at first more than allowed
        self.culled: dict[str, int] = {}
        self.covered: Box = (0, 0, 0, 0)
        self._splat_box: Box | None = None  # holds the pixels of the current records, once it is known
        self.cost: int | None = None  # covered pixels of the current records, if counted
        self.item_costs: tuple[int, ...] = ()  # the same of each shown item
        self._costs: NDArray[np.uint32] | None = None  # blocks of each shown splat, if the host sorts
        with ExitStack() as stack:  # releases everything if an allocation fails
            self._frame = owned(stack, FrameBlock(ctx, variant.views))
            self._project = owned(stack, ProjectPass(context, programs, variant, count))
            records, order = self._project.records, self._project.order
            self._key = owned(stack, KeyPass(ctx, programs, variant, arena, records))
            self._sorter: GpuSorter | None = None
            by_gpu = config.sorter == "gpu"
            if config.sorter == "auto" and GpuSorter.fits(context, records):
                by_gpu = gpu_sorts_faster(context, programs, count)
            if by_gpu:
                settings = (count, variant.views, config.debug.sort_bits, corners_of(variant), bool(variant.pulled))
                self._sorter = owned(stack, GpuSorter(ctx, programs, order, records, *settings))
            self._draw = owned(stack, DrawPass(context, programs, variant, self._project.records))
            self._background = owned(stack, BackgroundPass(ctx, programs, variant))
            self._resolve = owned(stack, ResolvePass(ctx, programs, variant))
            self._owned = stack.pop_all()

    @property
    def drawn(self) -> int:
        """Splats of the current order."""
        return self._project.count

    @property
    def nbytes(self) -> int:
        """GPU bytes of the work buffers."""
        return self._project.order.size + self._project.records.size

    def make_records(
        self,
        views: Sequence[Camera],
        sort_viewmat: NDArray[np.float64],
        timer: StageTimer,
        costed: int = 0,  # 1: count the cost; 2: also of each item, even if that waits for the GPU
        shared: bool = False,  # other passes of the frame use this pipeline, too: an old order may be theirs
        light: Light | None = None,  # of the scene
    ) -> bool:
        """Do steps 1 to 3, up to the records in drawing order. Return whether the splats were sorted again."""
        arena = self._arena
        self._frame.write(views, sort_viewmat, arena.origin, self._config)
        arena.use()
        if not self.variant.lit:
            light = None
        else:
            arena.use_surfaces()
        self._scratch.use()  # without a complete framebuffer transform feedback silently writes nothing
        timer.mark("frame")
        # an unmoved scene under unmoved cameras and light keeps its order and its records
        lit = None if light is None else light.uniforms().tobytes()
        state = (arena.version, arena.shown, sort_viewmat.tobytes(), tuple(map(view_state, views)), lit)
        moved = state != self._seen
        known = self.cost is not None and (bool(self.item_costs) or costed < 2)
        if not moved and self._order_age == 0 and (known or not costed):
            return False
        resort = (
            shared
            or not moved
            or self._order_age + 1 >= self._config.debug.sort_period
            or self._shown != arena.shown  # the old order is of other splats
            or bool(self._sorter and costed)  # the sorter adds up the costs
        )
        age = 0 if resort else self._order_age + 1
        # set again when the records exist, so that an interrupted frame is not taken for a complete one
        self._seen, self._order_age = None, self._config.debug.sort_period
        self.cost, self._costs, self.item_costs = None, None, ()
        self._shown = arena.shown
        if self._sorter is None:
            self._sort_on_host(views[0], timer, resort, bool(costed))
        else:
            if resort:
                self._key.run(arena.ranges)
                timer.mark("key")
                if costed == 2:
                    self.item_costs = self._itemised(self._key.read()[2])
                self._sorter.run(arena.ranges)
                self._project.count = arena.most  # as long as only the GPU knows the number
                self._counted = False
            self._splat_box = None
        timer.mark("sort")
        self._project.run(light, self._sorter.indirect if self._sorter else None)
        timer.mark("project")
        self._order_age, self._seen = age, state
        if self._sorter and costed:
            self._count()
        return resort

    def _sort_on_host(self, view: Camera, timer: StageTimer, resort: bool, costed: bool) -> None:
        ranges = self._arena.ranges
        self._key.run(ranges)  # also with an old order: the covered box comes from the keys
        timer.mark("key")
        keys, tiles, costs = self._key.read()
        if costed:
            self._costs, self.item_costs = costs, self._itemised(costs)
            self.cost = sum(self.item_costs)
        self.culled = self._without_padding(count_culled(keys))
        self._splat_box = covered_box(tiles[keys < FIRST_CULLED], view.width, view.height)
        if resort:
            self._order = self._recorded = sorted_indices(keys, self._config.debug.sort_bits)
        else:  # an old order without splats culled since: they lie outside of the covered box
            self._recorded = self._order[keys[self._order] < FIRST_CULLED]
        self._project.write_order(_in_arena(self._recorded, ranges))

    def draw(
        self,
        target: Target,
        views: Sequence[Camera],
        timer: StageTimer,
        boxed: bool,
        mesh_pass: MeshPass | None = None,  # with meshes in the scene
        slices: Slices | None = None,
    ) -> None:
        """Do step 4: draw backgrounds (``boxed``: inside the covered box only), then every record.

        Raises the exceptions of ``slices.between``.
        """
        whole = (0, 0, views[0].width, views[0].height)
        if self._splat_box is None and boxed:  # only the GPU knows the splats' pixels
            self._splat_box = self._arena.covered(views, self._config)
        self.covered = whole if self._splat_box is None else self._splat_box
        if mesh_pass is not None:
            mesh_pass.use()
            self.covered = union(self.covered, mesh_pass.covered)
        if not self.covered[2]:
            self.covered = (0, 0, 1, 1)  # the encoder needs a pixel
        self._background.run(target, views, self.covered if boxed else whole)
        if slices is not None and slices.between is not None and (self.cost or 0) > slices.cost:
            self._draw.run_slices(target, self._slices(slices.cost), slices.between)
        else:
            self._draw.run(self._project.count, indirect=self._sorter.indirect if self._sorter else None)
        timer.mark("draw")

    def resolve(
        self,
        target: Target,
        into: ByteTarget,
        views: Sequence[Camera],
        timer: StageTimer,
        step: ResolveStep | None,
        texture: moderngl.Texture | None,  # of the step
    ) -> None:
        """Do step 5: convert to 8 bits, after the application's own step."""
        self._resolve.run(target, into, views, self.covered, step, texture)
        timer.mark("resolve")

    def read(
        self,
        target: Target,
        byte_target: ByteTarget | None,
        views: Sequence[Camera],
        out: NDArray[Any],  # [V, H, W, 4] uint8 if there is a byte target, else float32
        timer: StageTimer,
        transfer: Transfer | None = None,  # takes a picture of 8 bits to ``out`` later
    ) -> None:
        """Do step 6: copy the picture to ``out`` on the host."""
        if byte_target is None:
            read_floats(target, out)
            if self.variant.cull_hidden:
                for picture, view in zip(out, views, strict=True):
                    picture[:] = lifted(picture, view.background)
        elif transfer is not None:
            transfer.read(byte_target, out, self.covered)
        else:
            read_bytes(byte_target, out, self.covered)
        if self._sorter and not self._counted:
            self._count()  # after the read, so that the host waits once
        timer.mark("read")

    def added(self, stats: FrameStats) -> FrameStats:
        """Return ``stats`` plus the counts of this pass."""
        return stats.plus(self.drawn, self.culled, self.covered, self.cost or 0)

    def _itemised(self, costs: NDArray[np.uint32]) -> tuple[int, ...]:
        """Return the covered pixels of each shown item, from the blocks of its splats."""
        if not len(costs):
            return (0,) * len(self._arena.shown)
        blocks = np.add.reduceat(costs, self._arena.shown_starts, dtype=np.int64)
        return tuple((BLOCK_PIXELS * blocks).tolist())

    def _count(self) -> None:
        """Read back the counts of the GPU sorter."""
        assert self._sorter is not None
        self._project.count, culled, blocks = self._sorter.counts()
        self.culled = self._without_padding(culled)
        self.cost = BLOCK_PIXELS * blocks
        self._counted = True

    def _without_padding(self, culled: dict[str, int]) -> dict[str, int]:
        """Return the counts without the arena's padding, which is transparent."""
        return culled | {"transparent": culled["transparent"] - self._arena.padding}

    def _slices(self, cost: float) -> list[int]:
        """Return where to cut the records into slices of about ``cost``: the number of the record after each."""
        count = self._project.count
        wanted = max(1, min(count, int(-(-(self.cost or 0) // cost))))
        if self._costs is None:  # only the GPU knows the cost of each record
            return [count * i // wanted for i in range(1, wanted + 1)]
        sums = np.cumsum(self._costs[self._recorded], dtype=np.uint64)
        cuts = np.searchsorted(sums, int(sums[-1]) * np.arange(1, wanted) // wanted) + 1
        return sorted({*map(int, cuts), count})


def _in_arena(order: NDArray[np.uint32], ranges: Sequence[tuple[int, int]]) -> NDArray[np.uint32]:
    """Return indices in the arena for indices among the splats of ``ranges``."""
    if len(ranges) == 1:
        return order + np.uint32(ranges[0][0]) if ranges[0][0] else order
    spans = [np.arange(first, first + count, dtype=np.uint32) for first, count in ranges]
    return np.concatenate([*spans, np.empty(0, np.uint32)])[order]


def view_state(camera: Camera) -> tuple[object, ...]:
    """Return the parts of a camera that records depend on."""
    return camera.viewmat.tobytes(), camera.K.tobytes(), camera.width, camera.height, camera.near, camera.far
