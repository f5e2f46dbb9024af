"""Every single allocation of GL objects refused in turn: what stood stays, what is broken off leaves nothing behind."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import moderngl
import numpy as np
import pytest
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.config import RenderConfig
from glsplat.errors import ContextError
from glsplat.gl.context import Context, create_context
from glsplat.renderer import Renderer
from glsplat.scene import Item, Scene, similarity
from glsplat.splats import Splats
from tests.scene.worlds import upright
from tests.scenes import cloud, eyes, limb

pytestmark = pytest.mark.gl

SIZE = 40
# programs are kept by the renderer for the next scene
MAKES = "buffer texture texture_array texture3d depth_texture renderbuffer depth_renderbuffer".split()
MAKES += "framebuffer vertex_array query sampler".split()


class Short:
    """A driver that runs out of memory at the ``fails``-th object from now on; knows every object it made."""

    def __init__(self, ctx: moderngl.Context, patch: pytest.MonkeyPatch) -> None:
        self.made: list[Any] = []
        self.fails, self.asked, self.where = 0, 0, ""
        for name in MAKES:
            patch.setattr(ctx, name, self._counted(name, getattr(ctx, name)))

    def _counted(self, name: str, make: Callable[..., Any]) -> Callable[..., Any]:
        def counted(*args: Any, **options: Any) -> Any:
            self.asked += 1
            if self.asked == self.fails:
                self.where = name
                raise moderngl.Error(f"cannot create {name}")
            made = make(*args, **options)
            self.made.append(made)
            return made

        return counted

    def left(self) -> set[int]:
        """The objects that were not released."""
        return {id(item) for item in self.made if not isinstance(item.mglo, moderngl.InvalidObject)}

    def each(self, attempt: Callable[[], object]) -> Iterator[int]:
        """``attempt`` with the first, second, ... object refused, until it needs no more; yields after each refusal."""
        for fails in range(1, 200):
            self.fails, self.asked = fails, 0
            try:
                attempt()
            except (moderngl.Error, ContextError):
                assert self.asked >= fails
            else:
                assert self.asked < fails, f"object {fails} ({self.where}) was refused and nobody said so"
                self.fails = 0
                return
            self.fails = 0
            yield fails
        raise AssertionError("no end")


@pytest.fixture
def driver() -> Iterator[tuple[Context, Short]]:
    patch = pytest.MonkeyPatch()
    context = create_context()
    yield context, Short(context.ctx, patch)
    patch.undo()
    context.release()


def several() -> Scene:
    """Everything that has buffers of its own: skin, place, mesh, mixed opacity compensation."""
    smooth = Item(replace(cloud(30, seed=3), antialias=True), transform=similarity((0.4, 0, 0)))
    return Scene([Item(limb(60)), Item(cloud(40, degree=1, seed=2)), smooth, Item(upright(0.1, 0.5, (200, 0, 9)))])


def hidden() -> Splats:
    splats = cloud(50, seed=1, degree=2)
    return replace(splats, cones=np.tile(np.array([0, 0, 127, -100], np.int8), (len(splats), 1)))


SHOWN: dict[str, Callable[[], Splats | Avatar | Scene]] = {
    "splats": lambda: cloud(50, seed=1, degree=2),
    "cones": hidden,
    "scene": several,
}
CONFIGS = {"cones": RenderConfig(cull_hidden=True)}
# the scene has everything that the others have
EACH = [pytest.param("cones", marks=pytest.mark.check), "scene"]


def made(context: Context, shown: str) -> Renderer:
    config = CONFIGS.get(shown, RenderConfig())
    return Renderer(SHOWN[shown](), size=(SIZE, SIZE), views=2, config=config, context=context)


@pytest.mark.parametrize("shown", EACH)
def test_a_renderer_that_is_not_made_leaves_nothing(driver: tuple[Context, Short], shown: str) -> None:
    context, short = driver
    times = 0
    for times in short.each(lambda: made(context, shown).release()):
        assert not short.left(), (times, short.where)
    assert times >= 3 and not short.left()


@pytest.mark.parametrize("shown", EACH)
@pytest.mark.parametrize("stands", ["splats", pytest.param("scene", marks=pytest.mark.check)])
def test_load_that_fails_leaves_the_old_scene(driver: tuple[Context, Short], stands: str, shown: str) -> None:
    context, short = driver
    with made(context, stands) as renderer:
        picture, before, times = renderer.render(eyes(SIZE)), short.left(), 0
        for times in short.each(lambda: renderer.load(SHOWN[shown]())):
            assert short.left() == before, (times, short.where)
            assert np.array_equal(renderer.render(eyes(SIZE)), picture) and renderer.timings["total"] > 0
        assert times >= 2
        with Renderer(SHOWN[shown](), size=(SIZE, SIZE), views=2, context=context) as other:
            expected = other.render(eyes(SIZE))
        assert np.array_equal(renderer.render(eyes(SIZE)), expected)
    assert not short.left()


@pytest.mark.parametrize("depth", [False, True], ids=["colour", "depth"])
@pytest.mark.parametrize("shown", EACH)
def test_a_frame_that_fails_is_drawn_the_next_time(driver: tuple[Context, Short], shown: str, depth: bool) -> None:
    """First frames make pipelines, mesh passes and targets; each attempt begins with a renderer that has none."""
    context, short = driver

    def frame(renderer: Renderer) -> list[NDArray[Any]]:
        out = renderer.render(eyes(SIZE), depth=True) if depth else [renderer.render(eyes(SIZE))]
        return list(out)

    with made(context, shown) as renderer:
        expected = frame(renderer)
    fails = 0
    while True:
        fails += 1
        with made(context, shown) as renderer:
            short.fails, short.asked = fails, 0
            try:
                frame(renderer)
                done = True
            except (moderngl.Error, ContextError):
                done = False
            needed, short.fails = short.asked, 0
            if not done:
                again = frame(renderer)
                assert all(np.array_equal(a, b) for a, b in zip(again, expected, strict=True)), (fails, short.where)
        assert not short.left(), (fails, short.where)
        if done:
            assert needed < fails
            break
    assert fails > 8


@pytest.mark.parametrize("shown", ["splats", "mesh"])
def test_an_item_that_does_not_fit_can_be_taken_out_again(driver: tuple[Context, Short], shown: str) -> None:
    context, short = driver
    scene = Scene([Item(limb(60)), Item(cloud(40))])
    extra = Item(upright(0.1, 0.5, (200, 0, 9)) if shown == "mesh" else SHOWN[shown]())
    with Renderer(scene, size=(SIZE, SIZE), views=2, context=context) as renderer:
        picture, most = renderer.render(eyes(SIZE)), []

        def added() -> None:
            scene.add(extra)
            renderer.render(eyes(SIZE))

        for _ in range(3):  # vertex arrays and mesh passes are kept for the next time, but never twice
            counts = []
            for times in short.each(added):
                scene.remove(extra)
                assert np.array_equal(renderer.render(eyes(SIZE)), picture), (times, short.where)
                counts.append(len(short.left()))
            scene.remove(extra)
            renderer.render(eyes(SIZE))
            most.append(max(counts))
        assert len(counts) >= 3 and most[2] == most[1] >= most[0]
    assert not short.left()
