"""Pipeline: the passes of one variant over one scene, in order: skin, key, sort, project, draw, resolve, read."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera
from glsplat.config import RenderConfig
from glsplat.context import Context
from glsplat.passes.draw import DrawPass
from glsplat.passes.frame import FrameBlock
from glsplat.passes.geometry import KeyPass, SkinPass
from glsplat.passes.gpu_sort import GpuSorter
from glsplat.passes.project import ProjectPass
from glsplat.passes.scene import SceneBuffers
from glsplat.passes.sort import FIRST_CULLED, count_culled, covered_box, sorted_indices
from glsplat.passes.target import Box, ByteTarget, Clear, Resolve, Target
from glsplat.reference import lifted
from glsplat.shaders import Programs, Variant
from glsplat.timing import StageTimer

__all__ = ["Pipeline"]


class _Owner(Protocol):
    def release(self) -> None: ...


P = TypeVar("P", bound=_Owner)


class Pipeline:
    """Owns what depends on the variant: work buffers and vertex arrays. The scene and the programs are borrowed."""

    variant: Variant

    def __init__(
        self, context: Context, programs: Programs, variant: Variant, scene: SceneBuffers, config: RenderConfig
    ) -> None:
        ctx, count = context.ctx, scene.count
        self._scene, self._config, self.variant = scene, config, variant
        self._scratch = context.scratch
        self._seen: tuple[Any, ...] | None = None  # what the records were made for
        self._counted = True
        self._posed_for = -1
        self._order: NDArray[np.uint32] = np.empty(0, np.uint32)
        self._order_age = config.sort_period  # moved frames since the sort; at first more than may pass
        self.culled: dict[str, int] = {}
        self.covered: Box = (0, 0, 0, 0)
        with ExitStack() as stack:  # releases what was made if a later pass cannot be

            def own(item: P) -> P:
                stack.callback(item.release)
                return item

            self._frame = own(FrameBlock(ctx, variant.views))
            self._skin = own(SkinPass(ctx, programs, variant, scene)) if variant.influences else None
            content = self._skin.content() if self._skin else scene.rigid_content()
            self._project = own(ProjectPass(ctx, programs, variant, content + scene.sh_content(variant), count))
            self._key = own(
                KeyPass(ctx, programs, variant, content + scene.cone_content(), count, cover=self._project.order)
            )
            self._sorter: GpuSorter | None = None
            automatic = config.sorter == "auto" and context.compute and not context.software
            if config.sorter == "gpu" or (automatic and GpuSorter.fits(ctx, self._project.records)):
                work = (self._key.keys, self._project.order, self._project.records)
                corners = 3 if variant.triangle else 4
                self._sorter = own(GpuSorter(ctx, programs, *work, count, variant.views, config.sort_bits, corners))
            self._draw = own(DrawPass(ctx, programs, variant, self._project.records))
            self._clear = own(Clear(ctx, programs, variant))
            self._resolve = own(Resolve(ctx, programs, variant))
            self._owned = stack.pop_all()

    @property
    def drawn(self) -> int:
        """Splats of the current order."""
        return self._project.count

    @property
    def skin(self) -> SkinPass | None:
        """The skin pass, if the scene has one."""
        return self._skin

    @property
    def nbytes(self) -> int:
        """GPU bytes of the work buffers."""
        buffers = [self._key.keys, self._project.order, self._project.records]
        return sum(b.size for b in buffers) + (self._skin.posed.size if self._skin else 0)

    def geometry(
        self,
        views: Sequence[Camera],
        sort_viewmat: NDArray[np.float64],
        version: int,
        timer: StageTimer,
        alone: bool = True,  # no other pass of this frame has left its order here
    ) -> bool:
        """Steps 1 to 3, up to the records in drawing order. True if the splats were sorted again."""
        self._frame.write(views, sort_viewmat, self._scene.origin, self._config, self._scene.shift)
        self._scratch.use()  # without a complete framebuffer transform feedback silently writes nothing
        timer.mark("frame")
        if self._skin and self._posed_for != version:
            self._skin.run()
            self._posed_for = version
            timer.mark("skin")
        # an unmoved scene seen by unmoved cameras keeps its order and its records
        state = (version, sort_viewmat.tobytes(), tuple(map(_view_state, views)))
        moved = state != self._seen
        if not moved and self._order_age == 0:
            return False
        self._seen = state
        resort = not (moved and alone) or self._order_age + 1 >= self._config.sort_period
        self._order_age = 0 if resort else self._order_age + 1
        if self._sorter:
            if resort:
                self._key.run()
                timer.mark("key")
                self._sorter.run()
                self._project.count = self._scene.count  # culled ones sort last; the indirect draw leaves them out
                self._counted = False
            self.covered = (0, 0, views[0].width, views[0].height)
        else:
            self._key.run()  # with an old order too: it knows which box is covered
            timer.mark("key")
            keys, tiles = self._key.read()
            self.culled = count_culled(keys)
            self.covered = covered_box(tiles[keys < FIRST_CULLED], views[0].width, views[0].height)
            if resort:
                self._order = order = sorted_indices(keys, self._config.sort_bits)
            else:  # an old order without what is culled by now: the covered box does not hold that
                order = self._order[keys[self._order] < FIRST_CULLED]
            self._project.write_order(order)
        timer.mark("sort")
        self._project.run()
        timer.mark("project")
        return resort

    def draw(self, target: Target, views: Sequence[Camera], timer: StageTimer, boxed: bool) -> None:
        """Step 4: backgrounds (``boxed``: where splats fall, nothing else will be read), then every record."""
        self._clear.run(target, views, self.covered if boxed else (0, 0, views[0].width, views[0].height))
        self._draw.run(target, self._project.count, self._sorter.indirect if self._sorter else None)
        timer.mark("draw")

    def read(
        self,
        target: Target,
        byte_target: ByteTarget | None,
        views: Sequence[Camera],
        out: NDArray[Any],  # [V, H, W, 4] uint8 if there is a byte target, else float32
        timer: StageTimer,
    ) -> None:
        """Steps 5 and 6: 8-bit conversion where asked for, and the picture to the host."""
        if byte_target is None:
            target.read(out)
            if self.variant.cull_hidden:
                for picture, view in zip(out, views, strict=True):
                    picture[:] = lifted(picture, view.background)
        else:
            self._resolve.run(target, byte_target, views, self.covered)
            timer.mark("resolve")
            byte_target.read(out, self.covered)
        if self._sorter and not self._counted:
            self._project.count, self.culled = self._sorter.counts()  # after the read, so that nothing waits twice
            self._counted = True
        timer.mark("read")

    def release(self) -> None:
        """Delete the work buffers and vertex arrays."""
        self._owned.close()


def _view_state(camera: Camera) -> tuple[object, ...]:
    """All of a camera that decides records."""
    return camera.viewmat.tobytes(), camera.K.tobytes(), camera.width, camera.height, camera.near, camera.far
