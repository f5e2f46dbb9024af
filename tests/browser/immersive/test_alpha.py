"""In passthrough the person's rim shows neither a dark nor a bright fringe: held against compositing in floats."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
import pytest
import simplejpeg
from numpy.typing import NDArray

import glsplat
from glsplat.net.backend import Rendered, RenderJob
from glsplat.net.backends.gl import RendererBackend
from glsplat.net.backends.server import offered
from glsplat.net.codec.encode import Encoder
from tests.browser.conftest import OpenPage
from tests.browser.vr import SIDE, enter, fresh, hands, pose, see, steer, visit

BAND = 3  # pixels to either side of the silhouette
SQUARE = 8  # pixels of the checkerboard
PICTURES = 2
MOST = 2.5  # of 255; each pixel of the pictures covers several
DRAWN = 512  # pixels: the side of the pictures


class Kept(RendererBackend):
    """Keeps what was drawn: {frame_id: (request, what came of it)}."""

    def __init__(self, avatar: glsplat.Avatar) -> None:
        super().__init__(avatar, (512, 512))
        self.kept: dict[int, tuple[RenderJob, Rendered]] = {}

    def render(self, request: RenderJob) -> Rendered:
        rendered = super().render(request)
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


def decoded(drawn: Rendered) -> NDArray[np.float64]:
    """[V, H, W, 4] straight colours and alpha, 0 to 255, as they come out of the codec."""
    encoder = Encoder()
    coded = encoder.encode(drawn.images, 80, crop=True, covered=drawn.covered, alpha="straight")
    encoder.close()
    assert coded.boxes is not None and coded.alphas is not None
    out = np.zeros(drawn.images.shape)
    for lossy, (x, y, width, height), colour, grey in zip(out, coded.boxes, coded.pictures, coded.alphas, strict=True):
        part = lossy[y : y + height, x : x + width]
        part[:] = np.dstack([simplejpeg.decode_jpeg(colour), simplejpeg.decode_jpeg(grey, "GRAY")])
    return out


@dataclass
class Rim:
    """What is off at the silhouette of both eyes, [N, 3] of 255, before a checkerboard."""

    shown: NDArray[np.float64]  # by the page, from what was drawn
    added: NDArray[np.float64]  # by the page, from what the codec made of it


def rim(open_page: OpenPage, serve: Any) -> Rim:
    """A person in passthrough at quality 80, against compositing what was drawn in floats."""
    avatar = glsplat.default_avatar()
    backend = Kept(avatar)
    served = serve(backend, offered=[offered("default", avatar)])
    page = visit(open_page, served, {"view": "facing", "size": DRAWN, "quality": 80})
    # the panel follows the left wrist: out of sight, behind the back
    steer(page, head=pose([0, 1.6, 0]), input="hands", hands=hands(pose([-0.3, 0.9, 0.4]), pose([0.25, 1.1, -0.35])))
    enter(page, "ar", run=False)
    board = 255.0 * (np.add.outer(np.arange(SIDE) // SQUARE, np.arange(SIDE) // SQUARE) % 2)[..., None]
    ball = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * BAND + 1, 2 * BAND + 1))
    shown, added = [], []
    for _ in range(PICTURES):
        fresh(page)
        seen = see(page)
        request, drawn = backend.kept[seen["stats"]["shownId"]]
        lossy = decoded(drawn)
        for index, side in enumerate(("left", "right")):
            _, P = seen["eyes"][side]
            K = request.cameras[index].K
            middles = (np.arange(SIDE) + 0.5) / SIDE * 2 - 1
            u = K[0, 0] * (middles + P[0, 2]) / P[0, 0] + K[0, 2]
            v = K[1, 1] * (middles - P[1, 2]) / P[1, 1] + K[1, 2]
            exact, coded = (sampled(image, *np.meshgrid(u, v)) for image in (drawn.images[index], lossy[index]))
            coded[..., :3] *= coded[..., 3:] / 255  # straight colours, cut by alpha once both are between pixels
            wanted, best, found = (
                a[..., :3] + (1 - a[..., 3:] / 255) * board for a in (exact, coded, seen[side] * 1.0)
            )
            inside = (exact[..., 3] > 127.5).astype(np.uint8)
            band = cv2.dilate(inside, ball) > cv2.erode(inside, ball)
            assert band.sum() > 3000, "there is no person"
            shown.append((found - wanted)[band])
            added.append((found - best)[band])
    return Rim(np.concatenate(shown), np.concatenate(added))


@pytest.mark.gl
def test_the_rim_has_no_fringe(open_page: OpenPage, serve: Any) -> None:
    found = rim(open_page, serve)
    assert np.abs(found.shown).mean() <= MOST
    assert abs(found.shown.mean()) <= 0.5, "a dark or a bright fringe"
    assert np.abs(found.added).mean() <= 0.6, "the page does something else than compositing"
