"""The light that a request asks for: checked, and falling on its client's picture alone."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from glsplat.camera import head_matrix, stereo_cameras
from glsplat.config import RenderConfig
from glsplat.errors import ProtocolError
from glsplat.extras.rooms.feature import Member
from glsplat.extras.rooms.person import Person
from glsplat.extras.rooms.room import Room
from glsplat.formats.scene_file import SceneFile
from glsplat.light.light import Light
from glsplat.net.backend import RenderJob
from glsplat.net.backends.gl import RendererBackend
from glsplat.net.client import request_message
from glsplat.net.messages import Decoder, PictureOptions, Request
from glsplat.net.room_view import RoomView, VisiblePerson
from glsplat.renderer import Renderer
from glsplat.scene import Item, Scene, similarity
from glsplat.skinning.pose import Pose
from tests.light.lit import random_light, surfaced
from tests.net.wire import EYE
from tests.scenes import limb

SIZE = (64, 56)
EYES = stereo_cameras(head_matrix((0, 0.9, 2.2), (0, 0, 0, 1)), size=SIZE)
ROD = surfaced(limb(400), 4)
OTHER = surfaced(limb(300), 5)
DARK, ASKED = random_light(1), random_light(2)


def decoded(light: Any, **fields: Any) -> Request:
    found = Decoder().decode(json.dumps({"v": 1, "frame_id": 1, "eyes": [EYE], "light": light, **fields}))
    assert isinstance(found, Request)
    return found


def test_what_the_client_sends_is_what_the_server_reads() -> None:
    message = request_message(1, EYES, light=ASKED)
    found = Decoder().decode(json.dumps(message))
    assert isinstance(found, Request) and found.options.light is not None and found.options.light.same(ASKED)
    named = decoded("evening").options.light
    assert named is not None and named.same(Light.preset("evening"))
    assert decoded(None).options.light is None and "light" not in request_message(1, EYES)
    no_sun = decoded({"ambient": [[1, 1, 1]] * 9, "sun": None, "later": 1}).options.light
    assert no_sun is not None and no_sun.sun_direction is None


NINE = [[0.1, 0.1, 0.1]] * 9


@pytest.mark.parametrize(
    "light",
    [
        "moonlight",
        5,
        [],
        {},
        {"ambient": NINE[:8]},
        {"ambient": [[1, 2]] * 9},
        {"ambient": [["1", 2, 3]] * 9},
        {"ambient": [[1e9, 0, 0]] * 9},
        {"ambient": NINE, "sun": {"direction": [0, 1, 0]}},
        *({"ambient": NINE, "sun": {"direction": one, "color": [1, 1, 1]}} for one in ([0, 2, 0], [0, 0, 0], [0, 1])),
        *({"ambient": NINE, "sun": {"direction": [0, 1, 0], "color": one}} for one in ([-1, 1, 1], [1] * 400)),
    ],
)
def test_what_is_no_light_is_refused_in_one_line(light: Any) -> None:
    with pytest.raises(ProtocolError, match=r"light|Expected|required") as caught:
        decoded(light)
    assert caught.value.code in ("bad_request", "bad_field") and "\n" not in str(caught.value)


def test_an_acknowledgement_has_no_light() -> None:
    with pytest.raises(ProtocolError, match="light"):
        Decoder().decode('{"v": 1, "ack": 0, "light": "day"}')


@pytest.fixture
def backend() -> Iterator[RendererBackend]:
    backend = RendererBackend(
        Scene([Item(ROD)], light=DARK), SIZE, avatars={"other": OTHER}, rooms={"lab": SceneFile.of(Scene())}
    )
    backend.open()
    yield backend
    backend.close()


def direct(content: Any, light: Light | None) -> Any:
    with Renderer(Scene([Item(content)], light=light), size=SIZE, views=2, config=RenderConfig(output="uint8")) as one:
        return one.render(EYES)


@pytest.mark.gl
def test_it_falls_on_this_picture_alone(backend: RendererBackend) -> None:
    """Else the server's own light falls, also on another avatar and after a lost context."""
    for name, content in (("", ROD), ("other", OTHER)):
        for light in (ASKED, None):
            job = RenderJob(cameras=tuple(EYES), avatar=name, options=PictureOptions(light=light))
            assert np.array_equal(backend.render(job).images, direct(content, light or DARK))
    assert not np.array_equal(direct(ROD, ASKED), direct(ROD, DARK))
    backend.render(RenderJob(cameras=tuple(EYES), options=PictureOptions(light=ASKED)))
    backend.close()
    backend.open()
    assert np.array_equal(backend.render(RenderJob(cameras=tuple(EYES))).images, direct(ROD, DARK))


@pytest.mark.gl
def test_in_a_room_everybody_is_lit_as_the_viewer_asked(backend: RendererBackend) -> None:
    """The viewer's space is turned in the room: what they see is what they see alone."""
    seat = similarity((0.4, 0, -0.3), (0, 1, 0, 0.7))
    member = Member(Room("lab"), Person(1, "Ann", "", seat, "", 0.0), Pose.zero(len(ROD.skeleton)))
    cameras = tuple(replace(camera, viewmat=camera.viewmat @ np.linalg.inv(seat)) for camera in EYES)
    people = (VisiblePerson(1, "Ann", "", Pose.zero(len(ROD.skeleton)), seat),)
    for light in (ASKED, None):
        request = Request(frame_id=1, cameras=tuple(EYES), options=PictureOptions(light=light))
        options = member.options(request)
        room = RoomView("lab", 0, 1, people)
        found = backend.render(RenderJob(cameras=cameras, options=options, room=room)).images
        wanted = direct(ROD, light)
        assert np.abs(found.astype(int) - wanted).max() <= 1  # turned there and back in floats
        assert wanted[..., 3].any()
