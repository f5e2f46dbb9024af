"""Rooms drawn by OpenGL: what each client gets against a direct render of the same scene, and how often is skinned."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.camera import Camera, head_matrix, look_at, pinhole, stereo_cameras
from glsplat.config import RenderConfig
from glsplat.data import default_avatar
from glsplat.gl.context import Context, create_context
from glsplat.net.backend import RenderJob
from glsplat.net.backends.figure_bounds import FigureBounds
from glsplat.net.backends.labels import Label
from glsplat.net.backends.lettering import draw_labels
from glsplat.net.backends.renderer_pool import RendererPool, SceneRenderer
from glsplat.net.backends.room import RoomRenderer
from glsplat.net.backends.server import make_server
from glsplat.net.client import Client
from glsplat.net.codec.encode import Encoder
from glsplat.net.messages import PictureOptions, WireOptions
from glsplat.net.rooms.view import RoomView, VisiblePerson
from glsplat.net.server import ServerConfig
from glsplat.renderer import Renderer
from glsplat.scene import Item, Rigged, Scene, similarity
from glsplat.scenes.scene_file import SceneFile
from glsplat.skinning.pose import Pose
from tests.scene.people import boxes
from tests.scenes import cloud

SIZE = 128
# 1.6 m high, looking along +z: to the middle of the room
EYES = stereo_cameras(head_matrix((0, 1.5, 0.1), (0, 1, 0, 0)), size=(SIZE, SIZE))
HEADLESS = PictureOptions(hide=("head",))


@pytest.fixture(scope="module")
def person() -> Avatar:
    """The embedded avatar at its coarsest: quick, and a person still."""
    return replace(default_avatar().levels[-1].content, levels=())


def arm(number: int) -> Pose:
    rotations = np.zeros((55, 3))
    rotations[16, 2], rotations[17, 2] = -1.1 + 0.2 * number, 1.1 - 0.1 * number
    return Pose(rotations, (0.02 * number, 0, 0))


def psnr(image: NDArray[np.uint8], wanted: NDArray[np.uint8]) -> float:
    error = np.mean((image.astype(float) - wanted) ** 2)
    return float(10 * np.log10(255**2 / max(float(error), 1e-9)))


@pytest.mark.check
@pytest.mark.gl
@pytest.mark.usefixtures("nobody_fades")
def test_everybody_sees_the_others_where_they_are(person: Avatar) -> None:
    """Five people before a background: each picture against a scene of whole avatars that was put together here."""

    async def talk() -> None:
        background = Item(cloud(500), transform=similarity((0, 1, 0), scale=0.3))
        rooms = {"lab": Scene([background])}
        config = ServerConfig(port=0, wire=WireOptions(size=(SIZE, SIZE), quality=95), rooms={"lab": 5})
        server = make_server(person, config, own_process=False, rooms=rooms)
        await server.start()
        clients = [Client(f"{server.url}?room=lab&name=P{i}", timeout=60) for i in range(5)]
        try:
            for client in clients:
                await client.connect()
            for _ in range(2):  # in the second round everybody is there
                replies = [
                    await client.render(EYES, pose=arm(i).to_smplx(), hide=["head"]) for i, client in enumerate(clients)
                ]
            seats = [channel.member.person.seat for channel in server._channels.values() if channel.member]
            before = server.stats()["rooms"][0]
            for _ in range(4):
                for i, client in enumerate(clients):
                    await client.render(EYES, pose=arm(i + 1).to_smplx(), hide=["head"])
                    await client.render(EYES, pose=arm(i).to_smplx(), hide=["head"])
            after = server.stats()["rooms"][0]
            worst = 99.0
            for i, reply in enumerate(replies):
                wanted = _direct(person, background, seats, i)
                for image, expected in zip(reply.images(), wanted, strict=True):
                    worst = min(worst, psnr(image, expected))
            assert worst >= 45
        finally:
            await asyncio.gather(*(client.close() for client in clients))
            await server.stop()
        assert after["ticks"] - before["ticks"] >= 4

    asyncio.run(talk())


def _direct(person: Avatar, background: Item, seats: list[NDArray[np.float64]], viewer: int) -> list[NDArray[np.uint8]]:
    """Everybody in one scene, the viewer without a head, seen by the viewer's eyes, and what JPEG leaves of it."""
    people = [
        Item(person.without("head") if i == viewer else person, pose=arm(i), transform=seat)
        for i, seat in enumerate(seats)
    ]
    cameras = [replace(eye, viewmat=eye.viewmat @ np.linalg.inv(seats[viewer])) for eye in EYES]
    with Renderer(Scene([background, *people]), size=(SIZE, SIZE), config=RenderConfig()) as renderer:
        images = renderer.render(cameras)
    bounds = FigureBounds(person, 3.33, whole=True)
    words = [
        Label(f"driven by P{i}, synthetic", _above(person, i, seat), box=partial(bounds.box, arm(i), seat))
        for i, seat in enumerate(seats)
        if i != viewer
    ]
    draw_labels(images, cameras, words)
    encoder = Encoder()
    try:
        pictures = encoder.encode(images, 95, False, None, False).pictures
    finally:
        encoder.close()
    return [cv2.cvtColor(cv2.imdecode(np.frombuffer(p, np.uint8), 1), cv2.COLOR_BGR2RGB) for p in pictures]


def _above(person: Avatar, number: int, seat: NDArray[np.float64]) -> NDArray[np.float64]:
    """A head's width over the head: .3 m above the joint of somebody who is 1.7 m from ankle to eye."""
    rest = person.skeleton.rest[:, :3, 3]
    head = rest[person.skeleton.names.index("head")] + (0.02 * number, 0, 0)
    tall = np.ptp(rest[:, 1])
    place: NDArray[np.float64] = seat[:3, :3] @ (head + (0, 0.3 * tall / 1.7, 0)) + seat[:3, 3]
    return place


@pytest.mark.gl
def test_each_person_is_skinned_once_a_tick(context: Context, person: Avatar) -> None:
    """Six people, six viewers with their own heads left out: two item passes (body, head) a person and tick."""
    pool = standing(context, person)
    people = [VisiblePerson(i, f"P{i}", "", arm(i), similarity((i, 0, 0)), label=f"P{i}") for i in range(6)]
    posed = []
    for tick in range(4):
        for viewer in range(6):
            people[viewer] = replace(people[viewer], pose=arm(tick + viewer))
            request = RenderJob(
                frame_id=1, cameras=tuple(EYES), options=HEADLESS, room=RoomView("lab", tick, viewer, tuple(people))
            )
            one = pool.of(request)
            one.follow(request, 0.0)
            one.renderer.selector = one.selector(viewer)
            one.renderer.render(one.views(request))
            posed.append(one.renderer.stats.posed)
    pool.release()
    assert sum(posed) == 2 * 6 * 4 - 1  # nobody has looked at the last viewer's head since


@pytest.fixture
def context() -> Iterator[Context]:
    """One of its own: the shared one would stay current for the backends of other tests on this thread."""
    context = create_context()
    yield context
    context.release()


def drawing(context: Context) -> Callable[[Scene], Renderer]:
    return partial(Renderer, size=(SIZE, SIZE), config=RenderConfig(output="uint8"), context=context)


def left_out(one: SceneRenderer | RoomRenderer, request: RenderJob) -> list[Item]:
    return [item for item in one.scene if not item.layers & one.views(request)[0].layers]


def standing(context: Context, person: Rigged) -> RendererPool:
    """An empty room in which everybody is that person."""
    return RendererPool(Scene([Item(person)]), {}, drawing(context), {"lab": SceneFile.of(Scene())})


@pytest.mark.gl
def test_labels_cannot_be_left_out_and_fade_with_their_people(context: Context, person: Avatar) -> None:
    pool = standing(context, person)
    two = (
        VisiblePerson(1, "Ann", "", arm(0), np.eye(4), label="driven by Ann"),
        VisiblePerson(2, "Bob", "", arm(1), similarity((0, 0, 2)), opacity=0.0, label="driven by Bob"),
    )
    request = RenderJob(frame_id=1, cameras=tuple(EYES), room=RoomView("lab", 0, 1, two))
    one = pool.of(request)
    one.follow(request, 0.0)
    assert [label.text for label in one.labels(request)] == ["driven by Ann", "driven by Bob"]
    assert [label.opacity for label in one.labels(request)] == [1.0, 0.0]
    assert [item.name for item in left_out(one, request)] == ["Bob", "Bob"]
    own = replace(request, options=HEADLESS)
    assert [label.text for label in one.labels(own)] == ["driven by Bob"]
    assert len(left_out(one, own)) == 3
    gone = replace(request, room=RoomView("lab", 1, 1, two[:1]))
    one.follow(gone, 0.0)
    assert len(one.scene) == 2
    pool.release()


@pytest.mark.gl
def test_a_person_of_triangles_loses_the_head_for_their_own_eyes_only(context: Context) -> None:
    mesh, poses = boxes(), (arm(0), arm(1))
    pool = standing(context, mesh)
    places = (np.eye(4), similarity((0.5, 0, 2)))
    two = tuple(VisiblePerson(i, f"P{i}", "", poses[i], places[i]) for i in range(2))
    for viewer, hide in ((0, ("head",)), (1, ("head",)), (0, ())):
        room = RoomView("lab", 0, viewer, two)
        request = RenderJob(frame_id=1, cameras=tuple(EYES), options=PictureOptions(hide=hide), room=room)
        one = pool.of(request)
        one.follow(request, 0.0)
        images = one.renderer.render(one.views(request))
        shown = [mesh.without("head") if hide and i == viewer else mesh for i in range(2)]
        whole = Scene(Item(one, pose=poses[i], transform=places[i]) for i, one in enumerate(shown))
        with drawing(context)(whole) as renderer:
            assert np.array_equal(images, renderer.render(request.cameras))
    pool.release()


def test_a_label_is_at_its_place_in_both_eyes() -> None:
    """The middle of the board is where the cameras put it: so its disparity is that of its distance."""
    place = np.array([0.1, 1.55, 1.6])
    eyes = stereo_cameras(head_matrix((0, 1.5, 0), (0, 1, 0, 0)), ipd=0.064, size=(512, 512))
    images = np.zeros((2, 512, 512, 4), np.uint8)
    box = draw_labels(images, eyes, [Label("driven by Zoë, synthetic", place)])
    middles = []
    for image, camera in zip(images, eyes, strict=True):
        rows, columns = np.nonzero(image[:, :, 3])
        seen = camera.K @ (camera.viewmat[:3, :3] @ place + camera.viewmat[:3, 3])
        middle = (columns.min() + columns.max() + 1) / 2, (rows.min() + rows.max() + 1) / 2
        assert np.abs(np.array(middle) - seen[:2] / seen[2]).max() < 1
        middles.append(middle[0])
        assert image[:, :, :3].max() > 100 and (image[:, :, :3].max(axis=2) <= image[:, :, 3]).all()
        x, y, width, height = box
        outside = image.copy()
        outside[y : y + height, x : x + width] = 0
        assert not outside.any()
    assert middles[0] - middles[1] == pytest.approx(eyes[0].K[0, 0] * 0.064 / 1.6, abs=1)


@pytest.mark.parametrize("behind", [-2.0, 0.0, 0.005])
def test_a_label_behind_the_eyes_is_not_drawn(behind: float) -> None:
    images = np.zeros((2, 64, 64, 4), np.uint8)
    eyes = stereo_cameras(head_matrix((0, 1.5, 0), (0, 1, 0, 0)), size=(64, 64))
    assert draw_labels(images, eyes, [Label("driven by Ann", np.array([0, 1.5, behind]))]) == (0, 0, 0, 0)
    assert not images.any()


def test_labels_are_read_from_left_to_right_in_a_mirror_too() -> None:
    eye = Camera(look_at((0, 1.5, 0), (0, 1.5, 2)), pinhole(256, 256), 256, 256)
    mirror = Camera(eye.viewmat @ np.diag([-1.0, 1, 1, 1]), eye.K, 256, 256)
    label = Label("LLL ...", np.array([0, 1.5, 1.0]), 0.1)
    pictures = np.zeros((2, 1, 256, 256, 4), np.uint8)
    for picture, camera in zip(pictures, (eye, mirror), strict=True):
        draw_labels(picture, [camera], [label])
    assert np.array_equal(pictures[0], pictures[1])


def test_a_notice_is_in_the_picture_wherever_one_looks() -> None:
    for target in ((0, 0, 1), (3, 9, -2), (0, -1, 0.01)):
        eye = Camera(look_at((0, 1.5, 0), target), pinhole(320, 240), 320, 240)
        image = np.zeros((1, 240, 320, 4), np.uint8)
        x, y, width, height = draw_labels(image, [eye], [], "no consent on file")
        assert 0 < x and x + width < 320 and 160 < y and y + height < 240
        assert cv2.countNonZero(image[0, :, :, 0]) > 100
