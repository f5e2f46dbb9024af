"""Rooms from the page: choosing one, being refused, and what is asked for in and out of VR."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from glsplat.camera import Camera
from glsplat.extras.rooms.feature import Rooms
from glsplat.net.backend import AvatarInfo, RenderJob
from glsplat.net.server import ServerConfig
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES
from tests.browser.conftest import OpenPage
from tests.browser.markers import Markers, as_tracked
from tests.browser.vr import centroid, enter, fresh, pose, project, see, steer, visit

RIG = Skeleton.from_joints(JOINT_NAMES, [-1] + [0] * 54, np.zeros((55, 3)))
OFFERED = (AvatarInfo(name="ann", skeleton=RIG, solver=as_tracked, height=1.75, parts=frozenset({"head"})),)
CONFIG = ServerConfig(port=0, rooms={"lab": 2, "hall": 2}, furnished=frozenset(["lab", "hall"]))
EMPTY = ServerConfig(port=0, rooms={"lab": 2})
OPPOSITE = (0.3, 1.4, 1.2)  # in the room: before who stands on the other side


def of_the_room(request: RenderJob) -> dict[str, Any]:
    """A red blob at a place of the room, a green one two metres above the room's centre."""
    return {"red": OPPOSITE, "green": (0, 2, 0)}


@pytest.fixture
def served(serve: Any) -> Any:
    return serve(Markers(of_the_room, radius=0.03), config=CONFIG, offered=OFFERED)


def people(served: Any, room: int = 0) -> list[str]:
    return [one["name"] for one in served.stats()["rooms"][room]["people"]]


def test_a_room_is_entered_and_left_by_its_field(open_page: OpenPage, served: Any) -> None:
    page = visit(open_page, served)
    page.until("!document.querySelector('#room-row').hidden")
    assert people(served) == []
    page.page.fill("#name", "Zoë")
    page.page.locator("#name").blur()
    page.page.select_option("#room", "lab")
    page.until("window.glsplat.stats().state === 'open' && window.glsplat.stats().shown > 0")
    assert people(served) == ["Zoë"]
    assert page.js("document.querySelector('#room').selectedOptions[0].textContent").startswith("lab")
    page.page.fill("#name", "../Ann")
    page.page.locator("#name").blur()
    assert page.page.get_attribute("#name", "aria-invalid") == "true" and people(served) == ["Zoë"]
    page.page.select_option("#room", "")
    page.until("window.glsplat.stats().state === 'open'")
    page.meanwhile(lambda: people(served) == [])


def test_a_page_says_that_a_name_is_taken_or_a_room_full(open_page: OpenPage, served: Any) -> None:
    first = visit(open_page, served, {"room": "lab", "name": "Ann"})
    first.until("window.glsplat.stats().shown > 0")
    second = visit(open_page, served, {"room": "lab", "name": "Ann"}, allow=["Unexpected response code: 409"])
    second.until("document.querySelector('#status').textContent.includes('The name \"Ann\"')")
    second.page.fill("#name", "Bob")
    second.page.locator("#name").blur()
    second.until("window.glsplat.stats().shown > 0")
    third = visit(open_page, served, {"room": "lab", "name": "Carl"}, allow=["Unexpected response code: 503"])
    third.until("document.querySelector('#status').textContent.includes('room is full')")
    assert sorted(people(served)) == ["Ann", "Bob"]


def cut_off(served: Any) -> None:
    """Break the connection of the first client, without a close."""

    def abort() -> None:
        talk = next(iter(served.server._conversations.values()))
        talk._request.transport.abort()

    served._loop.call_soon_threadsafe(abort)


def test_a_page_keeps_its_name_whatever_becomes_of_its_connection(open_page: OpenPage, served: Any) -> None:
    """A connection that breaks, and a page that is loaded again; no other tab has it meanwhile."""
    page = visit(open_page, served, {"room": "lab", "name": "Ann"})
    page.until("window.glsplat.stats().shown > 0")
    guest = served.server.feature(Rooms)._rooms["lab"]._guests["Ann"]
    seat, token = guest.person.seat, guest.person.resume
    cut_off(served)
    page.until("window.glsplat.stats().reconnects === 1 && window.glsplat.stats().shown > 0")
    again = served.server.feature(Rooms)._rooms["lab"]._guests["Ann"]
    assert again is not guest and again.person.seat is seat and again.person.resume == token
    second = visit(open_page, served, {"room": "lab", "name": "Ann"}, allow=["Unexpected response code: 409"])
    second.until("document.querySelector('#status').textContent.includes('The name \"Ann\"')")
    assert people(served) == ["Ann"] and page.stats()["reconnects"] == 1
    second.page.close()
    page.page.reload()
    page.until("window.glsplat.stats().shown > 0")
    assert people(served) == ["Ann"]


def test_pictures_of_an_empty_room_are_of_its_people_alone(open_page: OpenPage, serve: Any) -> None:
    """Pixels go to that part of the view; who is in it is in it whole."""
    drawn: list[RenderJob] = []
    bob = AvatarInfo(name="bob", skeleton=RIG, solver=as_tracked, height=1.75)
    served = serve(Markers(lambda request: drawn.append(request) or {}), config=EMPTY, offered=(*OFFERED, bob))
    pages = [
        visit(open_page, served, {"room": "lab", "name": name, "drawer": False}, size=(1000, 700))
        for name in ("Ann", "Bob")
    ]
    pages[0].until("window.glsplat.stats().shown > 0")

    def anns() -> list[RenderJob]:
        return [one for one in list(drawn) if one.room is not None and one.room.viewer == 1]

    def met() -> list[RenderJob]:
        return [one for one in anns() if one.room is not None and len(one.room.people) == 2]

    pages[0].meanwhile(lambda: len(met()) > 3)
    worn = {one["name"]: one["avatar"] for one in served.stats()["rooms"][0]["people"]}
    assert worn == {"Ann": "ann", "Bob": "bob"}  # guests who chose nobody differ
    (whole,), (cut,) = anns()[0].cameras, met()[-1].cameras

    def wide(camera: Camera) -> float:  # its field of view, tangents across times up
        return float(camera.width * camera.height / (camera.K[0, 0] * camera.K[1, 1]))

    assert wide(cut) < 0.9 * wide(whole)
    for x, y, z in ((x, y, z) for x in (-0.5, 0.5) for y in (0, 2) for z in (-1.2, 1.2)):
        a, b, away = cut.viewmat[:3, :3] @ (x, y, z) + cut.viewmat[:3, 3]
        column, row = cut.K[0, 0] * a / away + cut.K[0, 2], cut.K[1, 1] * b / away + cut.K[1, 2]
        in_view = 0 < whole.K[1, 1] * b / away + whole.K[1, 2]  # what the canvas has no room for is not asked for
        assert away > 0 and 0 < column < cut.width and (0 < row < cut.height or not in_view)


def test_in_vr_the_room_is_around_its_user(open_page: OpenPage, served: Any) -> None:
    """Wherever they stood and looked when they entered: the room's centre is ahead, and things are at their places."""
    page = visit(open_page, served, {"room": "lab", "name": "Ann", "view": "own", "size": 512})
    head = pose([0.4, 1.65, -0.7], yaw=70)
    steer(page, head=head)
    enter(page)
    fresh(page)
    # the first seat of two is 1.2 m before the centre, and its user looks along +z
    x, y, z = OPPOSITE
    ahead = np.array([-np.sin(np.radians(70)), 0, -np.cos(np.radians(70))])
    expected = np.array([0.4, y, -0.7]) + ahead * (z + 1.2) + np.cross((0, 1, 0), ahead) * x
    seen = see(page)
    for side in ("left", "right"):
        assert np.linalg.norm(centroid(seen[side], "red") - project(seen["eyes"][side], expected)) < 3
    request = served.server.drawer.worker._backend.requests[-1]
    assert request.options.hide == ("head",) and request.room is not None and request.room.room == "lab"
