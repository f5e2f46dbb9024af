"""Where the preview's pictures come from: what a viewer asks of a source, and the source that draws them here."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Protocol

import moderngl

from glsplat.camera import Camera
from glsplat.config import RenderConfig
from glsplat.errors import GlsplatError
from glsplat.gl.context import Context
from glsplat.renderer import Renderer
from glsplat.renderer.targets import Target
from glsplat.scene import SceneLike
from glsplat.timing import StageTimer

from .overlay import Line
from .player import Player

__all__ = ["Drawn", "Pictures"]


class Pictures(Protocol):
    """A source of pictures. All calls come from the thread of the window and return soon, ``settle`` excepted."""

    pace: float  # seconds between looks at what moves; 0: as often as it can be drawn

    @property
    def notice(self) -> str:
        """What the user has to know for as long as it is so; empty if all is well."""
        ...

    @property
    def fresh(self) -> bool:
        """True when something came by itself: a picture or a notice."""
        ...

    def ask(self, cameras: Sequence[Camera], player: Player | None) -> bool:
        """This picture is wanted now. False: there is nothing newer to show than before."""
        ...

    def settle(self) -> None:
        """Wait for the picture last asked for. GlsplatError if it does not come."""
        ...

    def draw(self, cameras: Sequence[Camera], player: Player | None, exact: bool) -> Target:
        """The layers to show, one a view; ``exact`` waits at each stage, so that its time is its own."""
        ...

    def load(self, scene: SceneLike) -> None:
        """Show another scene from now on. GlsplatError leaves all as it was."""
        ...

    def facts(self) -> list[Line]:
        """Who draws, and what is in the picture."""
        ...

    def stages(self) -> dict[str, float]:
        """Milliseconds by stage of the newest picture."""
        ...

    def report(self) -> dict[str, Any]:
        """Driver, counts and stage times, for --json."""
        ...

    def release(self) -> None:
        """Delete all GL objects."""
        ...


class Drawn:
    """Pictures drawn in the window's own context."""

    pace = 0.0
    notice = ""
    fresh = False

    def __init__(
        self, scene: SceneLike, context: Context, size: tuple[int, int], config: RenderConfig | None = None
    ) -> None:
        config = replace(config or RenderConfig(), output="float32")  # nothing is read back: the window rounds to 8 bit
        self._scene, self._context = scene, context
        self._renderer = Renderer(scene, size=size, config=config, context=context)

    def ask(self, cameras: Sequence[Camera], player: Player | None) -> bool:
        """Whatever is asked for can be drawn."""
        return True

    def settle(self) -> None:
        """Nothing is under way."""

    def draw(self, cameras: Sequence[Camera], player: Player | None, exact: bool) -> Target:
        """Render one view or a pair."""
        renderer = self._renderer
        renderer.timer = StageTimer(self._context.ctx.finish if exact else None)
        renderer.resize(cameras[0].width, cameras[0].height)
        return renderer.draw(cameras, None if player is None else player.pose())

    def load(self, scene: SceneLike) -> None:
        """Replace the scene."""
        try:
            self._renderer.load(scene)
        except (GlsplatError, moderngl.Error):
            self._renderer.load(self._scene)
            raise
        self._scene = scene

    def facts(self) -> list[Line]:
        """Driver and counts."""
        stats = self._renderer.stats
        reasons = [f"{count} {reason}" for reason, count in stats.culled.items() if count]
        if stats.skipped:
            reasons.append(f"{stats.skipped} unusable")
        why = f" ({', '.join(reasons)})" if reasons else ""
        levels = f", level {' '.join(map(str, stats.levels))}" if any(stats.levels) else ""
        return [(self._renderer.driver,), (f"{stats.splats} splats{levels}, {stats.drawn} drawn{why}",)]

    def stages(self) -> dict[str, float]:
        """The renderer's stages."""
        return {name: ms for name, ms in self._renderer.timings.items() if name != "total"}

    def report(self) -> dict[str, Any]:
        """Driver, float target, counts and stage times of the last frame."""
        stats = self._renderer.stats
        return {
            "driver": self._renderer.driver,
            "float_target": self._renderer.target_dtype,
            "splats": stats.splats,
            "levels": stats.levels,
            "drawn": stats.drawn,
            "skipped": stats.skipped,
            "culled": stats.culled,
            "timings_ms": {stage: round(ms, 3) for stage, ms in self._renderer.timings.items()},
        }

    def release(self) -> None:
        """Delete the renderer's GL objects."""
        self._renderer.release()
