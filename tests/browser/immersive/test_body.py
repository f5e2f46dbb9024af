"""The avatar that the server really solves and draws: its hands are at one's own, in each view, for each stature."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from glsplat.net.backends.server import make_server
from tests.browser.conftest import OpenPage
from tests.browser.immersive.test_places import reflected
from tests.browser.markers import marked_avatar
from tests.browser.opened import Opened
from tests.browser.vr import angle, centroid, enter, fresh, hands, pose, project, see, steer, visit

pytestmark = pytest.mark.gl
SIDES = ("left", "right")
EYES = 0.936  # of the stature


def standing(open_page: OpenPage, serve: Any, view: str, height: float) -> tuple[Opened, dict[str, list[float]]]:
    """A person of that height in VR, who holds the hands before the chest; where the wrists are."""
    served = serve(make=lambda config: make_server(marked_avatar(), config, own_process=False))
    page = visit(open_page, served, {"view": view, "size": 1024, "quality": 90, "height": height})
    tall = height / 1.75
    wrists = {"left": pose([-0.2 * tall, 1.32 * tall, -0.33 * tall], pitch=20),
              "right": pose([0.22 * tall, 1.25 * tall, -0.3 * tall], yaw=10)}  # fmt: skip
    steer(page, head=pose([0, EYES * height, 0]), input="hands", hands=hands(wrists["left"], wrists["right"]))
    enter(page, run=False)
    settled(page)
    return page, wrists


def settled(page: Opened) -> None:
    """The solver filters over time: until it stands still."""
    for _ in range(4):
        fresh(page)


def test_ones_own_hands_are_seen_where_they_are(open_page: OpenPage, serve: Any) -> None:
    height = 1.9
    page, wrists = standing(open_page, serve, "own", height)
    steer(page, head=pose([0, EYES * height, 0], pitch=-30))
    settled(page)
    seen = see(page)
    for side in SIDES:
        eye = seen["eyes"][side]
        for colour, hand in (("red", "right"), ("green", "left")):
            place = np.array(wrists[hand][:3])
            off = np.radians(angle(eye, centroid(seen[side], colour), project(eye, place)))
            off *= np.linalg.norm(eye[0][:3, 3] - place)
            print(f"{height} m, {side} eye, {hand} hand: {1e3 * off:.1f} mm")
            assert off <= 0.01, (side, hand)
        blue = seen[side][..., 2].astype(int) - seen[side][..., :2].max(2)
        assert blue.max() < 150, "the own head is in the way"


def test_the_mirror_shows_the_avatars_hands(open_page: OpenPage, serve: Any) -> None:
    page, wrists = standing(open_page, serve, "mirror", 1.75)
    head = pose([0, EYES * 1.75, 0])
    seen = see(page)
    for side in SIDES:
        for colour, hand in (("red", "right"), ("green", "left")):
            expected = project(seen["eyes"][side], reflected(wrists[hand], head))
            found = centroid(seen[side], colour)
            print(side, hand, found - expected)
            assert np.linalg.norm(found - expected) <= 1.5, (side, hand)
        assert centroid(seen[side], "blue", 90).shape == (2,), "in a mirror one has a head"
