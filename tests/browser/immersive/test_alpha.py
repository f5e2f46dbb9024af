"""In passthrough the person's rim shows neither a dark nor a bright fringe: held against compositing in floats."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

import glsplat
from glsplat.net.backend import Rendered, RenderJob, Submitted
from glsplat.net.backends.gl import RendererBackend
from glsplat.net.served_scene import TrackingOptions
from tests.browser.conftest import OpenPage
from tests.browser.vr import SIDE, enter, fresh, hands, pose, see, steer, visit

BAND = 3  # pixels to either side of the silhouette
SQUARE = 8  # pixels of the checkerboard
MOST = 2.5  # of 255; each pixel of the pictures covers several
DRAWN = 512  # pixels: the side of the pictures


class Kept(RendererBackend):
    """Keeps what was drawn: {frame_id: (request, what came of it)}."""

    def __init__(self, avatar: glsplat.Avatar) -> None:
        super().__init__(avatar, (512, 512))
        self.kept: dict[int, tuple[RenderJob, Rendered]] = {}

    def submit(self, request: RenderJob) -> Rendered | Submitted:
        rendered = super().submit(request)
        assert isinstance(rendered, Rendered)  # a software driver draws at once
        kept = replace(rendered, images=rendered.images.copy())
        self.kept = dict(list(self.kept.items())[-8:]) | {request.frame_id or 0: (request, kept)}
        return rendered


def sampled(image: NDArray[Any], u: NDArray[Any], v: NDArray[Any]) -> NDArray[Any]:
    """``image`` [H, W, 4] in floats between its pixels' middles; transparent outside."""
    height, width = image.shape[:2]
    padded = np.pad(image.astype(np.float64), ((1, 2), (1, 2), (0, 0)))
    x, y = np.clip(u + 0.5, 0, width + 1), np.clip(v + 0.5, 0, height + 1)  # of the padded one, from a pixel's middle
    i, j = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = (x - i)[..., None], (y - j)[..., None]
    upper = padded[j, i] * (1 - fx) + padded[j, i + 1] * fx
    lower = padded[j + 1, i] * (1 - fx) + padded[j + 1, i + 1] * fx
    return upper * (1 - fy) + lower * fy


@pytest.mark.gl
def test_the_rim_has_no_fringe(open_page: OpenPage, serve: Any) -> None:
    """A person in passthrough at quality 80, before a checkerboard, against compositing what was drawn in floats."""
    avatar = glsplat.default_avatar().levels[0].content
    backend = Kept(avatar)
    served = serve(backend, offered=[TrackingOptions().describe("default", avatar)])
    page = visit(open_page, served, {"view": "facing", "size": DRAWN, "quality": 80})
    # the panel follows the left wrist: out of sight, behind the back
    steer(page, head=pose([0, 1.6, 0]), input="hands", hands=hands(pose([-0.3, 0.9, 0.4]), pose([0.25, 1.1, -0.35])))
    enter(page, "ar", run=False)
    fresh(page)
    seen = see(page)
    request, drawn = backend.kept[seen["stats"]["shownId"]]
    board = 255.0 * (np.add.outer(np.arange(SIDE) // SQUARE, np.arange(SIDE) // SQUARE) % 2)[..., None]
    ball = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * BAND + 1, 2 * BAND + 1))
    off = []
    for index, side in enumerate(("left", "right")):
        _, P = seen["eyes"][side]
        K = request.cameras[index].K
        middles = (np.arange(SIDE) + 0.5) / SIDE * 2 - 1
        u = K[0, 0] * (middles + P[0, 2]) / P[0, 0] + K[0, 2]
        v = K[1, 1] * (middles - P[1, 2]) / P[1, 1] + K[1, 2]
        exact = sampled(drawn.images[index], *np.meshgrid(u, v))
        wanted, found = (a[..., :3] + (1 - a[..., 3:] / 255) * board for a in (exact, seen[side] * 1.0))
        inside = (exact[..., 3] > 127.5).astype(np.uint8)
        band = cv2.dilate(inside, ball) > cv2.erode(inside, ball)
        assert band.sum() > 3000, "there is no person"
        off.append((found - wanted)[band])
    assert np.abs(np.concatenate(off)).mean() <= MOST
    assert abs(np.concatenate(off).mean()) <= 0.5, "a dark or a bright fringe"
