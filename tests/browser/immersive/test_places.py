"""Where things appear: in the mirror, before the user, as the own body, and while the head turns.

Held against geometry computed here, with nothing of the page's code; places by what docs/vr.md says of the views.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from glsplat.net.backend import Rendered, RenderJob
from glsplat.net.served_scene import gl_server
from glsplat.tracking.sample import Sample
from tests.browser.conftest import OpenPage
from tests.browser.markers import Markers, marked_avatar, offered, samples
from tests.browser.opened import Opened
from tests.browser.vr import angle, centroid, enter, fresh, hands, pose, project, see, steer, visit

MIRROR = 1.2  # metres from the user to the glass
FACING = 1.8  # metres from the user to the avatar
HEAD = pose([0.1, 1.65, 0.2], yaw=10)
LEFT, RIGHT = pose([-0.3, 1.05, -0.25], pitch=10), pose([0.42, 1.2, -0.1], yaw=20)
SIDES = ("left", "right")
GUARD = 60.0  # seconds after which something hangs


def at_hands(job: RenderJob) -> dict[str, Any]:
    """Red on the right hand, green on the left."""
    sample = samples.get(job.frame_id or 0, Sample(0.0))
    hands = {"red": sample.right, "green": sample.left}
    return {colour: wrist[:3] for colour, wrist in hands.items() if wrist}


def ahead_of(head: list[float]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The ground under a head that is not pitched, and the level direction it looks in."""
    yaw = 2 * np.arctan2(head[4], head[6])
    return np.array([head[0], 0, head[2]]), np.array([-np.sin(yaw), 0, -np.cos(yaw)])


def reflected(point: list[float], head: list[float]) -> NDArray[np.float64]:
    """In a mirror that was put up before ``head``."""
    ground, ahead = ahead_of(head)
    foot = ground + MIRROR * ahead
    p = np.asarray(point[:3])
    return p - 2 * ((p - foot) @ ahead) * ahead


def faced(point: list[float], head: list[float]) -> NDArray[np.float64]:
    """Of an avatar that was turned about to stand before ``head``."""
    ground, ahead = ahead_of(head)
    pivot = ground + FACING / 2 * ahead
    p = np.asarray(point[:3])
    return 2 * pivot - p + [0, 2 * p[1], 0]


def shown(open_page: OpenPage, serve: Any, view: str, **device: Any) -> Opened:
    """In VR with hands, seeing red and green blobs at the wrists."""
    served = serve(Markers(at_hands, radius=0.01), offered=offered)
    page = visit(open_page, served, {"view": view, "size": 1024, "quality": 90})
    steer(page, head=HEAD, input="hands", hands=hands(LEFT, RIGHT), **device)
    enter(page, run=False)
    fresh(page)
    return page


def test_the_mirror_shows_the_hands_where_a_mirror_would(open_page: OpenPage, serve: Any) -> None:
    page = shown(open_page, serve, "mirror", cant=8)
    # the mirror stays where it was put up when the user moves before it
    for head in (HEAD, pose([-0.1, 1.55, 0.35], yaw=-4, pitch=-8)):
        steer(page, head=head)
        fresh(page)
        seen = see(page)
        for side in SIDES:
            for colour, wrist in (("red", RIGHT), ("green", LEFT)):
                expected = project(seen["eyes"][side], reflected(wrist, HEAD))
                found = centroid(seen[side], colour)
                assert np.linalg.norm(found - expected) <= 1.5, (side, colour, found, expected)


def test_who_faces_one_has_the_right_hand_on_the_left(open_page: OpenPage, serve: Any) -> None:
    """And both eyes agree on how far away the hands are."""
    page = shown(open_page, serve, "facing")
    seen = see(page)
    for colour, wrist in (("red", RIGHT), ("green", LEFT)):
        tangents = []
        for side in SIDES:
            _, projection = eye = seen["eyes"][side]
            found = centroid(seen[side], colour)
            assert np.linalg.norm(found - project(eye, faced(wrist, HEAD))) <= 1.5, (side, colour)
            tangents.append((found[0] / 512 - 1 + projection[0, 2]) / projection[0, 0])
        disparity = tangents[0] - tangents[1]
        assert disparity > 0, "what is before one is farther right for the left eye"
        depth = -(np.linalg.inv(seen["eyes"]["left"][0]) @ [*faced(wrist, HEAD), 1])[2]
        assert 0.063 / disparity == pytest.approx(depth, rel=0.15)
        assert depth == pytest.approx(FACING, abs=0.6)  # the hands are nearer than the trunk


LATE = 10  # degrees by which the head turns, one a frame, while a picture is drawn


class Held(Markers):
    """Draws pictures up to the frame_id ``last``; the next one is begun, and waits."""

    begun, last = 0, 1 << 53

    def render(self, request: RenderJob) -> Rendered:
        self.hold(request)
        return super().render(request)

    def hold(self, request: RenderJob) -> None:
        """Wait until it is to be drawn."""
        self.begun = request.frame_id or 0
        end = time.monotonic() + GUARD
        while self.begun > self.last and time.monotonic() < end:
            time.sleep(0.002)


def test_a_late_picture_stands_still_while_the_head_turns(open_page: OpenPage, serve: Any) -> None:
    start, pixels = pose([0, 1.6, 0]), 512
    place = [0.0, 0.975, 0.0]  # the middle of the avatar
    backend = Held(lambda request: {"red": place}, radius=0.03)
    served = serve(backend, offered=offered)
    page = visit(open_page, served, {"view": "facing", "size": 512, "quality": 90})
    steer(page, head=start, input="hands", hands=hands(LEFT, RIGHT), side=pixels)
    enter(page, run=False)
    fresh(page)
    target = faced(place, start)
    backend.last = backend.begun
    locked, unlocked = [], []
    for frame in range(1, 4 * LATE + 1):
        yaw = 30 - abs(60 - (30 + frame) % 120)  # to and fro between -30 and 30
        steer(page, head=pose([0, 1.6, 0], yaw=yaw))
        page.js("fakeXR.step()")
        if frame % LATE:
            continue
        page.meanwhile(lambda: backend.begun > backend.last)
        backend.last = backend.begun
        page.until(f"(() => {{ fakeXR.step(); return window.glsplat.stats().shownId >= {backend.last}; }})()")
        seen = see(page)
        request = backend.asked(seen["stats"]["shownId"])
        for side, camera in zip(SIDES, request.cameras, strict=True):
            eye = seen["eyes"][side]
            expected = project(eye, target, pixels)
            locked.append(angle(eye, centroid(seen[side], "red"), expected, pixels))
            # the same picture, drawn as if it had been asked for by this eye
            x, y, z = camera.viewmat[:3, :3] @ place + camera.viewmat[:3, 3]
            _, P = eye
            stuck = (np.array([P[0, 0] * x / z - P[0, 2], P[1, 1] * y / z + P[1, 2]]) + 1) * pixels / 2
            unlocked.append(angle(eye, stuck, expected, pixels))
    backend.last = 1 << 53
    assert max(locked) <= 0.3
    assert np.median(unlocked) >= 8


HEIGHT = 1.9  # metres: not the avatar's


@pytest.mark.gl
def test_ones_own_hands_are_seen_where_they_are(open_page: OpenPage, serve: Any) -> None:
    served = serve(make=lambda config: gl_server(marked_avatar(), config, own_process=False))
    page = visit(open_page, served, {"view": "own", "size": 1024, "quality": 90, "height": HEIGHT})
    wrists = {"left": pose([-0.22, 1.43, -0.36], pitch=20), "right": pose([0.24, 1.36, -0.33], yaw=10)}
    head = pose([0, 0.936 * HEIGHT, 0], pitch=-30)
    steer(page, head=head, input="hands", hands=hands(wrists["left"], wrists["right"]))
    enter(page, run=False)
    for _ in range(5):  # the solver filters over time
        fresh(page)
    seen = see(page)
    for side in ("left", "right"):
        eye = seen["eyes"][side]
        for colour, hand in (("red", "right"), ("green", "left")):
            place = np.array(wrists[hand][:3])
            off = np.radians(angle(eye, centroid(seen[side], colour), project(eye, place)))
            assert off * np.linalg.norm(eye[0][:3, 3] - place) <= 0.01, (side, hand)
        blue = seen[side][..., 2].astype(int) - seen[side][..., :2].max(2)
        assert blue.max() < 150, "the own head is in the way"
