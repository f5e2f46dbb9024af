"""LocalShow: solves and draws the wearer's avatar on this PC, into the runtime's images."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import moderngl

from glsplat.camera import Camera
from glsplat.config import RenderConfig
from glsplat.errors import GlsplatError
from glsplat.extras.openxr.eyes import DepthRange, Surroundings
from glsplat.extras.openxr.openxr.runtime import OpenXrRuntime
from glsplat.extras.openxr.placing import NEAR, Place, ViewName, camera_of, sighted, surroundings
from glsplat.extras.openxr.runtime import FrameTiming, Projection, ViewPose
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

FAR = 100.0  # far plane of submitted depths in metres; larger depths are clamped to it


class LocalShow:
    """A ``Show`` of one scene. Release it before its context.

    The wearer drives the scene's one avatar (``Tracker``). A scene without an avatar, or with several, is viewed from
    within. Splats equal those of ``Renderer.render`` with the same cameras bit for bit.
    """

    def __init__(
        self,
        scene: SceneLike | SceneFile,
        context: Context,
        wearer: Wearer,
        *,
        config: RenderConfig | None = None,
        background: tuple[float, float, float] | None = None,  # default: the scene's
        scale: float = 1.0,  # of the runtime's recommended size
        depth: bool = True,  # submit depth if the runtime accepts it
        floor: bool = True,  # draw a floor in the dark
        transparent: bool = False,  # passthrough: the background shows the room
        calibration: Calibration | None = None,  # default: measure the wearer's size as they move
        solver: SolverName = SOLVERS[0],
        advance: Callable[[float], None] = lambda _: None,  # moves the rest of the scene by seconds
        timed: bool = False,  # wait for the GPU, so that drawing times are exact
    ) -> None:
        file = scene if isinstance(scene, SceneFile) else SceneFile.of(scene)
        self.context = context
        self.wearer: Wearer = wearer
        self._scale, self._depth, self._floor, self._transparent = scale, depth, floor and not transparent, transparent
        self._advance, self._finish = advance, context.ctx.finish if timed else None
        self._background = (0.0, 0.0, 0.0) if transparent else background or file.background
        self._source = file.avatar
        self._transform = file.scene.transform
        self._scene = Scene(file.scene, light=file.scene.light, transform=self._transform)
        self._tracker: Tracker | None = None
        self._idle = IdleFace()
        if self._source is not None and is_rigged(self._source.content):
            skeleton = self._source.content.skeleton
            if not why_not_tracked(skeleton):
                known = calibration or Calibration(automatic=True)
                self._tracker = Tracker(skeleton, known, solver=solver)
        self._own: Scene | None = None  # the scene without the avatar's head, for its own view
        self._own_item: Item | None = None
        self._loaded: ViewName | None = None
        self.eyes: EyeSwapchains | None = None  # of the attached runtime
        self._last: Projection | None = None
        self._time: float | None = None
        self._target: Target | None = None  # of the last frame, as are the next three
        self._around: Surroundings | None = None
        self.cameras: list[Camera] = []
        self.views: Sequence[ViewPose] = ()
        self.copy_ms = 0.0  # time to copy the last pair into the images
        config = replace(config or RenderConfig(), output="float32")  # nothing is read back; copying rounds
        self.renderer: Renderer = Renderer(self._scene, size=(64, 64), views=2, config=config, context=context)
        self.renderer.timer = StageTimer(self._finish)

    @property
    def scene(self) -> Scene:
        """Scene of the current view."""
        return self._own if self._loaded == "own" and self._own is not None else self._scene

    @property
    def solved(self) -> bool:
        """Whether the wearer drives an avatar."""
        return self._tracker is not None

    def attach(self, runtime: OpenXrRuntime) -> None:
        """Make swapchains of the runtime's size."""
        size = fitting(runtime, self._scale, self.context.max_size)
        self.eyes = EyeSwapchains(runtime, self.context, size, self._depth)
        self.renderer.resize(*size)

    def detach(self) -> None:
        """Close the swapchains."""
        eyes, self.eyes, self._last, self._target = self.eyes, None, None, None
        if eyes is not None:
            eyes.close()
        self.recentred()

    def recentred(self) -> None:
        """Place the view again and reset tracking: the user or their position may have changed."""
        self.wearer.recentred()
        if self._tracker is not None:
            self._tracker.reset()

    def frame(self, runtime: OpenXrRuntime, timing: FrameTiming, focused: bool) -> Shown:
        """Track and solve the wearer, locate the eyes as late as possible, draw, and fill the swapchains."""
        eyes = self.eyes
        assert eyes is not None
        now = timing.display_time * 1e-9
        if self._time is not None:
            self._advance(min(max(now - self._time, 0.0), 0.1))
        self._time = now
        moment = self.wearer.look(runtime, timing, focused)
        if self._tracker is not None and self._source is not None and moment is not None:
            self._source.pose = self._tracker.update(self._idle.fill(moment.sample))
            known = self._tracker.calibration
            self._scene.transform = similarity((0.0, known.floor, 0.0), scale=known.scale) @ self._transform
        if moment is not None:
            self._show(moment.place)
        views = sighted(runtime.views(timing.display_time))
        located = time.perf_counter()
        if views is None or moment is None:
            return Shown(self._last, located, 0.0)  # tracking is lost: show the last picture at its pose
        place = moment.place
        background = (0.0, 0.0, 0.0) if place.glass is not None else self._background
        self.views = views
        self.cameras = [camera_of(view, eyes.size, place.shown, background) for view in views]
        self._around = surroundings(views, eyes.size, place, self._floor)
        depth = DepthRange(NEAR, FAR) if eyes.depth else None
        begun = time.perf_counter()
        self._target = self.renderer.draw(self.cameras, depth=eyes.depth)
        if self._finish is not None:
            self._finish()
        drawing = time.perf_counter() - begun
        copying = eyes.fill(self._target, depth, self._around, self._finish)
        self.copy_ms = copying * 1e3
        self._last = eyes.projection(views, depth, self._transparent)
        return Shown(self._last, located, drawing + copying)

    def look(self, framebuffer: moderngl.Framebuffer, size: tuple[int, int], eye: int = 0) -> bool:
        """Show the wearer's last picture in a window; return False if there is none."""
        if self.eyes is None or self._target is None:
            return False
        self.eyes.show(self._target, framebuffer, size, self._around, eye)
        return True

    def release(self) -> None:
        """Delete all GL objects."""
        self.detach()
        self.renderer.release()

    def _show(self, place: Place) -> None:
        """Load the scene of a view; the own view has an avatar without head."""
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
            self.renderer.load(scene)
        self._loaded = wanted

    def _headless(self) -> None:
        source = self._source
        assert source is not None and is_rigged(source.content)
        try:
            content = source.content.without("head")
        except GlsplatError:  # a rig without that joint keeps its head
            return
        kept = {name: getattr(source, name) for name in ("pose", "transform", "layers", "opacity", "visible", "name")}
        self._own_item = Item(content, **kept)
        items = [self._own_item if item is source else item for item in self._scene.items]
        self._own = Scene(items, light=self._scene.light)
