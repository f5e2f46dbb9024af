"""Renderer: a scene, a context and the passes of a frame.

``render()`` is the frame; what each step is for is in docs/frame.md.
"""

from __future__ import annotations

from collections.abc import Collection, Hashable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from types import NoneType, TracebackType
from typing import Any, Literal, Unpack, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glsplat.arrays import count, flag, instance, pixels
from glsplat.camera import Camera, passes_of, sorting_camera
from glsplat.config import RenderConfig
from glsplat.errors import ContextError, GlsplatError
from glsplat.gl.context import Context, create_context
from glsplat.gl.owner import Entry, abandon
from glsplat.passes import views as checks
from glsplat.passes.frame.budget import Budget
from glsplat.passes.frame.pipeline import Pipeline
from glsplat.passes.item.levels import Look
from glsplat.passes.marks import Marks
from glsplat.passes.staged import Staged
from glsplat.passes.stats import FrameStats
from glsplat.passes.target import FORMATS, Target
from glsplat.passes.target_pool import TargetPool
from glsplat.renderer_thread import RendererThread, RenderOptions
from glsplat.scene import Item, Scene, Shown
from glsplat.shaders import Programs, Variant
from glsplat.shaders.variant import MAX_VIEWS
from glsplat.skinning.pose import Pose
from glsplat.timing import StageTimer
from glsplat.watermark.mark import Mark

__all__ = ["FrameStats", "Renderer"]


class Renderer:
    """Renders one scene or avatar for any number of views; create, use and release it on one thread.

    Whatever OpenGL context is current before a call is current after it. ``run_in_thread()`` serves many threads.

    >>> eyes = glsplat.stereo_cameras(np.eye(4), size=(320, 240))
    >>> with glsplat.Renderer(glsplat.default_avatar(), size=(320, 240), views=2) as renderer:
    ...     image = renderer.render(eyes)
    >>> image.shape, image.dtype
    ((2, 240, 320, 4), dtype('uint8'))
    """

    def __init__(
        self,
        scene: Shown,
        *,
        size: tuple[int, int] = (1024, 1024),  # width, height
        views: int = 1,  # expected; targets are made for them now instead of with the first frame
        config: RenderConfig | None = None,
        context: Context | None = None,
        timed: bool = False,  # wait for the GPU at every stage mark: exact stages, slower frames
    ) -> None:
        # all arguments first: what is refused must leave nothing behind, a context least of all
        views, (width, height) = count(views, "views", GlsplatError, 1), pixels(size, error=GlsplatError)
        config = RenderConfig() if config is None else config
        self.config: RenderConfig = instance(config, RenderConfig, "config", GlsplatError)
        instance(context, (Context, NoneType), "context", GlsplatError, "create_context(given=...) makes one")
        waits, scene = flag(timed, "timed", GlsplatError), Scene.of(scene)
        self._staged: Staged | None = None
        self.stats: FrameStats = FrameStats(0, 0, 0)
        self.variant: Variant = Variant()  # of the last pass
        self.size: tuple[int, int] = (0, 0)
        self._owns_context = context is None
        self.context: Context = context or create_context()
        self.context.owner.check("Renderer()")
        self._programs = Programs(self.context.ctx)
        self.timer: StageTimer = StageTimer(self.context.ctx.finish if waits else None)
        self._targets = TargetPool(self.context, self.target_dtype)
        self._marks = Marks(self.context)
        self._released = False
        if self.context.state is not None and (self.config.sorter != "cpu" or self.config.fetch != "attributes"):
            self.context.state.look_after_storage()
        try:
            with self.context.entered("Renderer()"):
                self._open(scene, width, height, views)
            if self._owns_context:
                self.context.owner.leave()  # a new context stays current where none was
        except BaseException:
            self.release()
            raise

    @classmethod
    def run_in_thread(cls, scene: Shown, **options: Any) -> RendererThread[Renderer]:
        """A renderer on a thread of its own, with the options of ``Renderer()``: all threads may call it.

        ::

            with Renderer.run_in_thread(avatar, size=(512, 512)) as renderer:
                images = await asyncio.to_thread(renderer.render, [camera], pose)
        """
        return RendererThread(cls, scene, options)

    @property
    def driver(self) -> str:
        """Renderer and version strings of the driver."""
        return self.context.driver

    @property
    def timings(self) -> dict[str, float]:
        """Milliseconds a stage of the last frame: skin, key, sort, project, draw, resolve, read, total."""
        return self.timer.ms

    @property
    def target_dtype(self) -> str:
        """moderngl dtype of the float target: f4 on software rasterizers, f2 on GPUs, unless the config says."""
        if self.config.target == "auto":
            return FORMATS["32f" if self.context.software else "16f"]
        return FORMATS[self.config.target]

    @property
    def programs_compiled(self) -> int:
        """Programs compiled so far."""
        return len(self._programs)

    def nbytes(self) -> dict[str, int]:
        """GPU bytes: splats, sh, work (keys, order, records, posed; one set a variant in use), targets.

        Not counted: the bone texture and the uniform blocks, which do not grow with the splats.
        """
        self._check("nbytes")
        staged = self._staged.nbytes() if self._staged else {"splats": 0, "meshes": 0, "sh": 0, "work": 0}
        return staged | {"targets": self._targets.nbytes + self._marks.nbytes}

    def load(self, scene: Shown) -> None:
        """Replace the scene. The old one is kept until the new one is on the GPU, and stays if that fails."""
        with self._entered("load"):
            self._load(Scene.of(scene))

    def resize(self, width: int, height: int) -> None:
        """Set the size of all views in pixels. Targets of a few sizes used before are kept: see drop_targets()."""
        self._check("resize")
        self._resize(*pixels((width, height), error=ContextError))

    def _resize(self, width: int, height: int) -> None:
        limit = self.context.max_size
        if max(width, height) > limit:
            raise ContextError(f"size needs 1 to {limit} pixels a side on {self.driver}, not {width}x{height}")
        self.size = (width, height)

    def drop_targets(self) -> None:
        """Give back the memory of all targets; the next frame makes its own."""
        with self._entered("drop_targets"):
            self._targets.release()

    @overload
    def render(
        self,
        cameras: Sequence[Camera],
        pose: Pose | None = ...,
        *,
        depth: Literal[False] = ...,
        **options: Unpack[RenderOptions],
    ) -> NDArray[Any]: ...

    @overload
    def render(
        self,
        cameras: Sequence[Camera],
        pose: Pose | None = ...,
        *,
        depth: Literal[True],
        **options: Unpack[RenderOptions],
    ) -> tuple[NDArray[Any], NDArray[np.float32]]: ...

    def render(
        self,
        cameras: Sequence[Camera],
        pose: Pose | None = None,  # of the one avatar; default: the item's own, else zero; ignored without a skeleton
        *,
        sort_viewmat: ArrayLike | None = None,  # [4, 4] orders all views; default: see docs/frame.md
        budget: Budget | None = None,  # what this picture may cost; none: whatever it takes
        depth: bool = False,  # return expected depths beside the images
        out: NDArray[Any] | None = None,  # [V, H, W, 4] where the images go; default: a new array
        viewer: Hashable = None,  # who looks, where several do in turn: their levels of detail are kept apart
        lod_bias: float = 0.0,  # added to that of the config; -8 to 8
        without: Collection[Item] = (),  # items that this picture leaves out; others are not staged anew for it
        mark: Mark | None = None,  # drawn into uint8 pictures where alpha is not 0 (docs/watermark.md)
    ) -> NDArray[Any] | tuple[NDArray[Any], NDArray[np.float32]]:
        """The images [V, H, W, 4], row 0 at the top: RGB over the background and accumulated alpha.

        Colours are multiplied by their alpha already (premultiplied); ``glsplat.straight(image)`` divides it out again,
        for PNG files and image libraries. float32 (unclipped) or uint8 by ``config.output``. With ``depth`` also
        [V, H, W] float32: camera z in metres, the mean of what a pixel shows by its weight in the picture, meshes
        included; 0 where alpha is 0; a 16F target is centimetres off where alpha is small, and one of 8 bits has none.
        The arrays are new with each call, but for ``out``. Raises PoseError for a pose that does not fit, BudgetError
        for a picture beyond its budget, GlsplatError for all else: the next one is drawn as if it had not been asked.
        """
        order, lod_bias = checks.checked_order(sort_viewmat), checks.checked_bias(lod_bias)
        depth, cameras = checks.checked_depth(depth, self.target_dtype), self._views(cameras)
        instance(budget, (Budget, NoneType), "budget", GlsplatError)
        with self._entered("render"):
            boxed = self.config.output == "uint8"
            tile = None if mark is None else self._marks.tile(checks.checked_mark(mark, boxed))
            self._begin(pose, cameras, viewer, lod_bias, checks.checked_without(without, self._scene.scene))
            shape = (len(cameras), self.size[1], self.size[0], 4)
            out = checks.checked_out(out, shape, np.uint8 if boxed else np.float32)
            depths = np.empty(out.shape[:3] if depth else 0, np.float32)
            for ordinal, batch in enumerate(passes_of(cameras, self.config.order == "shared" or order is not None)):
                views, mine = [cameras[i] for i in batch], slice(batch[0], batch[0] + len(batch))
                pipeline, target = self._draw(views, order, boxed, ordinal, budget, depth)
                byte_target = self._targets.byte_target(self.size, len(views)) if boxed else None
                pipeline.read(target, byte_target, views, out[mine], self.timer, tile)
                if depth:
                    depths[mine] = target.read_depth()
                    self.timer.mark("read")
                self.stats = pipeline.added(self.stats)
            self.timer.stop()
            return (out, depths) if depth else out

    def draw(self, cameras: Sequence[Camera], pose: Pose | None = None) -> Target:
        """Draw one view or a pair and leave it on the GPU: the float target, layer 0 the left eye, row 0 at the top.

        For windows: nothing is read back. The layers hold what ``render()`` makes of the same views. The target
        belongs to the renderer and is overwritten by the next call. Where hidden splats were left out it is not lifted
        yet (``Target.lift``; Present does it).
        """
        cameras = self._views(cameras)
        if len(cameras) > 2:
            raise GlsplatError(f"draw() takes one view or a pair, not {len(cameras)}; render() takes any number")
        with self._entered("draw"):
            self._begin(pose, cameras)
            passes = passes_of(cameras, self.config.order == "shared")
            for ordinal, batch in enumerate(passes):
                views = [cameras[i] for i in batch]
                pipeline, target = self._draw(views, None, boxed=False, ordinal=ordinal)
                if len(passes) > 1:  # eyes that do not share an order: drawn one by one into the pair's layers
                    pair = self._targets.float_target(self.size, len(cameras))
                    pair.copy_layer(self.context.ctx, batch[0], target)
                    target = pair
                self.stats = pipeline.added(self.stats)
            lifted = pipeline.variant.cull_hidden
            target.lift = tuple(camera.background for camera in cameras) if lifted else None
            self.timer.stop()
            return target

    def redraw(self, cameras: Sequence[Camera]) -> float:
        """Step 4 alone on the records the last call left, for one view or a pair: milliseconds until the GPU is done.

        The draw floor: what the picture costs once everything before it is known (``glsplat bench``). Raises
        GlsplatError for views that are not drawn in one pass.
        """
        cameras = self._views(cameras)
        if len(passes_of(cameras, self.config.order == "shared")) > 1:
            raise GlsplatError("redraw() takes views of one pass: one view, or a pair that looks the same way")
        with self._entered("redraw"):
            pipeline, target = self._scene.pipeline(cameras, 0), self._targets.float_target(self.size, len(cameras))
            ground = self._scene.ground(cameras, 0, self.target_dtype, self.timer)
            self.context.ctx.finish()
            timer = StageTimer(self.context.ctx.finish)
            timer.start()
            pipeline.draw(target, cameras, timer, self.config.output == "uint8", ground=ground)
            return timer.ms["draw"]

    def posed(self) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
        """What the skin pass made of the last pose: world means [N, 3] and shapes M [N, 3, 3], Sigma = M M^T.

        Read back for measurements. N leaves out the splats in ``stats.skipped``. Raises GlsplatError for a scene that
        is not skinned or not rendered yet.
        """
        with self._entered("posed"):
            arena = self._scene.arena
            if not (arena.posed and arena.written()):
                why = "this scene is not skinned or not rendered yet"
                raise GlsplatError(f"posed() needs an avatar that was rendered; {why}")
            return arena.read()

    def release(self) -> None:
        """Delete every GL object, and the context if it was made here. May be called twice."""
        if self._released:
            return
        with ExitStack() as stack:
            if not (self.context.released or self.context.owner.forked):
                self.context.owner.check("Renderer.release()")
                if self._owns_context:
                    stack.callback(self.context.release)
                with self.context.entered("Renderer.release()"), ExitStack() as own:
                    self._free(own)
            self._owns_context, self._released = False, True

    def __enter__(self) -> Renderer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()

    def __del__(self) -> None:
        if not getattr(self, "_released", True):
            splats = self._staged.splats if self._staged else 0
            label = f"a Renderer ({splats} splats, {self.size[0]}x{self.size[1]})"
            abandon(label, self.context.owner, self._forget, self._owns_context)

    def _open(self, scene: Scene, width: int, height: int, views: int) -> None:
        """Check what the driver can do, and make what does not wait for the first frame."""
        geometry = self.config.layers == "geometry"
        if self.config.layers == "vertex" and not self.context.vertex_layers:
            raise ContextError(f"{self.driver} cannot write gl_Layer in the vertex shader; use layers='geometry'")
        if self.config.sorter == "gpu" and not self.context.compute:
            raise ContextError(f"the GPU sorter needs OpenGL 4.3, this is {self.driver}; use sorter='cpu'")
        if self.config.fetch == "storage" and not self.context.vertex_storage:
            raise ContextError(f"{self.driver} has no storage buffers in the vertex shader; use fetch='attributes'")
        self._geometry = geometry or not self.context.vertex_layers
        self._triangle = self.config.shape == "triangle" or (self.config.shape == "auto" and self.context.software)
        self._resize(width, height)
        self._load(scene)
        self._targets.float_target(self.size, min(views, MAX_VIEWS))

    def _load(self, scene: Scene) -> None:
        made = Staged(self.context, self._programs, scene, self.config, self._geometry, self._triangle)
        old, self._staged = self._staged, made
        if old is not None:
            old.release()

    @property
    def _scene(self) -> Staged:
        if self._staged is None:
            raise GlsplatError("this renderer has no scene: load() did not finish; call it again")
        return self._staged

    def _check(self, call: str) -> None:
        """Raise what a call raises that cannot be done here and now."""
        if self._released:
            raise GlsplatError("this renderer was released; make a new one")
        self.context.owner.check(f"Renderer.{call}()")

    def _entered(self, call: str) -> Entry:
        self._check(call)
        return self.context.entered(f"Renderer.{call}()")

    def _views(self, cameras: Sequence[Camera]) -> list[Camera]:
        return checks.checked_views(cameras, self.size, "; call resize() first")

    def _begin(
        self,
        pose: Pose | None,
        cameras: Sequence[Camera],
        viewer: Hashable = None,
        lod_bias: float = 0.0,
        without: frozenset[int] = frozenset(),  # by id()
    ) -> None:
        self.timer.start()
        scene = self._scene
        before = scene.runs
        scene.update(pose, self.timer, Look(tuple(cameras), viewer, self.config.lod_bias + lod_bias), without)
        posed, levels = scene.runs - before, scene.levels
        self.stats = FrameStats(
            scene.splats, 0, scene.skipped, sorted=False, posed=posed, levels=levels, coarsest=scene.coarsest
        )

    def _draw(
        self,
        views: Sequence[Camera],
        sort_viewmat: NDArray[np.float64] | None,
        boxed: bool,
        ordinal: int = 0,  # of the pass in this call
        budget: Budget | None = None,
        depth: bool = False,
    ) -> tuple[Pipeline, Target]:
        """Steps 1 to 4 for one pass."""
        ground = self._scene.ground(views, ordinal, self.target_dtype, self.timer, depth)
        pipeline = self._scene.pipeline(views, ordinal, depth)
        target = self._targets.float_target(self.size, len(views), depth)
        order = sorting_camera(views) if sort_viewmat is None else sort_viewmat
        resorted = pipeline.geometry(views, order, self.timer, budget, self._scene.shared(ordinal))
        pipeline.draw(target, views, self.timer, boxed, budget, ground)
        self.variant = pipeline.variant
        self.stats = replace(self.stats, sorted=self.stats.sorted or resorted)
        return pipeline, target

    def _drop_scene(self) -> None:
        staged, self._staged = self._staged, None  # forgotten first: what is broken off must not be used again
        if staged is not None:
            staged.release()

    def _free(self, stack: ExitStack) -> None:
        """Delete what this renderer made, whatever fails, when ``stack`` closes."""
        for free in (self._programs.release, self._marks.release, self._targets.release, self._drop_scene):
            stack.callback(free)

    def _forget(self) -> None:
        """Release what was dropped. A context of its own goes with whoever still holds it."""
        if not self._released and not self.context.released:
            with self.context.entered("Renderer.release()"), ExitStack() as stack:
                self._free(stack)
        self._released = True
        if self._owns_context:
            self.context.loosen()
