"""A rigged mesh behind a server is an avatar: posed, tracked, chosen by name, seen from inside, cut out."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from glsplat.config import RenderConfig
from glsplat.errors import GlsplatError, PoseError
from glsplat.formats.scene_file import SceneFile
from glsplat.net.backend import Rendered, RenderJob
from glsplat.net.backends.gl import RendererBackend
from glsplat.net.client import Client
from glsplat.net.room_view import RoomView, VisiblePerson
from glsplat.net.served_scene import gl_server
from glsplat.net.server import ServerConfig
from glsplat.net.worker.process import process_worker
from glsplat.net.worker.worker import ThreadWorker
from glsplat.scene import Item, Scene, similarity
from glsplat.skinning.pose import Pose
from tests.net.backends.test_renderer_pool import BENT, PAIR, SIZE, direct, request
from tests.net.running import opened, running, working
from tests.scene.people import boxes
from tests.scene.worlds import upright
from tests.scenes import limb

pytestmark = pytest.mark.gl
PERSON = boxes()
ROOM = upright(-0.8, 1.5, (90, 80, 70))  # one joint: it stands


def done(out: Rendered) -> None:
    if out.done is not None:
        out.done()


@pytest.mark.check
@pytest.mark.parametrize("own_process", [False, True])
async def test_poses_parts_and_boxes(own_process: bool) -> None:
    """In a room of one joint, beside another avatar by name."""
    scene = Scene([Item(ROOM), Item(PERSON)])
    make = partial(RendererBackend, scene, SIZE, avatars={"rod": limb(200), "twin": PERSON})
    async with working(process_worker(make, 128) if own_process else ThreadWorker(make())) as worker:
        for pose in (None, BENT):
            for hide, mesh in (((), PERSON), (("head",), PERSON.without("head"))):
                out = await worker.draw(request(pose=pose, hide=hide, box=True))
                assert (out.images == direct(Scene([Item(ROOM), Item(mesh)]), pose=pose)).all()
                vertices = mesh.posed(pose or Pose.zero())[np.unique(mesh.faces)]
                low, high = np.reshape(out.places["box"], (2, 3))
                assert (low <= vertices.min(axis=0) + 0.02).all() and (high >= vertices.max(axis=0) - 0.02).all()
                assert (high - low < 1.25 * np.ptp(vertices, axis=0) + 0.1).all()
                done(out)
        for name, thing in (("rod", limb(200)), ("twin", PERSON)):
            out = await worker.draw(request(avatar=name))
            assert (out.images == direct(thing)).all()
            done(out)


def test_what_may_be_served() -> None:
    (one,) = gl_server(PERSON, ServerConfig(port=0), own_process=False).session()["avatars"]
    assert one["head"] and one["tracking"]
    (room,) = gl_server(ROOM, ServerConfig(port=0), own_process=False).session()["avatars"]
    assert not room["head"] and not room["tracking"]
    both = gl_server(limb(50), ServerConfig(port=0), own_process=False, avatars={"mesh": PERSON}).session()["avatars"]
    assert [entry["name"] for entry in both] == ["default", "mesh"]
    gl_server(PERSON, rendering=RenderConfig(cull_hidden=True), avatars={"mesh": PERSON})  # nothing to cull
    with pytest.raises(GlsplatError, match='"room": clients choose avatars, not RiggedMesh without joints to move'):
        gl_server(PERSON, avatars={"room": ROOM})


async def test_tracking_moves_a_mesh_and_alpha_cuts_it_out() -> None:
    sample = {"head": [0.1, 1.6, 0, 0, 0, 0, 1], "left": [-0.4, 1.2, -0.4, 0, 0, 0, 1]}
    async with running(gl_server(PERSON, ServerConfig(port=0), own_process=False)) as server:
        async with Client(server.url) as client:
            posed = await client.render(PAIR, pose=BENT, alpha=True, quality=95)
            tracked = await client.render(PAIR, tracking=sample, alpha=True)
            posed, tracked = np.asarray(posed.rgba()), np.asarray(tracked.rgba())
    expected = direct(PERSON, pose=BENT)
    assert ((expected[..., 3] > 0) & (expected[..., 3] < 255)).sum() > 50  # antialiased
    assert np.abs(posed[..., 3].astype(int) - expected[..., 3]).max() <= 16  # a JPEG of its own
    assert np.abs(posed.astype(float) - expected)[expected[..., 3] == 255].mean() < 12
    assert tracked[..., 3].any() and (tracked[..., 3] != expected[..., 3]).any()


def test_a_mesh_without_its_head() -> None:
    bare = PERSON.without("head")
    gone = PERSON.skeleton.under("head")
    assert len(bare.faces) == len(PERSON.faces) - 12 * gone.sum()  # a box a joint
    heights = bare.vertices[np.unique(bare.faces), 1].max(), PERSON.vertices[:, 1].max()
    assert heights[0] < heights[1] - 0.1
    with pytest.raises(PoseError, match="no joint"):
        PERSON.without("tail")
    with pytest.raises(PoseError, match='without "pelvis" has no triangle left'):
        PERSON.without("pelvis")


@pytest.mark.parametrize("alone", [True, False])
def test_a_mesh_that_is_all_head_is_refused_to_its_own_viewer_alone(alone: bool) -> None:
    """Nothing is left to draw without the head; others see it, and the next picture is drawn as ever."""
    head = PERSON.skeleton.names.index("head")
    bound = np.full((len(PERSON.vertices), 1), head), np.ones((len(PERSON.vertices), 1))
    mesh = replace(PERSON, joints=bound[0], weights=bound[1])
    scene = Scene([Item(ROOM), Item(mesh)])
    people = tuple(VisiblePerson(key, "", "", BENT, similarity((0.3 * key, 0, 0))) for key in range(2))

    def job(viewer: int, *hide: str) -> RenderJob:
        return request(pose=BENT, hide=hide, room=None if alone else RoomView("lab", 0, viewer, people[: 1 + viewer]))

    with opened(RendererBackend(scene, SIZE, rooms={"lab": SceneFile.of(Scene([Item(ROOM)]))})) as backend:
        for viewer in (0, 1) if not alone else (0,):
            expected = [Item(mesh, pose=BENT, transform=one.transform) for one in people[: 1 + viewer]]
            for _ in range(2):
                with pytest.raises(PoseError, match='a mesh without "head" has no triangle left'):
                    backend.render(job(viewer, "head"))
                assert (backend.render(job(viewer)).images == direct(Scene([Item(ROOM), *expected]))).all()


def test_one_pose_is_for_one_figure(renderer_of) -> None:
    """Standing meshes and hidden ones are none; a mesh with joints beside an avatar is another."""
    scene = Scene([Item(ROOM), Item(PERSON, transform=similarity((0.1, 0, 0)))])
    assert [item.content for item in scene.figures] == [PERSON]
    renderer = renderer_of(scene, size=SIZE, views=2)
    assert (renderer.render(PAIR, BENT) != renderer.render(PAIR)).any()
    other = scene.add(Item(replace(limb(50), meta={})))
    with pytest.raises(PoseError, match="one pose for 2 avatars"):
        renderer.render(PAIR, BENT)
    other.visible = False
    renderer.render(PAIR, BENT)
