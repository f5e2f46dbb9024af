"""Others' splats cost a viewer a share of the time, and never the picture."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.camera import Camera, look_at, pinhole
from glsplat.config import LEAN
from glsplat.data import default_avatar
from glsplat.errors import BudgetError, GlsplatError
from glsplat.formats.scene_file import SceneFile
from glsplat.gl.context import Context
from glsplat.net.backend import RenderJob
from glsplat.net.backends.gl import PictureBudget, RendererBackend, max_cost_of
from glsplat.net.backends.renderer_pool import RendererPool
from glsplat.net.backends.scene_renderer import SceneRenderer, others_share
from glsplat.net.room_view import RoomView, VisiblePerson
from glsplat.net.wire_schema import PictureOptions
from glsplat.renderer import Prepared, Renderer
from glsplat.scene import Item, Scene, similarity
from glsplat.skinning.pose import Pose
from tests.net.running import opened

SIZE = 128
EYE = np.array([0.0, 1.5, 0.0])
VIEW = Camera(look_at(EYE, (0, 1.5, 1)), pinhole(SIZE, SIZE), SIZE, SIZE)
MOST = max_cost_of(LEAN)
PERSON = replace(default_avatar().levels[1].content, levels=default_avatar().levels[2:])
SKELETON = PERSON.skeleton
HEADS = SKELETON.rest[:, :3, 3]
FACING = similarity((0, 0, 1.5), (0, 1, 0, 0))


OFFSETS = HEADS - np.where(SKELETON.parents[:, None] >= 0, HEADS[SKELETON.parents], 0.0)


def collapsed(place: NDArray[np.float64], spread: float = 0.0) -> Pose:
    """Every joint at one place, or ``spread`` metres around it."""
    moves = -OFFSETS + np.random.default_rng(1).normal(0, spread, OFFSETS.shape)
    return Pose(np.zeros((55, 3)), place - HEADS[0], np.where(np.arange(55)[:, None] > 0, moves, 0.0))


def person(
    key: int, pose: Pose | None = None, place: NDArray[np.float64] | None = None, **more: object
) -> VisiblePerson:
    where = np.eye(4) if place is None else place
    return VisiblePerson(key, f"P{key}", "", pose or Pose.zero(55), where, **more)


ANN = person(0, place=similarity((0, 0, -0.6)))
BOB = person(1, place=FACING)


def eve(
    key: int = 2, ahead: float = 0.06, spread: float = 0.0, place: NDArray[np.float64] | None = None
) -> VisiblePerson:
    """Somebody who has drawn all their joints together right before the viewer's eyes."""
    return person(key, collapsed(EYE + (0, 0, ahead), spread), place)


def job(*people: VisiblePerson, camera: Camera = VIEW, viewer: int = 0, **more: Any) -> RenderJob:
    return RenderJob(cameras=(camera,), frame_id=1, room=RoomView("lab", 0, viewer, people), **more)


Make = Callable[..., SceneRenderer]


@pytest.fixture
def room_of(context: Context) -> Iterator[Make]:
    """Makes empty rooms in which everybody wears that avatar."""
    pools: list[RendererPool] = []

    def make(figure: Avatar = PERSON, **config: Any) -> SceneRenderer:
        rendering = replace(LEAN, output="uint8", **config)
        renderer = partial(Renderer, size=(SIZE, SIZE), config=rendering, context=context)
        pools.append(RendererPool(Scene([Item(figure)]), {}, renderer, {"lab": SceneFile.of(Scene())}))
        one = pools[-1].of(job(ANN))
        return one

    yield make
    for pool in pools:
        pool.release()
    assert context.ctx.error == "GL_NO_ERROR"


def prepared(room: SceneRenderer, one: RenderJob, most: float = MOST) -> Prepared:
    room.follow(one, 0.0)
    return room.prepare(one, most)


def costs(room: SceneRenderer, one: RenderJob) -> dict[str, int]:
    """Of each person's items as they are drawn now."""
    found: dict[str, int] = {}
    for item, cost in room.renderer.prepare(room.views(one), itemised=True).items.items():
        found[item.name] = found.get(item.name, 0) + cost
    return found


@pytest.mark.gl
@pytest.mark.parametrize("sorter", ["cpu", "gpu"])
def test_who_draws_together_before_anothers_eyes_is_left_out_alone(
    room_of: Make, context: Context, sorter: str
) -> None:
    if sorter == "gpu" and not context.compute:
        pytest.skip("this driver has no compute shaders")
    room = room_of(sorter=sorter)
    quiet = prepared(room, job(ANN, BOB))
    wanted, before = quiet.render(), quiet.cost
    people = (ANN, BOB, *(eve(key) for key in range(2, 7)))
    attacked = job(*people)
    room.follow(attacked, 0.0)
    assert room.renderer.prepare(room.views(attacked)).cost > 8 * before  # what they would add
    image = prepared(room, attacked)
    share = others_share(MOST, [VIEW], 6 * len(PERSON.splats))
    assert image.cost <= share
    assert costs(room, attacked)["P1"] == costs(room, job(ANN, BOB))["P1"] > 0  # at the finest level as before
    # nothing is left of it in the next picture
    assert np.array_equal(prepared(room, job(ANN, BOB)).render(), wanted)
    # and in another member's, who is elsewhere, all are there
    far = job(*people, viewer=1, camera=replace(VIEW, viewmat=look_at((0, 1.5, 4), EYE)))
    prepared(room, far)
    assert {name for name, cost in costs(room, far).items() if cost} == {f"P{i}" for i in range(7)}


@pytest.mark.gl
@pytest.mark.parametrize(
    "hostile",
    [
        [eve()],
        [eve(key, ahead) for key, ahead in enumerate((0.011, 0.02, 0.03, 0.1, 0.3, 0.0, -0.05), 2)],
        [eve(key, 0.08, spread) for key, spread in enumerate((0.01, 0.05, 0.3, 3.0, 100.0), 2)],
        [person(2, collapsed(EYE * 0), similarity(EYE + (0, 0, 0.3), scale=0.01))],
        [person(2, None, similarity(EYE - (0, 25, -3), scale=17.0))],
        [person(2, collapsed(EYE / 500), similarity((0, 0, 0.4), scale=500.0))],
        [person(key, None, similarity((0, 0, 0.02 * key))) for key in range(2, 9)],
        [person(2, Pose(np.zeros((55, 3)), (0, 0, 0.3), np.random.default_rng(2).normal(0, 100, (55, 3))))],
    ],
    ids=["one", "depths", "spread", "tiny", "huge", "stretched", "crowd inside", "torn apart"],
)
@pytest.mark.parametrize("level", ["auto", 0])
def test_whatever_others_do_the_viewer_gets_a_picture(
    room_of: Make, hostile: list[VisiblePerson], level: str | int
) -> None:
    room = room_of(level=level)
    own = prepared(room, job(ANN)).cost
    for most in (MOST, 1.05 * own + 1e5, 3e6):
        request = job(ANN, BOB, *hostile)
        drawn = prepared(room, request, most)
        share = others_share(most, [VIEW], (1 + len(hostile)) * len(PERSON.splats))
        theirs = sum(cost for name, cost in costs(room, request).items() if name != "P0")
        most_each = others_share(most, [VIEW], len(PERSON.splats), each=True)
        assert theirs <= share and drawn.cost <= most
        assert all(cost <= most_each for name, cost in costs(room, request).items() if name != "P0")
        PictureBudget(most).render(prepared(room, request, most))


@pytest.mark.gl
def test_what_the_viewer_asks_for_is_theirs(room_of: Make) -> None:
    """Their own splats before their own eyes are refused, whoever else is there."""
    room = room_of()
    for people in ([eve(0)], [eve(0), BOB], [eve(0), BOB, eve(5)]):
        with pytest.raises(BudgetError, match="at most 1e"):
            PictureBudget(1e6).render(prepared(room, job(*people), 1e6))
    assert costs(room, job(eve(0), BOB, eve(5)))["P5"] > 1e6


@pytest.mark.gl
def test_they_are_drawn_coarser_before_they_are_left_out(room_of: Make) -> None:
    """In small pictures fewer splats cost less; in large ones they do not."""
    room = room_of(figure=default_avatar())
    request = job(ANN, eve(2, 0.1))
    room.follow(request, 0.0)
    whole = room.renderer.prepare(room.views(request))
    assert room.renderer.stats.levels == (3, 3, 0, 0)  # body and head of both, the first is out of view
    few = prepared(room, request)
    assert room.renderer.stats.levels == (3, 3, 3, 3) and few.cost < 0.8 * whole.cost
    room.renderer.resize(512, 512)
    large = job(ANN, BOB, eve(2, 0.1), camera=VIEW.resized(512, 512))
    assert {item.name for item in prepared(room, large).items} == {"P0", "P1"}


@pytest.mark.gl
@pytest.mark.parametrize("size", [64, 512])
def test_without_attackers_nobody_is_left_out(room_of: Make, size: int) -> None:
    """The picture is that of the scene without any limit, also of somebody who whispers to the viewer."""
    room = room_of()
    room.renderer.resize(size, size)
    crowd = [
        person(key, place=similarity((1.2 * np.sin(a), 0, 1.2 - 1.2 * np.cos(a)), (0, np.sin(a / 2), 0, np.cos(a / 2))))
        for key, a in enumerate(np.arange(8) * 2 * np.pi / 8)
    ]
    request = job(
        *crowd,
        person(8, place=similarity((0.2, -0.1, 0.3), (0, 1, 0, 0))),
        camera=VIEW.resized(size, size),
        options=PictureOptions(hide=("head",)),
    )
    image = prepared(room, request).render()
    room.renderer.load(room.scene)
    assert np.array_equal(image, room.renderer.render(room.views(request)))


@pytest.mark.gl
def test_who_cannot_be_drawn_is_left_out_and_nobody_else(context: Context, caplog: pytest.LogCaptureFixture) -> None:
    """An avatar that is gone, a pose of other joints: logged once, and back once they can be drawn."""
    make = partial(Renderer, size=(SIZE, SIZE), config=replace(LEAN, output="uint8"), context=context)
    pool = RendererPool(Scene(), {"ann": PERSON, "bob": PERSON}, make, {"lab": SceneFile.of(Scene())})
    ann, bob = replace(ANN, avatar="ann"), replace(BOB, avatar="bob")

    def shown(*people: VisiblePerson, viewer: int = 0) -> NDArray[np.uint8]:
        request = job(*people, viewer=viewer)
        one = pool.of(request)
        return prepared(one, request).render().copy()

    alone, both = shown(ann), shown(ann, bob)
    assert not np.array_equal(alone, both)
    for bad in (replace(bob, avatar="gone", key=3), replace(bob, pose=Pose(np.zeros((4, 3))))):
        for _ in range(2):
            assert np.array_equal(shown(ann, bad), alone)
        assert np.array_equal(shown(ann, bob), both)
    assert [record.message.split()[1] for record in caplog.records] == ["3", "1"]
    with pytest.raises(GlsplatError, match='no avatar "gone"'):  # their own picture says so
        shown(replace(ann, avatar="gone", key=4), bob, viewer=4)
    pool.release()


@pytest.mark.gl
def test_a_suspect_picture_is_drawn_without_the_others() -> None:
    with opened(RendererBackend(PERSON, (SIZE, SIZE), rooms={"lab": SceneFile.of(Scene())}, config=LEAN)) as backend:

        def draw(*people: VisiblePerson, **more: Any) -> NDArray[np.uint8]:
            return backend.render(job(*people, **more)).images.copy()

        alone = draw(ANN)
        assert np.array_equal(draw(ANN, BOB, eve(), others=0.0), alone)
        large = VIEW.resized(512, 512)
        few, some = (draw(ANN, *people, camera=large, others=1 / 4) for people in ([BOB], [BOB, eve()]))
        assert np.array_equal(few, some) and not np.array_equal(few, draw(ANN, camera=large))


def test_the_share_follows_the_picture() -> None:
    """All of a picture of two eyes of 2048 x 2048, and four blocks a splat and view however small the picture is."""
    large = [VIEW.resized(2048, 2048)] * 2
    assert others_share(MOST, large, 0) == MOST
    assert others_share(MOST, large[:1], 0) == MOST / 2 == others_share(MOST, large, 0, each=True)
    assert others_share(MOST, [VIEW.resized(16, 16)], 1000) == 64_000
    assert others_share(float("inf"), large, 10) == float("inf")
