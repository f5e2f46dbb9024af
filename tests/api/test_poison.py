"""Calls that must not wait for ever, and failures that must not spoil the calls after them."""

from __future__ import annotations

import gc
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import moderngl
import numpy as np
import pytest

import glsplat
from glsplat.errors import ContextError, GlsplatError
from glsplat.gl.context import create_context
from glsplat.renderer import Renderer
from glsplat.scene import Scene
from tests.api.current_context import nothing_current
from tests.api.variants import SIZE, VIEWS, sheet
from tests.scenes import cloud, limb

pytestmark = pytest.mark.gl
ROOT = Path(__file__).resolve().parents[2]
SPLATS = cloud(40)


@pytest.fixture(autouse=True)
def _nothing_before() -> Iterator[None]:
    nothing_current()
    yield
    nothing_current()


@pytest.fixture(scope="module")
def picture() -> np.ndarray[Any, Any]:
    with Renderer(SPLATS, size=(SIZE, SIZE)) as renderer:
        return renderer.render(VIEWS)


def within(seconds: float, call: Callable[[], Any]) -> Any:
    """What ``call`` returns or raises on a thread that may hang without taking the tests with it."""
    done: Future[Any] = Future()

    def run() -> None:
        try:
            done.set_result(call())
        except BaseException as error:
            done.set_exception(error)

    threading.Thread(target=run, daemon=True).start()
    return done.result(seconds)


def test_items_come_and_go_while_another_thread_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    """A frame shows the scene as its beginning finds it. What changes in between comes with the next one."""
    mine = glsplat.Item(SPLATS), glsplat.Item(limb()), glsplat.Item(sheet())
    scene, moving = glsplat.Scene(mine), True
    items = Scene.items.fget
    assert items is not None

    def read(self: Scene) -> tuple[glsplat.Item, ...]:
        found = items(self)
        if moving:  # another thread's turn, whenever the scene is looked at
            for item in mine[1:]:
                (self.remove if item in found else self.add)(item)
                item.visible = not item.visible
        return found

    monkeypatch.setattr(Scene, "items", property(read))
    with Renderer(scene, size=(SIZE, SIZE)) as renderer:
        for step in range(40):
            renderer.render(VIEWS)
            mine[step % 3].visible = True
        moving = False
        for item in mine:
            item.visible = True
            if item not in scene.items:
                scene.add(item)
        last = renderer.render(VIEWS)
    with Renderer(scene, size=(SIZE, SIZE)) as renderer:
        assert np.array_equal(renderer.render(VIEWS), last)


def test_threads_that_take_items_out_take_their_own() -> None:
    mine = [[glsplat.Item(SPLATS) for _ in range(300)] for _ in range(4)]
    scene = glsplat.Scene([item for pack in mine for item in pack])
    stays = scene.add(glsplat.Item(SPLATS))
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        threads = [threading.Thread(target=lambda pack=pack: [scene.remove(item) for item in pack]) for pack in mine]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    finally:
        sys.setswitchinterval(interval)
    assert scene.items == (stays,)


# ------------------------------------------------------------------------------------------- what a failure leaves over

WRONG: list[dict[str, Any]] = [
    {"config": {"output": "float32"}},
    {"config": {}},
    {"context": 5},
    {"context": ""},
    {"context": moderngl},
    {"views": 1.5},
    {"views": 0},
    {"size": 64},
    {"size": (64.0, 48.0)},
    {"timed": "no"},
]


def test_a_refused_renderer_leaves_nothing(picture: np.ndarray[Any, Any], recwarn: pytest.WarningsRecorder) -> None:
    """No context, no warning, no noise from a destructor, and the calls after it are right."""
    gc.collect()
    recwarn.clear()
    for scene, arguments in [(SPLATS, wrong) for wrong in WRONG] + [(5, wrong) for wrong in [{}, *WRONG]]:
        with pytest.raises(GlsplatError) as caught:
            Renderer(scene, **arguments)
        assert "\n" not in str(caught.value)
        del caught
    with pytest.raises(GlsplatError):
        Renderer("avatar.glb")  # type: ignore[arg-type]
    gc.collect()
    with Renderer(SPLATS, size=(SIZE, SIZE)) as renderer:
        assert np.array_equal(renderer.render(VIEWS), picture)
    assert not recwarn.list


def test_a_context_that_was_released_while_it_was_current_spoils_nothing(picture: np.ndarray[Any, Any]) -> None:
    """Neither before a renderer is made, nor before a frame, nor where a context was given."""

    def dead() -> None:
        context = moderngl.create_context(standalone=True, backend="egl")
        context.release()

    dead()
    with Renderer(SPLATS, size=(SIZE, SIZE)) as renderer:
        for _ in range(3):
            dead()
            assert np.array_equal(renderer.render(VIEWS), picture)
    users = moderngl.create_context(standalone=True, backend="egl")
    given = create_context(given=users)
    dead()
    with Renderer(SPLATS, size=(SIZE, SIZE), context=given) as renderer:
        assert np.array_equal(renderer.render(VIEWS), picture)
        dead()
        assert np.array_equal(renderer.render(VIEWS), picture)
    given.release()
    dead()
    create_context().release()
    users.release()


def test_a_context_dropped_while_it_was_current_spoils_nothing(picture: np.ndarray[Any, Any]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)
        context: Any = create_context()  # stays current
        again: Any = create_context()
        cycle: list[Any] = [context, again]
        cycle.append(cycle)
        del context, again, cycle  # the collector comes while another renderer works
        with Renderer(SPLATS, size=(SIZE, SIZE)) as renderer:
            gc.collect()
            assert np.array_equal(renderer.render(VIEWS), picture)


# ----------------------------------------------------------------------------------------------- a frame within a frame


def test_two_renderers_of_one_context_do_not_draw_within_each_other() -> None:
    context = create_context()
    reading: list[Any] = []

    class Restless(glsplat.Scene):
        """A scene that renders when it is looked at, in the middle of a call."""

        @property
        def items(self) -> tuple[glsplat.Item, ...]:
            while reading:
                try:
                    calls.append(reading.pop().render(list(views())))
                except ContextError as error:
                    calls.append(error)
            return super().items

    with (
        Renderer(Restless([glsplat.Item(SPLATS)]), size=(SIZE, SIZE), context=context) as one,
        Renderer(SPLATS, size=(SIZE, SIZE), context=context) as other,
        Renderer(SPLATS, size=(SIZE, SIZE)) as elsewhere,
    ):
        expected = one.render(VIEWS)
        calls: list[Any] = []

        def views() -> Iterator[glsplat.Camera]:
            yield from VIEWS

        reading += [elsewhere, other]
        assert np.array_equal(one.render(VIEWS), expected)
        with context:  # a stay is no frame
            assert np.array_equal(one.render(VIEWS), expected)
        refusals = [call for call in calls if isinstance(call, ContextError)]
        assert all(np.array_equal(call, expected) for call in calls if not isinstance(call, ContextError))
        assert len(calls) >= 2 and all("Renderer.render()" in str(error) for error in refusals)
    context.release()
