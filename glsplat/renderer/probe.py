"""Probe: a renderer for measurements: posed splats, the time of the draw alone, pictures in another order."""

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


class Probe(Renderer):
    """Make, use and release it as a Renderer."""

    _sorting: NDArray[np.float64] | None = None

    def in_order(self, viewmat: ArrayLike, views: Iterable[Camera], pose: Pose | None = None) -> NDArray[Any]:
        """Return the images of ``render()``, with the splats of all views ordered by the z of ``viewmat`` [4, 4].

        An eye in the order of its pair (``sorting_camera``) equals the pair's picture bit for bit. Raises GlsplatError.
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
        """Draw the last call's records again (step 4); return the milliseconds until the GPU has finished.

        ``glsplat bench`` reports this as the draw floor. ``views`` are one view or a pair of the last call. Raises
        GlsplatError for views of several passes.
        """
        cameras = self._views(views)
        if len(self._passes(cameras)) > 1:
            raise GlsplatError("redraw() takes views of one pass: one view, or a pair that looks the same way")
        with self._entered("redraw"):
            pipeline, target = self._scene.pipeline(cameras, 0), self._targets.float_target(self.size, len(cameras))
            mesh_pass = self._scene.mesh_pass(cameras, 0, self.target_dtype, self.timer)
            self.context.ctx.finish()
            timer = StageTimer(self.context.ctx.finish)
            timer.start()
            pipeline.draw(target, cameras, timer, self.config.output == "uint8", mesh_pass=mesh_pass)
            return timer.ms["draw"]

    def posed(self) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
        """Read back the splats in the last pose: world means [N, 3] and shapes M [N, 3, 3], Sigma = M M^T.

        The splats counted in ``stats.skipped`` are not among the N. Raises GlsplatError for a scene that is not skinned
        or not rendered yet.
        """
        with self._entered("posed"):
            arena = self._scene.arena
            if not (arena.posed and arena.written):
                raise GlsplatError("posed() needs an avatar; this scene is not skinned or not rendered yet")
            return arena.read()
