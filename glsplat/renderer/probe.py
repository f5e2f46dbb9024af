"""Probe: a renderer whose inside can be measured: what was posed, what drawing alone takes, another order."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glsplat.arrays import own
from glsplat.camera import Camera, passes_of
from glsplat.errors import GlsplatError
from glsplat.renderer.renderer import Renderer
from glsplat.skinning.pose import Pose
from glsplat.timing import StageTimer

__all__ = ["Probe"]


class Probe(Renderer):
    """Made, used and released as a Renderer."""

    _sorting: NDArray[np.float64] | None = None

    def in_order(self, viewmat: ArrayLike, views: Iterable[Camera], pose: Pose | None = None) -> NDArray[Any]:
        """The images of ``render()``, the splats of all views ordered by the z of ``viewmat`` [4, 4].

        An eye in the order of its pair (``sorting_camera``) is the pair's, bit for bit. Raises GlsplatError.
        """
        order = own(viewmat, np.float64, "viewmat", GlsplatError)
        if not (order.shape == (4, 4) and np.isfinite(order).all()):
            raise GlsplatError("viewmat needs 4x4 finite numbers")
        self._sorting = order
        try:
            return self.render(views, pose)
        finally:
            self._sorting = None

    def _passes(self, views: Sequence[Camera]) -> list[list[int]]:
        return super()._passes(views) if self._sorting is None else passes_of(views)

    def _order(self, views: Sequence[Camera]) -> NDArray[np.float64]:
        return super()._order(views) if self._sorting is None else self._sorting

    def redraw(self, views: Iterable[Camera]) -> float:
        """Step 4 alone on the records the last call left, for one view or a pair: milliseconds until the GPU is done.

        The draw floor: what the picture costs once everything before it is known (``glsplat bench``). Raises
        GlsplatError for views that are not drawn in one pass.
        """
        asked = self._views(views)
        if len(self._passes(asked)) > 1:
            raise GlsplatError("redraw() takes views of one pass: one view, or a pair that looks the same way")
        with self._entered("redraw"):
            pipeline, target = self._scene.pipeline(asked, 0), self._targets.float_target(self.size, len(asked))
            mesh_pass = self._scene.mesh_pass(asked, 0, self.target_dtype, self.timer)
            self.context.ctx.finish()
            timer = StageTimer(self.context.ctx.finish)
            timer.start()
            pipeline.draw(target, asked, timer, self.config.output == "uint8", mesh_pass=mesh_pass)
            return timer.ms["draw"]

    def posed(self) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
        """What the skin pass made of the last pose: world means [N, 3] and shapes M [N, 3, 3], Sigma = M M^T.

        Read back for measurements. N leaves out the splats in ``stats.skipped``. Raises GlsplatError for a scene that
        is not skinned or not rendered yet.
        """
        with self._entered("posed"):
            arena = self._scene.arena
            if not (arena.posed and arena.written):
                why = "this scene is not skinned or not rendered yet"
                raise GlsplatError(f"posed() needs an avatar that was rendered; {why}")
            return arena.read()
