"""Late pictures that know how far away is what they show: hands and feet stay where they are while the head moves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from glsplat.data import default_avatar
from glsplat.evaluate.metrics.pixels import psnr
from glsplat.net.backend import AvatarInfo, Rendered, RenderJob, Solved
from glsplat.net.backends.gl import RendererBackend
from glsplat.net.codec.depth import SIDE, grid_of
from glsplat.skinning.pose import Pose
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
            x, y = np.meshgrid(np.linspace(0, camera.width, SIDE), np.linspace(0, camera.height, SIDE))
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
    assert any(job.options.depth for job in backend.requests.values())
    backend = Deep(lambda _: {"red": HAND})
    page = visit(open_page, serve(backend, offered=offered), {"view": "mirror", "size": 512})
    steer(page, head=pose([0, 1.65, 0]), input="hands", hands=hands(LEFT, RIGHT))
    enter(page, run=False)
    fresh(page)
    assert backend.requests and not any(job.options.depth for job in backend.requests.values())


class Posed:
    """Whatever the user does, the arms are raised before the body."""

    def solve(self, request: object, now: float) -> Solved:
        turns = np.zeros((55, 3))
        turns[16], turns[17] = (0, -1.2, 0), (0, 1.1, 0)  # the shoulders
        return Solved(Pose(turns), request.cameras)  # type: ignore[attr-defined]


class Drawn(RendererBackend):
    """The default avatar, up to a picture as Held; without depth unless it ``knows`` it."""

    begun, last, knows = 0, 1 << 53, True

    def render(self, request: RenderJob) -> Rendered:
        Held.hold(self, request)
        rendered = super().render(request)
        return rendered if self.knows else replace(rendered, depth=())


@pytest.mark.gl
def test_a_late_picture_looks_more_like_a_new_one(open_page: OpenPage, serve: Any) -> None:
    """Screenshots of one's own arms and feet after 8 cm aside: late, with depth and without, against drawn anew."""
    backend = Drawn(default_avatar().levels[0].content, (384, 384))
    posed = AvatarInfo(name="posed", solver=lambda height, span: Posed(), parts=frozenset({"head"}))
    page = visit(
        open_page, serve(backend, offered=(posed,)), {"view": "own", "size": 384, "quality": 90, "place": "studio"}
    )
    start, moved = (pose([x, 1.7, 0.1], yaw=180, pitch=-50) for x in (0, 0.08))
    steer(page, head=start, input="hands", hands=hands(LEFT, RIGHT), side=384)
    enter(page, run=False)
    found = []
    for knows in (True, False):
        backend.knows = knows
        steer(page, head=start)
        fresh(page, 120)
        backend.last = backend.begun
        steer(page, head=moved)
        late = see(page)
        backend.last = 1 << 53
        fresh(page, 120)
        truth = see(page)
        found.append(np.mean([psnr(late[side][..., :3] / 255, truth[side][..., :3] / 255) for side in SIDES]))
    print(f"with depth {found[0]:.1f} dB, without {found[1]:.1f} dB")
    assert found[0] >= found[1] + 1.5, found
