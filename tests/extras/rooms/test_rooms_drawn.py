"""Rooms drawn by OpenGL, against a direct render of the same scene."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.camera import head_matrix, stereo_cameras
from glsplat.config import RenderConfig
from glsplat.formats.scene_file import SceneFile
from glsplat.gl.context import Context
from glsplat.meshes import RiggedMesh
from glsplat.net.backend import RenderJob
from glsplat.net.backends.renderer_pool import RendererPool
from glsplat.net.backends.scene_renderer import SceneRenderer
from glsplat.net.messages import PictureOptions
from glsplat.net.room_view import RoomView, VisiblePerson
from glsplat.renderer import Renderer
from glsplat.scene import Item, Rigged, Scene, similarity
from glsplat.skinning.pose import Pose
from tests.scene.people import boxes
from tests.scenes import cloud

SIZE = 128
# 1.6 m high, looking along +z: to the middle of the room
EYES = stereo_cameras(head_matrix((0, 1.5, 0.1), (0, 1, 0, 0)), size=(SIZE, SIZE))
HEADLESS = PictureOptions(hide=("head",))


def arm(number: int) -> Pose:
    rotations = np.zeros((55, 3))
    rotations[16, 2], rotations[17, 2] = -1.1 + 0.2 * number, 1.1 - 0.1 * number
    return Pose(rotations, (0.02 * number, 0, 0))


def psnr(image: NDArray[np.uint8], wanted: NDArray[np.uint8]) -> float:
    error = np.mean((image.astype(float) - wanted) ** 2)
    return float(10 * np.log10(255**2 / max(float(error), 1e-9)))


@pytest.mark.gl
def test_each_person_is_skinned_once_a_tick(context: Context, somebody: Avatar) -> None:
    """Six people see each other, none sees their own head: two passes (body, head) a person and tick."""
    pool = standing(context, somebody)
    people = [VisiblePerson(i, f"P{i}", "", arm(i), similarity((i, 0, 0))) for i in range(6)]
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


def drawing(context: Context) -> Callable[[Scene], Renderer]:
    return partial(Renderer, size=(SIZE, SIZE), config=RenderConfig(output="uint8"), context=context)


def left_out(one: SceneRenderer, request: RenderJob) -> list[Item]:
    return [item for item in one.scene if not item.layers & one.views(request)[0].layers]


def standing(context: Context, person: Rigged, *background: Item) -> RendererPool:
    """A room in which everybody is that person."""
    return RendererPool(Scene([Item(person)]), {}, drawing(context), {"lab": SceneFile.of(Scene(background))})


@pytest.mark.gl
def test_people_who_faded_and_ones_own_head_are_left_out(context: Context, somebody: Avatar) -> None:
    pool = standing(context, somebody)
    two = (
        VisiblePerson(1, "Ann", "", arm(0), np.eye(4)),
        VisiblePerson(2, "Bob", "", arm(1), similarity((0, 0, 2)), opacity=0.0),
    )
    request = RenderJob(frame_id=1, cameras=tuple(EYES), room=RoomView("lab", 0, 1, two))
    one = pool.of(request)
    one.follow(request, 0.0)
    assert [item.name for item in left_out(one, request)] == ["Bob", "Bob"]
    own = replace(request, options=HEADLESS)
    assert len(left_out(one, own)) == 3
    gone = replace(request, room=RoomView("lab", 1, 1, two[:1]))
    one.follow(gone, 0.0)
    assert len(one.scene) == 2
    pool.release()


@pytest.mark.gl
@pytest.mark.parametrize("kind", ["splats", "triangles"])
def test_each_sees_the_others_whole_and_themselves_without_a_head(
    context: Context, somebody: Avatar, kind: str
) -> None:
    figure: Avatar | RiggedMesh = somebody if kind == "splats" else boxes()
    background, poses = Item(cloud(500), transform=similarity((0, 1, 0), scale=0.3)), (arm(0), arm(1))
    pool = standing(context, figure, background)
    places = (np.eye(4), similarity((0.5, 0, 2)))
    two = tuple(VisiblePerson(i, f"P{i}", "", poses[i], places[i]) for i in range(2))
    for viewer, hide in ((0, ("head",)), (1, ("head",)), (0, ())):
        room = RoomView("lab", 0, viewer, two)
        request = RenderJob(frame_id=1, cameras=tuple(EYES), options=PictureOptions(hide=hide), room=room)
        one = pool.of(request)
        one.follow(request, 0.0)
        images = one.renderer.render(one.views(request))
        shown = [figure.without("head") if hide and i == viewer else figure for i in range(2)]
        people = [Item(one, pose=poses[i], transform=places[i]) for i, one in enumerate(shown)]
        with drawing(context)(Scene([background, *people])) as renderer:
            wanted = renderer.render(request.cameras)
        assert psnr(images, wanted) >= 60
    pool.release()
