"""Renderer: draws a scene for any number of views. docs/frame.md explains the steps of a frame."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from types import NoneType
from typing import Literal, Self, overload

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import count, flag, instance, pixels
from glsplat.camera import Camera, passes_of, sorting_camera
from glsplat.config import RenderConfig
from glsplat.errors import ContextError, GlsplatError
from glsplat.gl.context import Context, create_context
from glsplat.gl.owner import ContextGuard, release_later
from glsplat.renderer import checks
from glsplat.renderer.checks import Depths, Images, Pixel, Views
from glsplat.renderer.draw import Slices
from glsplat.renderer.gpu_scene import PASSES, GpuScene
from glsplat.renderer.levels import Selector
from glsplat.renderer.owned import LruCache
from glsplat.renderer.pipeline import Pipeline
from glsplat.renderer.read_back import Transfer, read_depth
from glsplat.renderer.resolve import MAX_TEXTURES, ResolveStep, StepTexture, checked_step
from glsplat.renderer.stats import FrameStats
from glsplat.renderer.targets import FORMATS, Target, TargetPool
from glsplat.scene import Item, Scene, SceneLike
from glsplat.shaders import Programs, Variant
from glsplat.shaders.variant import MAX_VIEWS
from glsplat.skinning.pose import Pose
from glsplat.timing import StageTimer


class Renderer:
    """Draws one scene or avatar for any number of views; create, use and release it on one thread.

    Whatever OpenGL context is current before a call is current after it. Programs with many threads give a renderer
    one thread of its own: docs/python.md, Threads.

    >>> eyes = glsplat.stereo_cameras(np.eye(4), size=(320, 240))
    >>> with glsplat.Renderer(glsplat.default_avatar(), size=(320, 240), views=2) as renderer:
    ...     image = renderer.render(eyes)
    >>> image.shape, image.dtype
    ((2, 240, 320, 4), dtype('uint8'))
    """

    def __init__(
        self,
        scene: SceneLike,
        *,
        size: tuple[int, int] = (1024, 1024),  # width, height
        views: int = 1,  # expected; targets are made for them now instead of with the first frame
        config: RenderConfig | None = None,
        context: Context | None = None,
        timed: bool = False,  # wait for the GPU at every stage mark: exact stages, slower frames
    ) -> None:
        # check all arguments first, so that a refused one leaves no context behind
        views, (width, height) = count(views, "views", GlsplatError, 1), pixels(size, error=GlsplatError)
        config = RenderConfig() if config is None else config
        self.config: RenderConfig = instance(config, RenderConfig, "config", GlsplatError)
        instance(context, (Context, NoneType), "context", GlsplatError, "create_context(given=...) makes one")
        waits, scene = flag(timed, "timed", GlsplatError), Scene.of(scene)
        self.selector: Selector = Selector()  # of the viewer; each of several viewers has its own
        self.step: ResolveStep | None = None  # draws into 8-bit pictures, such as a Watermark
        self._staged: GpuScene | None = None
        self.stats: FrameStats = FrameStats(0, 0, 0)
        self.variant: Variant = Variant()  # of the last pass
        self.size: tuple[int, int] = (0, 0)
        self._owns_context = context is None
        self.context: Context = context or create_context()
        self.context.owner.check("Renderer()")
        self._programs = Programs(self.context.ctx)
        self.timer: StageTimer = StageTimer(self.context.ctx.finish if waits else None)
        self._targets = TargetPool(self.context, self.target_dtype)
        self._textures: LruCache[ResolveStep, StepTexture] = LruCache(MAX_TEXTURES, 2**30)  # of recently used steps
        self._prepared: Prepared | None = None  # valid until the next call
        self._released = False
        if self.context.state is not None and (self.config.sorter != "cpu" or self.config.debug.fetch != "attributes"):
            self.context.state.include_storage()
        try:
            with self.context.entered("Renderer()"):
                checks.check_driver(self.config, self.context)
                self._resize(width, height)
                self._load(scene)
                self._targets.float_target(self.size, min(views, MAX_VIEWS))
            if self._owns_context:
                self.context.owner.leave()  # a new context stays current where none was
        except BaseException:
            self.release()
            raise

    @property
    def driver(self) -> str:
        """Renderer and version strings of the driver."""
        return self.context.driver

    @property
    def timings(self) -> dict[str, float]:
        """Milliseconds per stage of the last frame: skin, key, sort, project, draw, resolve, read, total."""
        return self.timer.ms

    @property
    def target_dtype(self) -> str:
        """moderngl dtype of the target: the configured one, else f2 on GPUs, f4 on software rasterizers (fast: f1).

        Mesa's software rasterizers round when they blend 8 bits; GPUs may cut off, and low opacities would band.
        """
        chosen = {"auto": "32f", "fast": "8"} if self.context.software else {"auto": "16f", "fast": "16f"}
        return FORMATS[chosen.get(self.config.target, self.config.target)]

    @property
    def programs_compiled(self) -> int:
        """Programs compiled so far."""
        return len(self._programs)

    def nbytes(self) -> dict[str, int]:
        """Return GPU bytes: splats, meshes, sh, work (order, records; one set per variant in use), targets.

        Bone textures and uniform blocks are not counted; they do not grow with the splats.
        """
        self._check("nbytes")
        staged = self._staged.nbytes() if self._staged else dict.fromkeys(("splats", "meshes", "sh", "work"), 0)
        return staged | {"targets": self._targets.nbytes + self._textures.nbytes}

    def load(self, scene: SceneLike) -> None:
        """Replace the scene. If uploading the new one fails, the old one stays."""
        with self._entered("load"):
            self._load(Scene.of(scene))

    def resize(self, width: int, height: int) -> None:
        """Set the size of all views in pixels. Targets of the last few sizes are kept: see drop_targets()."""
        self._check("resize")
        self._resize(*pixels((width, height), error=ContextError))

    def _resize(self, width: int, height: int) -> None:
        limit = self.context.max_size
        if max(width, height) > limit:
            raise ContextError(f"size needs 1 to {limit} pixels a side on {self.driver}, not {width}x{height}")
        self.size = (width, height)
        self._prepared = None

    def drop_targets(self) -> None:
        """Release all targets; the next frame makes new ones."""
        with self._entered("drop_targets"):
            self._targets.release()

    @overload
    def render(
        self, views: Views, pose: Pose | None = ..., *, depth: Literal[False] = ..., out: NDArray[Pixel] | None = ...
    ) -> NDArray[Pixel]: ...

    @overload
    def render(
        self, views: Views, pose: Pose | None = ..., *, depth: Literal[True], out: NDArray[Pixel] | None = ...
    ) -> tuple[NDArray[Pixel], NDArray[np.float32]]: ...

    def render(
        self,
        views: Views,
        pose: Pose | None = None,  # of the one avatar; default: the item's own, else zero; ignored without a skeleton
        *,
        depth: bool = False,  # also return expected depths
        out: NDArray[Pixel] | None = None,  # [V, H, W, 4] where the images go; default: a new array
    ) -> NDArray[Pixel] | tuple[NDArray[Pixel], NDArray[np.float32]]:
        """Return the images [V, H, W, 4], row 0 at the top: RGB over the background and accumulated alpha.

        Colours are multiplied by their alpha already (premultiplied); ``glsplat.straight(image)`` divides it out again,
        for PNG files and image libraries. float32 (unclipped) or uint8 by ``config.output``. With ``depth`` also
        [V, H, W] float32: camera z in metres, the mean of the splats and meshes of a pixel by their weight; 0 where
        nothing was drawn. The arrays are new with each call, except ``out``. Raises PoseError for a pose that does not
        fit, GlsplatError for all else; a failed call leaves the renderer unchanged.
        """
        depth, cameras = flag(depth, "depth", GlsplatError), self._views(views)
        with self._entered("render"):
            cameras = self._update(cameras, pose)
            images, depths = self._pictures(cameras, out, depth)
        return (images, depths) if depth else images

    def prepare(self, views: Views, pose: Pose | None = None, itemised: bool = False) -> Prepared:
        """Do the steps of ``render()`` before the draw; return the picture with its cost, also ``itemised`` by item.

        >>> with glsplat.Renderer(glsplat.default_avatar(), size=(32, 24), views=2) as renderer:
        ...     prepared = renderer.prepare(glsplat.stereo_cameras(np.eye(4), size=(32, 24)))
        ...     image = prepared.render() if prepared.cost < 1e9 else None
        """
        cameras, costed = self._views(views), 1 + flag(itemised, "itemised", GlsplatError)
        with self._entered("prepare"):
            cameras = self._update(cameras, pose)
            self._prepared = prepared = Prepared(self, cameras)
            for ordinal, indices in enumerate(self._passes(cameras)):
                batch = [cameras[i] for i in indices]
                self._scene.mesh_pass(batch, ordinal, self.target_dtype, self.timer)
                prepared.cost += self._scene.add_costs(self._sorted(batch, ordinal, costed=costed), prepared.items)
            return prepared

    def draw(self, views: Views, pose: Pose | None = None, *, depth: bool = False) -> Target:
        """Draw one view or a pair; return the float target on the GPU, layer 0 the left eye, row 0 at the top.

        For windows and headsets. The layers hold the pictures of ``render()``, with ``depth`` also its sums
        (``Target.depth``, in units of ``Target.depth_unit``). The target belongs to the renderer and is overwritten by
        the next call. If hidden splats were left out, the caller has to compensate for them (``Target.lift``,
        lift.glsl).
        """
        depth, cameras = flag(depth, "depth", GlsplatError), self._views(views)
        if len(cameras) > 2:
            raise GlsplatError(f"draw() takes one view or a pair, not {len(cameras)}; render() takes any number")
        with self._entered("draw"):
            cameras = self._update(cameras, pose)
            for layers, batch, _, target in self._drawn(cameras, depth):
                if len(batch) < len(cameras):  # eyes that do not share an order: copied one by one into a pair
                    pair = self._targets.float_target(self.size, len(cameras), depth)
                    pair.copy_layer(self.context.ctx, layers.start, target)
                    target = pair
            target.depth_unit = self._scene.size
            target.lift = tuple(camera.background for camera in cameras) if self.variant.cull_hidden else None
            self.timer.stop()
            return target

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

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def __del__(self) -> None:
        if not getattr(self, "_released", True):
            splats = self._staged.splats if self._staged else 0
            label = f"a {type(self).__name__} ({splats} splats, {self.size[0]}x{self.size[1]})"
            release_later(label, self.context.owner, self._forget, self._owns_context)

    def _load(self, scene: Scene) -> None:
        made = GpuScene(self.context, self._programs, scene, self.config)
        old, self._staged = self._staged, made
        if old is not None:
            old.release()

    @property
    def _scene(self) -> GpuScene:
        if self._staged is None:
            raise GlsplatError("this renderer has no scene: load() did not finish; call it again")
        return self._staged

    def _check(self, call: str) -> None:
        """Raise GlsplatError for a released renderer, ContextError on a wrong thread or within another call."""
        if self._released:
            raise GlsplatError("this renderer was released; make a new one")
        self.context.owner.check(f"Renderer.{call}()")

    def _entered(self, call: str) -> ContextGuard:
        self._check(call)
        self._prepared = None
        return self.context.entered(f"Renderer.{call}()")

    def _views(self, views: Views) -> list[Camera]:
        return checks.checked_views(views, self.size, "; call resize() first")

    def _passes(self, cameras: Sequence[Camera]) -> list[list[int]]:
        """Return the indices of the views of each pass."""
        return passes_of(cameras, self.config.debug.order == "shared")

    def _order(self, cameras: Sequence[Camera]) -> NDArray[np.float64]:
        """Return the viewmat [4, 4] whose z orders the splats of a pass."""
        return sorting_camera(cameras)

    def _update(self, cameras: Sequence[Camera], pose: Pose | None) -> list[Camera]:
        """Begin a frame: upload, pose and place the items that changed. Return the cameras in the scene's own space."""
        self.timer.start()
        selector = instance(self.selector, Selector, "selector", GlsplatError)
        placed, self.stats = self._scene.update(cameras, pose, selector, self.timer)
        return placed

    def _pictures(
        self,
        cameras: Sequence[Camera],
        out: Images | None,
        depth: bool = False,
        slices: Slices | None = None,
        transfer: Transfer | None = None,
    ) -> tuple[Images, Depths]:
        """Draw, resolve and read back (docs/frame.md), once the scene is up to date."""
        boxed, size, timer = self.config.output == "uint8", self.size, self.timer
        out = checks.checked_out(out, (len(cameras), size[1], size[0], 4), np.uint8 if boxed else np.float32)
        depths = np.empty(out.shape[:3] if depth else 0, np.float32)
        step = checked_step(self.step, boxed)
        texture = None if step is None else self._textures.get(step, lambda: StepTexture(self.context, step)).texture
        if transfer is not None:
            transfer.begin(out.nbytes)
        for layers, batch, pipeline, target in self._drawn(cameras, depth, boxed, slices):
            byte_target = self._targets.byte_target(size, len(batch)) if boxed else None
            if byte_target is not None:
                pipeline.resolve(target, byte_target, batch, timer, step, texture)  # 5
            pipeline.read(target, byte_target, batch, out[layers], timer, transfer)  # 6
            if depth:
                depths[layers] = read_depth(target) * np.float32(self._scene.size)
                timer.mark("read")
        if transfer is not None:
            transfer.end()
        timer.stop()
        return out, depths

    def _drawn(
        self, cameras: Sequence[Camera], depth: bool = False, boxed: bool = False, slices: Slices | None = None
    ) -> Iterator[tuple[slice, list[Camera], Pipeline, Target]]:
        """Draw pass by pass, each of one view or a pair. ``slices``: prepare() made most records already."""
        scene = self._scene
        for ordinal, indices in enumerate(self._passes(cameras)):
            batch, layers = [cameras[i] for i in indices], slice(indices[0], indices[0] + len(indices))
            # meshes by a depth buffer: splats are drawn over them and tested against them
            mesh_pass = scene.mesh_pass(batch, ordinal, self.target_dtype, self.timer, depth)
            pipeline = self._sorted(batch, ordinal, depth, slices is not None, done=slices is not None)  # 1 to 3
            target = self._targets.float_target(self.size, len(batch), depth)
            pipeline.draw(target, batch, self.timer, boxed, mesh_pass, slices)  # 4
            yield layers, batch, pipeline, target
            self.stats = pipeline.added(self.stats)

    def _sorted(
        self, cameras: Sequence[Camera], ordinal: int, depth: bool = False, costed: int = 0, done: bool = False
    ) -> Pipeline:
        """Do steps 1 to 3 (key, sort, project) of pass number ``ordinal``, and return its pipeline."""
        pipeline = self._scene.pipeline(cameras, ordinal, depth)
        shared = ordinal >= PASSES - 1  # with later passes of the call
        if shared or not done:
            light = self._scene.light
            resorted = pipeline.make_records(cameras, self._order(cameras), self.timer, costed, shared, light)
            self.stats = replace(self.stats, sorted=self.stats.sorted or resorted)
        self.variant = pipeline.variant
        return pipeline

    def _drop_scene(self) -> None:
        staged, self._staged = self._staged, None  # first: a half-released scene must not be used again
        if staged is not None:
            staged.release()

    def _free(self, stack: ExitStack) -> None:
        """Add to ``stack`` the release of everything that this renderer made."""
        for owner in (self._programs, self._textures, self._targets):
            stack.callback(owner.release)
        stack.callback(self._drop_scene)

    def _forget(self) -> None:
        """Release a renderer that was dropped. Its own context lives on while others hold it."""
        if not self._released and not self.context.released:
            with self.context.entered("Renderer.release()"), ExitStack() as stack:
                self._free(stack)
        self._released = True
        if self._owns_context:
            self.context.break_cycle()


class Prepared:
    """Pictures ready to be drawn, until the renderer's next call. Made by ``Renderer.prepare()``."""

    def __init__(self, renderer: Renderer, cameras: Sequence[Camera]) -> None:
        self._renderer, self._cameras = renderer, cameras
        self.cost: int = 0
        """Covered pixels: summed over views and splats, those of the box around the splat in whole blocks of 4x4."""
        self.items: dict[Item, int] = {}
        """Covered pixels of each shown item of splats, if ``itemised``."""

    def render(
        self,
        *,
        out: NDArray[Pixel] | None = None,  # as of Renderer.render()
        between: Callable[[], None]
        | None = None,  # called between two slices; an exception that it raises ends the picture
        slice_cost: float = math.inf,  # covered pixels of a pass; a costlier pass is drawn in slices of about that
        transfer: Transfer | None = None,  # 8-bit images are valid once it is collected, also after further calls
    ) -> NDArray[Pixel]:
        """Return the images of ``Renderer.render()``, the same bytes whatever the slices."""
        renderer = self._renderer
        if renderer._prepared is not self:
            raise GlsplatError("the renderer did something else since prepare(), or drew this already; prepare() again")
        with renderer._entered("render"):
            return renderer._pictures(self._cameras, out, False, Slices(between, slice_cost), transfer)[0]
