"""Thumbnail: a picture of splats or an avatar for notebooks, which ask values for ``_repr_png_()``."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.errors import GlsplatError
from glsplat.pictures import straight
from glsplat.renderer.renderer import Renderer
from glsplat.splats import Splats
from glsplat.views import view_of, viewing_point

SIDE_PX = 512
FOV_DEG = 40.0


def thumbnail(content: Splats | Avatar) -> bytes | None:
    """Return a PNG of the content from the front, by a context of its own; None where it cannot be drawn."""
    size = (SIDE_PX, SIDE_PX)
    try:
        with Renderer(content, size=size) as renderer:
            image = renderer.render(view_of(*viewing_point(content, FOV_DEG), size, FOV_DEG))[0]
    except GlsplatError:
        return None
    png: NDArray[np.uint8] = cv2.imencode(".png", cv2.cvtColor(straight(image), cv2.COLOR_RGBA2BGRA))[1]
    return png.tobytes()
