"""LocalShow: the wearer's avatar, solved and drawn here, into the runtime's own images."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import moderngl

from glsplat.camera import Camera
from glsplat.config import RenderConfig
from glsplat.errors import GlsplatError
from glsplat.extras.openxr.cameras import NEAR, camera_of, sighted
from glsplat.extras.openxr.eyes import DepthRange, Surroundings
from glsplat.extras.openxr.placing import Place, ViewName
from glsplat.extras.openxr.room import surroundings
from glsplat.extras.openxr.runtime import FrameTiming, Projection, Runtime, ViewPose
from glsplat.extras.openxr.session import Shown
from glsplat.extras.openxr.swapchains import EyeSwapchains, fitting
from glsplat.extras.openxr.wearer import Wearer
from glsplat.extras.speech.idle import IdleFace
from glsplat.formats.scene_file import SceneFile
from glsplat.gl.context import Context
from glsplat.renderer import Renderer
from glsplat.renderer.targets import Target
from glsplat.scene import Item, Scene, SceneLike, is_rigged, similarity
from glsplat.skinning.driven import why_not_tracked
from glsplat.timing import StageTimer
from glsplat.tracking.calibration import Calibration
from glsplat.tracking.solvers import SOLVERS, SolverName
from glsplat.tracking.tracker import Tracker

__all__ = ["LocalShow"]

FAR = 100.0
"""Metres; depth beyond it is not told apart."""


class LocalShow:
    """A ``Show`` of one scene. Release it before its context.

    The scene's one avatar is driven by the wearer (``Tracker``); a scene without one, or with several, is looked at
    from within. Splats are drawn as ``Renderer.render`` draws them with the same cameras, to the bit.
    """

    def __init__(
        self,
        scene: SceneLike | SceneFile,
        context: Context,
        wearer: Wearer,
        *,
        config: RenderConfig | None = None,
        background: tuple[float, float, float] | None = None,  # default: the scene's
        scale: float = 1.0,  # of the size that the runtime recommends
        depth: bool = True,  # submit depth where the runtime takes it
        floor: bool = True,  # draw a floor in the dark
        transparent: bool = False,  # what is behind shows: passthrough
        calibration: Calibration | None = None,  # default: the wearer's size is found as they move
        solver: SolverName = SOLVERS[0],
        advance: Callable[[float], None] = lambda _: None,  # seconds: what else moves in the scene
        timed: bool = False,  # wait for the GPU, so that drawing times are its own
    ) -> None:
        file = scene if isinstance(scene, SceneFile) else SceneFile.of(scene)
        self._context = context
        self.wearer: Wearer = wearer
        self._scale, self._depth, self._floor, self._transparent = scale, depth, floor and not transparent, transparent
        self._advance, self._finish = advance, context.ctx.finish if timed else None
        self._background = (0.0, 0.0, 0.0) if transparent else background or file.background
        self._source = file.avatar
        self._place = file.scene.transform
        self._scene = Scene(file.scene, light=file.scene.light, transform=self._place)
        self._tracker: Tracker | None = None
        self._idle = IdleFace()
        if self._source is not None and is_rigged(self._source.content):
            skeleton = self._source.content.skeleton
            if not why_not_tracked(skeleton):
                known = calibration or Calibration(automatic=True)
                self._tracker = Tracker(skeleton, known, solver=solver)
        self._own: Scene | None = None  # the scene as its wearer sees it from within: without the avatar's head
        self._own_item: Item | None = None
        self._loaded: ViewName | None = None
        self._eyes: EyeSwapchains | None = None
        self._last: Projection | None = None
        self._time: float | None = None
        self._target: Target | None = None  # what was drawn last,
        self._around: Surroundings | None = None  # ... what stands around it,
        self.cameras: list[Camera] = []  # ... by which,
        self.views: Sequence[ViewPose] = ()  # ... and for which eyes
        self.copy_ms = 0.0  # of the last pair into the images
        config = replace(config or RenderConfig(), output="float32")  # nothing is read back: the images round
        self._renderer = Renderer(self._scene, size=(64, 64), views=2, config=config, context=context)
        self._renderer.timer = StageTimer(self._finish)

    @property
    def renderer(self) -> Renderer:
        """What draws."""
        return self._renderer

    @property
    def context(self) -> Context:
        """Where it is drawn."""
        return self._context

    @property
    def eyes(self) -> EyeSwapchains | None:
        """The runtime's images, while there is one."""
        return self._eyes

    @property
    def scene(self) -> Scene:
        """What is drawn just now."""
        return self._own if self._loaded == "own" and self._own is not None else self._scene

    @property
    def solved(self) -> bool:
        """Whether the wearer drives an avatar."""
        return self._tracker is not None

    def attach(self, runtime: Runtime) -> None:
        """Make swapchains of the runtime's size."""
        size = fitting(runtime, self._scale, self._context.max_size)
        deep = self._depth and self._renderer.target_dtype != "f1"
        self._eyes = EyeSwapchains(runtime, self._context, size, deep)
        self._renderer.resize(*size)

    def detach(self) -> None:
        """Give them back."""
        eyes, self._eyes, self._last, self._target = self._eyes, None, None, None
        if eyes is not None:
            eyes.close()
        self.recentred()

    def recentred(self) -> None:
        """Place the view anew; whoever comes back is another user, or another place."""
        self.wearer.recentred()
        if self._tracker is not None:
            self._tracker.reset()

    def frame(self, runtime: Runtime, timing: FrameTiming, focused: bool) -> Shown:
        """Track, solve, locate the eyes at last, draw, and hand over."""
        eyes = self._eyes
        assert eyes is not None
        now = timing.display_time * 1e-9
        if self._time is not None:
            self._advance(min(max(now - self._time, 0.0), 0.1))
        self._time = now
        moment = self.wearer.look(runtime, timing, focused)
        if self._tracker is not None and self._source is not None and moment is not None:
            self._source.pose = self._tracker.update(self._idle.fill(moment.sample))
            known = self._tracker.calibration
            self._scene.transform = similarity((0.0, known.floor, 0.0), scale=known.scale) @ self._place
        if moment is not None:
            self._show(moment.place)
        views = sighted(runtime.views(timing.display_time))
        located = time.perf_counter()
        if views is None or moment is None:
            return Shown(self._last, located, 0.0)  # the device is lost: the last picture stays where it was
        place = moment.place
        background = (0.0, 0.0, 0.0) if place.glass is not None else self._background
        self.views = views
        self.cameras = [camera_of(view, eyes.size, place.shown, background) for view in views]
        self._around = surroundings(views, eyes.size, place, self._floor)
        depth = DepthRange(NEAR, FAR) if eyes.depth else None
        begun = time.perf_counter()
        self._target = self._renderer.draw(self.cameras, depth=eyes.depth)
        if self._finish is not None:
            self._finish()
        drawing = time.perf_counter() - begun
        copying = eyes.fill(self._target, depth, self._around, self._finish)
        self.copy_ms = copying * 1e3
        self._last = eyes.projection(views, depth, self._transparent)
        return Shown(self._last, located, drawing + copying)

    def look(self, framebuffer: moderngl.Framebuffer, size: tuple[int, int], eye: int = 0) -> bool:
        """Show in a window what the wearer saw last; False if that was nothing."""
        if self._eyes is None or self._target is None:
            return False
        self._eyes.show(self._target, framebuffer, size, self._around, eye)
        return True

    def release(self) -> None:
        """Delete all GL objects."""
        self.detach()
        self._renderer.release()

    def _show(self, place: Place) -> None:
        """What is drawn for the view: from within, an avatar has no head."""
        own = place.view == "own" and self._tracker is not None
        if own and self._own is None:
            self._headless()
        if self._own_item is not None and self._source is not None:
            self._own_item.pose, self._own_item.transform = self._source.pose, self._source.transform
        if self._own is not None:
            self._own.transform = self._scene.transform
        wanted: ViewName = "own" if own and self._own is not None else "mirror"
        if self._loaded != wanted and (self._loaded is not None or wanted == "own"):
            scene = self._own if wanted == "own" and self._own is not None else self._scene
            self._renderer.load(scene)
        self._loaded = wanted

    def _headless(self) -> None:
        source = self._source
        assert source is not None and is_rigged(source.content)
        try:
            content = source.content.without("head")
        except GlsplatError:  # a rig without such a joint: it keeps its head
            return
        kept = {name: getattr(source, name) for name in ("pose", "transform", "layers", "opacity", "visible", "name")}
        self._own_item = Item(content, **kept)
        items = [self._own_item if item is source else item for item in self._scene.items]
        self._own = Scene(items, light=self._scene.light)
