"""Late pictures that know how far away is what they show: hands and feet stay where they are while the head moves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from glsplat.net.backend import Rendered, RenderJob
from glsplat.net.codec.encoded import GRID_SIDE, grid_of
from tests.browser.conftest import OpenPage
from tests.browser.immersive.test_places import LEFT, RIGHT, SIDES, Held
from tests.browser.markers import offered
from tests.browser.vr import angle, centroid, enter, fresh, hands, pose, project, see, steer, visit

HAND, FOOT = (0.12, 1.35, -0.4), (-0.2, 0.3, -0.5)  # metres: 0.5 and 1.4 from the eyes
HEAD = {"pitch": -45}


class Deep(Held):
    """Says how far away the nearest blob is at each point of its pictures, unless ``knows`` is false."""

    knows = True

    def render(self, request: RenderJob) -> Rendered:
        rendered = super().render(request)
        if not (request.options.depth and self.knows):
            return rendered
        grids = []
        for camera in request.cameras:
            there = [camera.viewmat[:3, :3] @ place + camera.viewmat[:3, 3] for place in self._places(request).values()]
            pixels = np.array([(camera.K @ point)[:2] / point[2] for point in there])
            x, y = np.meshgrid(np.linspace(0, camera.width, GRID_SIDE), np.linspace(0, camera.height, GRID_SIDE))
            far = np.hypot(x[..., None] - pixels[:, 0], y[..., None] - pixels[:, 1])
            grids.append(grid_of(1 / np.array([point[2] for point in there])[far.argmin(axis=-1)]))
        return replace(rendered, depth=tuple(grids))


def off(open_page: OpenPage, serve: Callable[..., Any], backend: Deep, move: tuple[float, float, float]) -> np.ndarray:
    """[2 eyes, hand and foot] degrees by which they are shown elsewhere once the head has moved."""
    served = serve(backend, offered=offered)
    page = visit(open_page, served, {"view": "own", "size": 768, "quality": 95})
    steer(page, head=pose([0, 1.65, 0], **HEAD), input="hands", hands=hands(LEFT, RIGHT), side=768)
    enter(page, run=False)
    fresh(page)
    backend.last = backend.begun  # nothing newer is drawn from here on
    steer(page, head=pose(np.add([0, 1.65, 0], move), **HEAD))
    seen = see(page)
    backend.last = 1 << 53
    found = []
    for side in SIDES:
        eye = seen["eyes"][side]
        places = (("red", HAND), ("green", FOOT))
        found.append([angle(eye, centroid(seen[side], c), project(eye, at, 768), 768) for c, at in places])
    return np.array(found)


@pytest.mark.parametrize("move", [(0.1, 0, 0), (0, -0.05, -0.1)], ids=["aside", "ahead"])
def test_near_and_far_stay_where_they_are(open_page: OpenPage, serve: Any, move: tuple[float, float, float]) -> None:
    places = {"red": HAND, "green": FOOT}
    deep = off(open_page, serve, Deep(lambda _: places, radius=0.01), move)
    assert deep.max() <= 0.2, deep


def test_without_it_they_do_not(open_page: OpenPage, serve: Any) -> None:
    """A server that knows no depth: pictures lie on a plane, as they did; and in other views none is asked for."""
    backend = Deep(lambda _: {"red": HAND, "green": FOOT}, radius=0.01)
    backend.knows = False
    flat = off(open_page, serve, backend, (0.1, 0, 0))
    assert flat[:, 1].min() >= 2, flat
    assert any(job.options.depth for job in backend.requests)
    backend = Deep(lambda _: {"red": HAND})
    page = visit(open_page, serve(backend, offered=offered), {"view": "mirror", "size": 512})
    steer(page, head=pose([0, 1.65, 0]), input="hands", hands=hands(LEFT, RIGHT))
    enter(page, run=False)
    fresh(page)
    assert backend.requests and not any(job.options.depth for job in backend.requests)
