"""Renderer: a scene, a context and the passes of a frame.

``render()`` is the frame, one commented step a line; what each step is for is in docs/frame.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glsplat.arrays import own
from glsplat.avatar import Avatar
from glsplat.camera import Camera, passes_of, sorting_camera
from glsplat.config import RenderConfig
from glsplat.context import Context, create_context
from glsplat.errors import ContextError, GlsplatError, PoseError
from glsplat.passes.pipeline import Pipeline
from glsplat.passes.scene import SceneBuffers
from glsplat.passes.target import FORMATS, Target
from glsplat.passes.target_pool import TargetPool
from glsplat.shaders import Programs, Variant, variant_for
from glsplat.shaders.variant import MAX_VIEWS
from glsplat.skinning.pose import Pose
from glsplat.splats import Splats
from glsplat.timing import StageTimer

__all__ = ["FrameStats", "Renderer"]


@dataclass(frozen=True)
class FrameStats:
    """What one call of render() did."""

    splats: int  # in the scene
    drawn: int  # of them, summed over the passes of the call
    skipped: int  # not finite or without a rotation: never uploaded
    culled: dict[str, int] = field(default_factory=dict)  # by reason
    sorted: bool = True  # False where the previous order still held
    covered: tuple[int, int, int, int] = (0, 0, 0, 0)  # x, y, width, height outside of which is only background


class Renderer:
    """Renders one scene or avatar for any number of views; create, use and release it on one thread.

    >>> eyes = glsplat.stereo_cameras(np.eye(4), size=(320, 240))
    >>> with glsplat.Renderer(glsplat.default_avatar(), size=(320, 240), views=2) as renderer:
    ...     image = renderer.render(eyes)
    >>> image.shape, image.dtype
    ((2, 240, 320, 4), dtype('uint8'))
    """

    def __init__(
        self,
        scene: Splats | Avatar,
        *,
        size: tuple[int, int] = (1024, 1024),  # width, height
        views: int = 1,  # expected; targets are made for them now instead of with the first frame
        config: RenderConfig | None = None,
        context: Context | None = None,
        timed: bool = False,  # wait for the GPU at every stage mark: exact stages, slower frames
    ) -> None:
        if views < 1:
            raise GlsplatError(f"views needs at least 1, not {views}")
        self.config: RenderConfig = config or RenderConfig()
        self._released = False
        self._owns_context = context is None
        self.context: Context = context or create_context()
        self._programs = Programs(self.context.ctx)
        self.timer: StageTimer = StageTimer(self.context.ctx.finish if timed else None)
        self._scene: SceneBuffers | None = None
        self._pipelines: dict[Variant, Pipeline] = {}
        self._targets = TargetPool(self.context, self.target_dtype)
        self.stats: FrameStats = FrameStats(0, 0, 0)
        self.variant: Variant = Variant()  # of the last pass
        self.size: tuple[int, int] = (0, 0)
        try:
            geometry = self.config.layers == "geometry"
            if self.config.layers == "vertex" and not self.context.vertex_layers:
                raise ContextError(f"{self.driver} cannot write gl_Layer in the vertex shader; use layers='geometry'")
            if self.config.sorter == "gpu" and not self.context.compute:
                raise ContextError(f"the GPU sorter needs OpenGL 4.3, this is {self.driver}; use sorter='cpu'")
            self._geometry = geometry or not self.context.vertex_layers
            automatic = self.config.shape == "auto" and self.context.software
            self._triangle = automatic or self.config.shape == "triangle"
            self.resize(*size)
            self.load(scene)
            self._targets.float_target(self.size, min(views, MAX_VIEWS))
        except BaseException:
            self.release()
            raise

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
        scene = self._scene
        return {
            "splats": scene.nbytes if scene else 0,
            "sh": scene.sh_nbytes if scene else 0,
            "work": sum(p.nbytes for p in self._pipelines.values()),
            "targets": self._targets.nbytes,
        }

    def load(self, scene: Splats | Avatar) -> None:
        """Replace the scene; the old one's buffers are released."""
        self._check()
        avatar = scene if isinstance(scene, Avatar) else None
        splats = avatar.splats if avatar else scene
        if not isinstance(splats, Splats):
            raise GlsplatError(f"a scene is Splats or an Avatar, not {type(scene).__name__}")
        if self.config.cull_hidden and splats.cones is None:
            raise GlsplatError(
                "cull_hidden needs splats with visibility cones, this scene has none; "
                "make them (glsplat avatar cones, glsplat.skinning.cones.with_cones) or leave cull_hidden off"
            )
        self._drop_scene()
        skin = avatar.skin if avatar else None
        if avatar is not None and self.config.influences:
            skin = avatar.skin.reduced(self.config.influences).anchored(avatar.skeleton.parents)
        self._avatar = avatar
        self._degree = min(splats.sh_degree, self.config.sh_degree)
        joints = len(avatar.skeleton) if avatar else 0
        if joints > self.context.max_size:
            raise ContextError(f"{joints} joints, but a texture of {self.driver} holds {self.context.max_size}")
        self._antialias = splats.antialias
        self._scene = SceneBuffers(self.context.ctx, splats, skin, joints, self._degree, self.config.cull_hidden)
        self._splat_count = len(splats)
        self._geometry_version = 0
        self._last_bones: NDArray[np.float64] | None = None

    def resize(self, width: int, height: int) -> None:
        """Set the size of all views in pixels. Targets of a few sizes used before are kept: see drop_targets()."""
        limit = self.context.max_size
        if not (0 < width <= limit and 0 < height <= limit):
            raise ContextError(f"size needs 1 to {limit} pixels a side on {self.driver}, not {width}x{height}")
        self.size = (width, height)

    def drop_targets(self) -> None:
        """Give back the memory of all targets; the next frame makes its own."""
        self._targets.release()

    def render(
        self,
        cameras: Sequence[Camera],
        pose: Pose | None = None,  # zero pose if none; ignored by a scene without a skeleton
        *,
        sort_viewmat: ArrayLike | None = None,  # [4, 4] orders all views; default: see docs/frame.md
    ) -> NDArray[Any]:
        """The images [V, H, W, 4], row 0 at the top: RGB over the background and accumulated alpha.

        Colours are multiplied by their alpha already (premultiplied); ``glsplat.straight(image)`` divides it out again,
        for PNG files and image libraries. float32 (unclipped) or uint8 by ``config.output``. The array is new with each
        call. Raises PoseError for a pose that does not fit, GlsplatError for cameras of another size.
        """
        order = None if sort_viewmat is None else own(sort_viewmat, np.float64, "sort_viewmat", GlsplatError)
        if order is not None and not (order.shape == (4, 4) and np.isfinite(order).all()):
            raise GlsplatError("sort_viewmat needs 4x4 finite numbers")
        self._begin(cameras, pose)
        out = np.empty((len(cameras), self.size[1], self.size[0], 4), self._output_type())
        passes = passes_of(cameras, self.config.order == "shared" or order is not None)
        for batch in passes:
            views = [cameras[i] for i in batch]
            boxed = self.config.output == "uint8"
            pipeline, target = self._draw(views, order, boxed, alone=len(passes) == 1)
            byte_target = self._targets.byte_target(self.size, len(views)) if self.config.output == "uint8" else None
            pipeline.read(target, byte_target, views, out[batch[0] : batch[0] + len(views)], self.timer)
            self._count(pipeline)
        self.timer.stop()
        return out

    def draw(self, cameras: Sequence[Camera], pose: Pose | None = None) -> Target:
        """Draw one view or a pair and leave it on the GPU: the float target, layer 0 the left eye, row 0 at the top.

        For windows: nothing is read back. The target belongs to the renderer and is overwritten by the next call.
        """
        self._begin(cameras, pose)
        if len(cameras) > 2:
            raise GlsplatError(f"draw() takes one view or a pair, not {len(cameras)}; render() takes any number")
        pipeline, target = self._draw(cameras, None, boxed=False)
        self._count(pipeline)
        self.timer.stop()
        return target

    def redraw(self, cameras: Sequence[Camera]) -> float:
        """Step 4 alone on the records the last call left, for one view or a pair: milliseconds until the GPU is done.

        The draw floor: what the picture costs once everything before it is known (``glsplat bench``).
        """
        pipeline, target = self._pipeline(cameras), self._targets.float_target(self.size, len(cameras))
        self.context.ctx.finish()
        timer = StageTimer(self.context.ctx.finish)
        timer.start()
        pipeline.draw(target, cameras, timer, boxed=self.config.output == "uint8")
        return timer.ms["draw"]

    def posed(self) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
        """What the skin pass made of the last pose: world means [N, 3] and shapes M [N, 3, 3], Sigma = M M^T.

        Read back for measurements. N leaves out the splats in ``stats.skipped``. Raises GlsplatError for a scene that
        is not skinned or not rendered yet.
        """
        skin = self._pipelines[self.variant].skin if self.variant in self._pipelines else None
        if skin is None or self._scene is None:
            raise GlsplatError(
                "posed() needs an avatar that was rendered; this scene is not skinned or not rendered yet"
            )
        means, shapes = skin.read()
        return means + self._scene.origin, shapes

    def release(self) -> None:
        """Delete every GL object, and the context if it was made here. May be called twice."""
        if self._released:
            return
        with ExitStack() as stack:
            if self._owns_context:
                stack.callback(self.context.release)
            stack.callback(self._programs.release)
            stack.callback(self._targets.release)
            stack.callback(self._drop_scene)
        self._owns_context, self._released = False, True

    def __enter__(self) -> Renderer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()

    # ------------------------------------------------------------------------------------------------- internals

    def _check(self) -> None:
        if self._released:
            raise GlsplatError("this renderer was released; make a new one")

    def _begin(self, cameras: Sequence[Camera], pose: Pose | None) -> None:
        self._check()
        if not cameras:
            raise GlsplatError("render needs at least one camera")
        if any((c.width, c.height) != self.size for c in cameras):
            raise GlsplatError(f"cameras need the renderer's size {self.size[0]}x{self.size[1]}; call resize() first")
        assert self._scene is not None
        self.stats = FrameStats(self._splat_count, 0, self._scene.skipped, {}, False)
        self.timer.start()
        self._pose(pose)

    def _draw(
        self, views: Sequence[Camera], sort_viewmat: NDArray[np.float64] | None, boxed: bool, alone: bool = True
    ) -> tuple[Pipeline, Target]:
        """Steps 1 to 4 for one pass."""
        pipeline = self._pipeline(views)
        target = self._targets.float_target(self.size, len(views))
        order = sorting_camera(views) if sort_viewmat is None else sort_viewmat
        resorted = pipeline.geometry(views, order, self._geometry_version, self.timer, alone)
        pipeline.draw(target, views, self.timer, boxed)
        self.variant = pipeline.variant
        self.stats = replace(self.stats, sorted=self.stats.sorted or resorted)
        return pipeline, target

    def _count(self, pipeline: Pipeline) -> None:
        old = self.stats
        culled = {reason: old.culled.get(reason, 0) + count for reason, count in pipeline.culled.items()}
        covered = _union(old.covered, pipeline.covered)
        self.stats = replace(old, drawn=old.drawn + pipeline.drawn, culled=culled, covered=covered)

    def _output_type(self) -> type[np.generic]:
        return np.uint8 if self.config.output == "uint8" else np.float32

    def _pose(self, pose: Pose | None) -> None:
        """Upload the bones if the pose changed, and note that the geometry did."""
        if self._avatar is None:
            return
        skeleton = self._avatar.skeleton
        pose = pose or Pose.zero(len(skeleton))
        if len(pose.rotations) != len(skeleton):
            raise PoseError(f"the pose has {len(pose.rotations)} joints, the avatar {len(skeleton)}")
        bones = pose.bones(skeleton)
        if self._last_bones is None or not np.array_equal(bones, self._last_bones):
            assert self._scene is not None
            self._scene.write_bones(bones)
            self._last_bones = bones
            self._geometry_version += 1
        self.timer.mark("pose")

    def _pipeline(self, views: Sequence[Camera]) -> Pipeline:
        assert self._scene is not None
        degree = min(self._degree, views[0].sh_degree)
        variant = variant_for(
            degree,
            self._scene.influences,
            len(views),
            self.config,
            self._geometry,
            self._triangle,
            self._antialias,
        )
        if variant not in self._pipelines:
            self._pipelines[variant] = Pipeline(self.context, self._programs, variant, self._scene, self.config)
        return self._pipelines[variant]

    def _drop_scene(self) -> None:
        for pipeline in self._pipelines.values():
            pipeline.release()
        self._pipelines.clear()
        if self._scene is not None:
            self._scene.release()
            self._scene = None


def _union(a: tuple[int, int, int, int], b: tuple[int, int, int, int]) -> tuple[int, int, int, int]:
    """The smallest box that holds both; an empty one adds nothing."""
    if not (a[2] and a[3]):
        return b
    if not (b[2] and b[3]):
        return a
    x, y = min(a[0], b[0]), min(a[1], b[1])
    return x, y, max(a[0] + a[2], b[0] + b[2]) - x, max(a[1] + a[3], b[1] + b[3]) - y
