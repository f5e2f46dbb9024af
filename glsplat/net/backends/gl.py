"""RendererBackend: draws with OpenGL for the server. Imports little, so that the process that draws starts quickly."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera, look_at, pinhole
from glsplat.config import LEAN, RenderConfig
from glsplat.errors import BudgetError, ContextLostError, FormatError, GlsplatError, PoseError
from glsplat.net.backend import Rendered, RenderJob, Submitted
from glsplat.net.codec.encoded import DepthGrid
from glsplat.renderer.stats import union
from glsplat.scene import Rigged, SceneLike

if TYPE_CHECKING:
    from glsplat.formats.scene_file import SceneFile
    from glsplat.renderer import Prepared
    from glsplat.renderer.checks import Images
    from glsplat.renderer.read_back import Transfer

MAX_COST = 1e9
"""Covered pixels of a picture (renderer.Prepared.cost): eight times the cost of a person who fills two eyes of 2048^2,
and over twice that of a face in front of the eyes (docs/protocol.md, section 5)."""

_LEAN_SHARE = 0.5  # of a picture's covered pixels, where splats end as early as with LEAN

MAX_PICTURE_S = 5.0

_SLICE_S = 1.0  # pictures that take longer are drawn in slices
_MIN_SLICE_COST = 1e6  # covered pixels


def max_cost_of(config: RenderConfig) -> float:
    """Return the limit of a picture's covered pixels: the same views are refused with LEAN and without."""
    return MAX_COST * (_LEAN_SHARE if config.max_sigma <= LEAN.max_sigma else 1.0)


class PictureBudget:
    """Limits of one picture. Costs are in covered pixels (``renderer.Prepared.cost``)."""

    def __init__(
        self,
        max_cost: float = math.inf,  # a picture above it is refused before anything is drawn
        seconds: float = math.inf,  # from now on; a slower picture is abandoned between two slices
        slice_cost: float = math.inf,  # a picture above it is drawn in slices of about that cost
        abandoned: Callable[[], bool] = lambda: False,  # called between slices: whether the picture is not needed
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self._max_cost, self._seconds, self._slice_cost = max_cost, seconds, slice_cost
        self._abandoned, self._clock = abandoned, clock
        self._start = clock()

    def render(self, prepared: Prepared, out: Images | None = None, transfer: Transfer | None = None) -> Images:
        """Render within these limits. Raises BudgetError (too_costly, abandoned, too_slow)."""
        if prepared.cost > self._max_cost:
            raise BudgetError(
                f"the picture covers {prepared.cost:.3g} pixels splat by splat, at most {self._max_cost:.3g} are drawn;"
                " ask for a smaller size or look from further away",
                "too_costly",
            )
        return prepared.render(between=self.check, slice_cost=self._slice_cost, out=out, transfer=transfer)

    def check(self) -> None:
        """Raise BudgetError (abandoned, too_slow) unless the picture is to be continued."""
        if self._abandoned():
            raise BudgetError("the picture is no longer wanted", "abandoned")
        if self._clock() - self._start > self._seconds:
            raise BudgetError(
                f"the picture took more than {self._seconds:g} s; ask for a smaller size or look from further away",
                "too_slow",
            )


class RendererBackend:
    """Draws one scene, or the one of ``avatars`` that a job names, in pictures of any sizes, within a budget."""

    def __init__(
        self,
        scene: SceneLike | SceneFile,  # the motions of a file play from open() on
        pixels: tuple[int, int],
        device: str | None = None,
        config: RenderConfig | None = None,
        max_cost: float | None = None,  # None: max_cost_of(config)
        max_time: float = MAX_PICTURE_S,
        avatars: Mapping[str, Rigged] | None = None,  # by RenderJob.avatar; any other name is the scene
        rooms: Mapping[str, SceneFile] | None = None,  # the scenery of each
        name: str | None = None,  # of the scene: any other name that is not in ``avatars`` then fails
    ) -> None:
        self.abandoned: Callable[[], bool] = lambda: False
        self.out: NDArray[np.uint8] | None = None
        self._config = config or RenderConfig()
        self._max_cost = max_cost_of(self._config) if max_cost is None else max_cost
        self._max_time = max_time
        self._scene, self._pixels, self._device = scene, pixels, device
        self._opened = 0.0
        self._avatars = {} if avatars is None else avatars  # an empty one may be filled later
        self._rooms = rooms or {}
        self._name = name

    def open(self) -> str:
        """Make the context, load the scene, and draw once so that no client waits for the shaders."""
        from glsplat.gl.context import create_context  # loaded late: the module can be imported without a driver
        from glsplat.net.backends.renderer_pool import RendererPool
        from glsplat.renderer import Renderer
        from glsplat.renderer.read_back import PackBuffers

        self._context = create_context(self._device)
        self._mark = 0
        self._opened = time.monotonic()
        try:
            make = partial(Renderer, size=self._pixels, views=2, config=self._config, context=self._context)
            self._pool = RendererPool(self._scene, self._avatars, make, self._rooms)
            renderer = self._pool.get().renderer
            # a software rasterizer reads back by copying on the same processor: a buffer would be one more copy
            self._buffers = None if self._context.software else PackBuffers(self._context)
            view = Camera(look_at((0, 1.2, 2.0), (0, 1, 0)), pinhole(*self._pixels), *self._pixels)
            renderer.prepare([view, view]).render()
            start = time.perf_counter()
            prepared = renderer.prepare([view, view])  # timed without compiling and sorting
            prepared.render()
            rate = prepared.cost / (time.perf_counter() - start)
            self._slice_cost = max(_MIN_SLICE_COST, rate * _SLICE_S)
        except BaseException:
            self._context.release()
            del self._context
            raise
        return renderer.driver

    def render(self, request: RenderJob) -> Rendered:
        """Draw all eyes of a job. Raises ContextLostError, BudgetError, PoseError.

        Raises FormatError for an avatar that does not exist or cannot be read.
        """
        drawn = self.submit(request)
        return drawn if isinstance(drawn, Rendered) else drawn.collect()

    def submit(self, request: RenderJob) -> Rendered | Submitted:
        """Draw as ``render`` does; a GPU may still draw afterwards. Raises the same errors."""
        if self._name is not None and request.avatar not in ("", self._name) and request.avatar not in self._avatars:
            raise FormatError(f'there is no avatar "{request.avatar}" on this machine')
        first = request.cameras[0]
        try:
            one = self._pool.of(request)
        except Exception:
            self._check_alive()
            raise
        renderer = one.renderer
        budget = PictureBudget(self._max_cost, self._max_time, self._slice_cost, self.abandoned)
        transfer = None if self._buffers is None else self._buffers.transfer()
        try:
            renderer.resize(first.width, first.height)
            one.follow(request, time.monotonic() - self._opened)
            renderer.selector, renderer.step = one.selector(request.viewer), request.mark
            renderer.selector.bias = request.detail
            images = budget.render(one.prepare(request, self._max_cost), self.out, transfer)
            stats, timings = renderer.stats, dict(renderer.timings)
            depth: tuple[DepthGrid, ...] = ()
            if request.options.depth:
                from glsplat.net.backends.scene_renderer import depth_grids  # loaded late: it needs a driver, as above

                start = time.perf_counter()
                depth = depth_grids(renderer, one.views(request))
                timings["depth"] = (time.perf_counter() - start) * 1e3
            if self._context.ctx.error != "GL_NO_ERROR":  # reading it clears it
                raise GlsplatError(f"{renderer.driver} reports an OpenGL error: the picture may be wrong")
            places = one.places(request)
        except Exception as error:
            if transfer is not None:
                transfer.drop()
            if isinstance(error, PoseError | BudgetError):  # nothing was drawn, or the next picture overwrites it
                raise
            self._check_alive()
            renderer.load(one.scene)  # discard partly updated buffers
            renderer.drop_targets()
            raise

        def collect() -> Rendered:
            if transfer is None:
                self._check_alive()
            else:
                start = time.perf_counter()
                try:
                    budget.check()
                    transfer.collect()
                finally:
                    transfer.drop()
                timings["read"] += (time.perf_counter() - start) * 1e3
            written = self._pool.write(request, images)
            return Rendered(
                images,
                timings,
                covered=union(stats.covered, written),
                levels=stats.levels,
                coarsest=stats.coarsest,
                posed=stats.posed,
                places=places,
                depth=depth,
            )

        return collect() if transfer is None or transfer.ready(0.0) else Submitted(transfer.ready, collect)

    def _check_alive(self) -> None:
        """Write a number through the context and read it back.

        A lost context may ignore calls without an error; reading a picture would then return stale memory, such as
        another client's picture.
        """
        self._mark = (self._mark + 1) % 2**32
        expected = self._mark.to_bytes(4, "little")
        red, green, blue, alpha = (byte / 255 for byte in expected)
        self._context.scratch.clear(red, green, blue, alpha)
        if self._context.scratch.read(components=4) != expected:
            raise ContextLostError(f"{self._context.driver} does not respond") from None

    def close(self) -> None:
        """Release the renderer and its context."""
        if hasattr(self, "_context"):
            if self._buffers is not None:
                self._buffers.release()
            self._pool.release()
            self._context.release()
            del self._context
