"""Renders the depth grids of a picture: its views at the grids' resolution, with the coarsest level of detail.

Depth at the picture's own size would take as long as the picture itself (docs/vr.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from glsplat.camera import Camera
from glsplat.net.codec.depth import GRID_SIDE, DepthGrid, grid_of
from glsplat.renderer import Renderer
from glsplat.renderer.levels import Selector
from glsplat.skinning.pose import Pose

_MIN_ALPHA = 0.1  # of a point that has a depth: the depth of a partly covered pixel is better than an interpolated one


def depth_grids(renderer: Renderer, views: Sequence[Camera], pose: Pose | None = None) -> tuple[DepthGrid, ...]:
    """Return a grid for each view, in its units.

    Changes the renderer's size, selector, step and statistics.
    """
    renderer.selector, renderer.step = Selector(), None
    renderer.resize(GRID_SIDE, GRID_SIDE)
    images, depths = renderer.render([_spread(view) for view in views], pose, depth=True)
    alpha = images[..., 3] / (255 if images.dtype == np.uint8 else 1)
    there = (alpha > _MIN_ALPHA) & (depths > 0)
    return tuple(map(grid_of, np.divide(1, depths, out=np.full(depths.shape, np.nan), where=there)))


def _spread(view: Camera) -> Camera:
    """Return the camera whose pixels are centred at the grid's points; the outermost lie on the picture's rim."""
    width, height = (GRID_SIDE - 1) / view.width, (GRID_SIDE - 1) / view.height
    k = np.array([[width, 0, 0.5], [0, height, 0.5], [0, 0, 1]]) @ view.K
    return replace(view, K=k, width=GRID_SIDE, height=GRID_SIDE)
