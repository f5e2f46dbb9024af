"""Pictures of the preview that are drawn here; those of a server (connect.py) have the same methods."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import moderngl

from glsplat.camera import Camera
from glsplat.config import RenderConfig
from glsplat.errors import GlsplatError
from glsplat.gl.context import Context
from glsplat.renderer import Renderer
from glsplat.renderer.targets import Target
from glsplat.scene import SceneLike
from glsplat.timing import StageTimer

from ..output import frame_report
from .overlay import Line
from .player import Player


class LocalPictures:
    """Pictures drawn in the window's own context. Calls come from its thread; all but ``wait_ready`` return at once."""

    period_s = 0.0  # least time between requests while the picture moves; 0: none
    notice = ""  # current problem to show
    fresh = False  # a new picture is queued

    def __init__(
        self, scene: SceneLike, context: Context, size: tuple[int, int], config: RenderConfig | None = None
    ) -> None:
        config = replace(config or RenderConfig(), output="float32")  # not read back: the window rounds to 8 bit
        self._scene, self._context = scene, context
        self._renderer = Renderer(scene, size=size, config=config, context=context)

    def request(self, cameras: Sequence[Camera], player: Player | None) -> bool:
        """Request a picture. Return whether a newer one than before can be drawn: here always."""
        return True

    def wait_ready(self) -> None:
        """Wait for the last requested picture: here nothing, as pictures are drawn on demand."""

    def draw(self, cameras: Sequence[Camera], player: Player | None, exact: bool) -> Target:
        """Return the layers to show, one a view; ``exact`` waits for the GPU after each stage."""
        renderer = self._renderer
        renderer.timer = StageTimer(self._context.ctx.finish if exact else None)
        renderer.resize(cameras[0].width, cameras[0].height)
        return renderer.draw(cameras, None if player is None else player.pose())

    def load(self, scene: SceneLike) -> None:
        """Replace the scene. A GlsplatError leaves it unchanged."""
        try:
            self._renderer.load(scene)
        except (GlsplatError, moderngl.Error):
            self._renderer.load(self._scene)
            raise
        self._scene = scene

    def facts(self) -> list[Line]:
        """Return driver and counts, as lines."""
        stats = self._renderer.stats
        reasons = [f"{count} {reason}" for reason, count in stats.culled.items() if count]
        if stats.skipped:
            reasons.append(f"{stats.skipped} unusable")
        why = f" ({', '.join(reasons)})" if reasons else ""
        levels = f", level {' '.join(map(str, stats.levels))}" if any(stats.levels) else ""
        return [(self._renderer.driver,), (f"{stats.splats} splats{levels}, {stats.drawn} drawn{why}",)]

    def stages(self) -> dict[str, float]:
        """Return the renderer's stage times in milliseconds."""
        return {name: ms for name, ms in self._renderer.timings.items() if name != "total"}

    def report(self) -> dict[str, Any]:
        """Return driver, float target, counts and stage times of the last frame."""
        return frame_report(self._renderer)

    def release(self) -> None:
        """Delete the renderer's GL objects."""
        self._renderer.release()
