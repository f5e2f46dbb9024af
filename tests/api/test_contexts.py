"""Contexts of several renderers in one process: each draws in its own and gives back what was current."""

from __future__ import annotations

import ctypes.util
import itertools
import os
from collections.abc import Callable, Iterator
from typing import Any

import moderngl
import numpy as np
import pytest
from numpy.typing import NDArray

from glsplat.errors import ContextError, GlsplatError, PoseError
from glsplat.gl.context import create_context
from glsplat.renderer import Renderer
from glsplat.renderer.probe import Probe
from glsplat.renderer.read_back import read_floats
from tests import needs
from tests.api.current_context import asked, nothing_current
from tests.api.variants import BACK, KINDS, SIZE, VIEWS, bent, splats
from tests.scenes import camera, cloud, limb
from tests.xvfb import display, python  # noqa: F401  (a fixture)

pytestmark = [pytest.mark.gl, pytest.mark.check]


@pytest.fixture(autouse=True)
def _nothing_before() -> Iterator[None]:
    nothing_current()
    yield
    nothing_current()


@pytest.fixture(scope="module")
def alone() -> dict[str, NDArray[Any]]:
    """Every kind's picture, made when no other renderer was there."""
    pictures = {}
    for kind in KINDS:
        with kind.make() as renderer:
            pictures[kind.name] = kind.draw(renderer)
            assert np.ptp(pictures[kind.name]) > 0
    return pictures


@pytest.mark.parametrize("shared", [False, True], ids=["own contexts", "one context"])
def test_every_pair_of_kinds_in_turn(alone: dict[str, NDArray[Any]], shared: bool) -> None:
    context = create_context() if shared else None
    renderers = [(kind, kind.make(context)) for kind in KINDS]
    wrong = set()
    for (first, a), (second, b) in itertools.permutations(renderers, 2):
        for kind, renderer in ((first, a), (second, b), (first, a)):
            if not np.array_equal(kind.draw(renderer), alone[kind.name]):
                wrong.add((kind.name, first.name, second.name))
    for _, renderer in renderers:
        renderer.release()
    if context is not None:
        assert context.ctx.error == "GL_NO_ERROR"
        context.release()
    assert not wrong


def every_call(renderer: Probe, pose: Any) -> Iterator[Callable[[], object]]:
    yield lambda: renderer.render(VIEWS, pose)
    yield lambda: renderer.draw(VIEWS, pose)
    yield lambda: renderer.redraw(VIEWS)
    yield renderer.posed
    yield renderer.nbytes
    yield lambda: renderer.timings
    yield lambda: renderer.resize(SIZE, SIZE)
    yield renderer.drop_targets
    yield lambda: renderer.render([VIEWS[0]], pose)
    yield lambda: renderer.load(limb())
    yield renderer.release


@pytest.mark.parametrize("before", ["none", "egl with a surface", "another of glsplat"])
def test_every_call_gives_back_what_was_current(before: str) -> None:
    users = None
    if before == "egl with a surface":
        users = Pbuffer()
    elif before == "another of glsplat":
        users = create_context()
    was = asked()
    assert bool(was[0]) == (before != "none")
    renderer = Probe(limb(), size=(SIZE, SIZE))
    assert asked() == was
    for call in every_call(renderer, bent()):
        call()
        assert asked() == was
    with pytest.raises(GlsplatError, match="released"):
        renderer.render(VIEWS)
    mesh = KINDS[-1].make()
    KINDS[-1].draw(mesh)
    assert asked() == was
    mesh.release()
    with pytest.raises(PoseError), splats("limb", limb()).make() as other:
        other.render(VIEWS, bent(9))
    assert asked() == was
    if users is not None:
        users.release()


class Pbuffer:
    """Somebody else's EGL context with a surface, made through no library of Python's."""

    def __init__(self) -> None:
        egl = self._egl = ctypes.CDLL("libEGL.so.1")
        pointer, integer = ctypes.c_void_p, ctypes.c_int
        for name, result in (
            ("eglGetDisplay", pointer),
            ("eglCreateContext", pointer),
            ("eglCreatePbufferSurface", pointer),
        ):
            getattr(egl, name).restype = result
        egl.eglGetProcAddress.restype = pointer
        query = ctypes.CFUNCTYPE(integer, integer, pointer, pointer)(egl.eglGetProcAddress(b"eglQueryDevicesEXT"))
        devices, count = (pointer * 8)(), integer()
        query(8, devices, ctypes.byref(count))
        platform = ctypes.CFUNCTYPE(pointer, integer, pointer, pointer)(
            egl.eglGetProcAddress(b"eglGetPlatformDisplayEXT")
        )
        shown = self._display = pointer(platform(0x313F, devices[0], None))
        egl.eglInitialize(shown, None, None)
        config, number = pointer(), integer()
        wanted = (integer * 5)(0x3033, 1, 0x3040, 8, 0x3038)  # pbuffers, desktop OpenGL
        egl.eglChooseConfig(shown, wanted, ctypes.byref(config), 1, ctypes.byref(number))
        egl.eglBindAPI(0x30A2)
        version = (integer * 5)(0x3098, 3, 0x30FB, 3, 0x3038)
        self._context = pointer(egl.eglCreateContext(shown, config, None, version))
        surface = pointer(egl.eglCreatePbufferSurface(shown, config, (integer * 5)(0x3057, 8, 0x3056, 8, 0x3038)))
        assert egl.eglMakeCurrent(shown, surface, surface, self._context)

    def release(self) -> None:
        self._egl.eglMakeCurrent(self._display, None, None, None)
        self._egl.eglDestroyContext(self._display, self._context)


def test_a_context_stays_current_where_none_was() -> None:
    context = create_context()
    mine = asked()
    assert mine[0]
    other = create_context()
    assert asked() == mine
    with other:
        assert asked()[0] not in (None, mine[0])
        with context:
            assert asked() == mine
        assert asked()[0] != mine[0]
    assert asked() == mine
    other.release()
    assert asked() == mine
    context.release()
    context.release()
    assert not asked()[0] and context.released
    with pytest.raises(ContextError, match="this context was released"):
        Renderer(cloud(), context=context)


def test_a_context_that_cannot_become_current() -> None:
    """It is current on another thread, as EGL sees it."""
    import threading

    context, taken, done = create_context(), threading.Event(), threading.Event()
    renderer = Renderer(cloud(), size=(SIZE, SIZE), context=context)
    nothing_current()

    def hold() -> None:
        with context.ctx:
            taken.set()
            done.wait(60)

    thread = threading.Thread(target=hold)
    thread.start()
    assert taken.wait(60)
    with pytest.raises(ContextError, match="cannot become current"):
        renderer.render(VIEWS)
    assert not asked()[0]
    done.set()
    thread.join()
    assert renderer.render(VIEWS).any()
    renderer.release()
    context.release()


def test_moderngls_default_context_is_left_to_the_user() -> None:
    users = moderngl.create_context(standalone=True, backend="egl")
    renderer = Renderer(cloud(), size=(SIZE, SIZE))
    assert moderngl.get_context() is users
    renderer.release()
    assert moderngl.get_context() is users
    users.release()


def test_the_device_variable_is_put_back(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GLCONTEXT_DEVICE_INDEX", "31")  # there are not so many: it would fail if it were heard
    create_context().release()
    assert os.environ["GLCONTEXT_DEVICE_INDEX"] == "31"
    with pytest.raises(ContextError, match="no EGL device"):
        create_context(99)
    assert os.environ["GLCONTEXT_DEVICE_INDEX"] == "31"


def test_draw_shows_what_render_returns() -> None:
    lower = camera(SIZE, sh_degree=0)
    for views in (VIEWS, (VIEWS[0], BACK), (VIEWS[0], lower), (lower, BACK), VIEWS[:1]):
        for order in ("shared", "per_view"):
            kind = splats("any", cloud(400, 2, spread=0.8), output="float32", target="32f", order=order)
            with kind.make() as renderer:
                expected = renderer.render(views)
                drawn, render_stats = np.empty_like(expected), renderer.stats
                target = renderer.draw(views)
                with renderer.context:
                    read_floats(target, drawn)
                assert np.array_equal(drawn, expected)
                assert renderer.stats.drawn == render_stats.drawn and renderer.stats.culled == render_stats.culled
                assert np.array_equal(renderer.render(views), expected)


@pytest.mark.parametrize("window", [False, True], ids=["egl and osmesa", "egl, osmesa and a window"])
def test_three_libraries_in_turn(window: bool, request: pytest.FixtureRequest) -> None:
    needs.require("osmesa")
    where = request.getfixturevalue("display") if window else None
    done = python("-m", "tests.api.libraries_in_turn", *(["window"] if window else []), display=where)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "right", done.stdout


def test_views_may_be_any_iterable() -> None:
    with KINDS[0].make() as renderer:
        expected = renderer.render(VIEWS)
        for views in ((view for view in VIEWS), np.array(VIEWS)):
            assert np.array_equal(renderer.render(views), expected)  # type: ignore[arg-type]
