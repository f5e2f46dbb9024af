"""A frame broken off at any line: the next one is right, and what was current is current again.

A trace function raises at a line of glsplat's own code chosen at random. ``GLSPLAT_INTERRUPTS=1000`` sets how often.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import glsplat
from glsplat.camera import Camera, look_at
from glsplat.gl.context import create_context
from glsplat.renderer import Renderer
from glsplat.renderer.arena import Arena
from glsplat.renderer.probe import Probe
from tests.api.current_context import asked, nothing_current
from tests.api.variants import KINDS, SIZE, VIEWS, Kind, bent, splats
from tests.scenes import limb

pytestmark = [pytest.mark.gl, pytest.mark.check]

TIMES = int(os.environ.get("GLSPLAT_INTERRUPTS", "240"))
HOME = str(Path(glsplat.__file__).parent)


class Broken(BaseException):
    """Not an Exception: nothing may catch it by accident."""


class Breaker:
    """Runs a call and raises at the n-th line of glsplat it comes to."""

    def __init__(self) -> None:
        self.lines = 0
        self.where = ""
        self._left = 0

    def run(self, call: Callable[[], Any], after: int | None) -> Any:
        """``after`` None: to the end, counting lines."""
        self.lines, self._left, self.where = 0, -1 if after is None else after, ""
        sys.settrace(self._enter)
        try:
            return call()
        finally:
            sys.settrace(None)

    def _enter(self, frame: FrameType, event: str, argument: Any) -> Any:
        return self._step if frame.f_code.co_filename.startswith(HOME) else None

    def _step(self, frame: FrameType, event: str, argument: Any) -> Any:
        # leaving a context is the cleaning up itself: what is broken off there is looked at by another test
        if event == "line" and not leaving(frame):
            self.lines += 1
            if self.lines == self._left:
                self.where = f"{Path(frame.f_code.co_filename).name}:{frame.f_lineno}"
                raise Broken(self.where)
        return self._step


def leaving(frame: FrameType | None) -> bool:
    """Whether this line, or what called it, gives back what was current before."""
    while frame is not None and frame.f_code.co_filename.startswith(HOME):
        if frame.f_code.co_name in ("_leave", "__exit__", "restore"):
            return True
        frame = frame.f_back
    return False


def moved(step: int) -> list[Camera]:
    turn = look_at((0.15 * step, 0.05, 1), (0, 0, 0))
    return [replace(view, viewmat=view.viewmat @ turn) for view in VIEWS]


BACK = [VIEWS[0], replace(VIEWS[1], viewmat=VIEWS[1].viewmat @ np.diag([-1.0, 1, -1, 1]))]
LOW = [replace(view, sh_degree=0) for view in VIEWS]
COLOURS = [VIEWS[0], replace(VIEWS[1], background=(0.2, 0.4, 0.9))]


def frames(kind: Kind) -> list[tuple[list[Camera], Any]]:
    """Cameras and poses that use other variants, sizes of passes and targets."""
    poses = [bent(angle=0.1 * i) for i in range(4)] if kind.pose is not None else [None] * 4
    views = [list(VIEWS), moved(1), [VIEWS[1]], moved(2)]
    if kind.name != "mesh":
        views += [BACK, LOW, COLOURS]
    return [(v, poses[i % 4]) for i, v in enumerate(views)] + [(list(VIEWS), poses[1]), (list(VIEWS), poses[2])]


INTERRUPTED = [
    kind for kind in KINDS if kind.name in ("plain", "gpu", "geometry", "hidden", "limb", "limb8", "mesh")
] + [splats("limb float", limb(degree=2), pose=bent(), output="float32")]


@pytest.fixture(autouse=True)
def _nothing_before() -> Iterator[None]:
    nothing_current()
    yield
    nothing_current()


@pytest.fixture
def pictures() -> Callable[[Kind], list[NDArray[Any]]]:
    def of(kind: Kind) -> list[NDArray[Any]]:
        with kind.make() as renderer:
            return [renderer.render(views, pose) for views, pose in frames(kind)]

    return of


@pytest.mark.parametrize("given", [False, True], ids=["own context", "given context"])
def test_broken_off_at_any_line(pictures: Callable[[Kind], list[NDArray[Any]]], given: bool) -> None:
    rng = np.random.default_rng(41)
    breaker, share = Breaker(), max(1, TIMES // (2 * len(INTERRUPTED)))
    places: set[str] = set()
    for kind in INTERRUPTED:
        expected, plan = pictures(kind), frames(kind)
        users = create_context() if given else None
        context = create_context(given=users.ctx) if users else None
        nothing_current()
        renderer = kind.make(context)
        before = asked()
        for _ in range(share):
            index, following = rng.integers(len(plan)), rng.integers(len(plan))
            if rng.random() < 0.3:
                following = index  # the same call again must not take up what the first left
            fresh = rng.random() < 0.3
            if fresh:  # the first frame makes pipelines, programs and targets: it is broken off as well
                renderer.release()
                renderer = kind.make(context)
            views, pose = plan[index]
            total = 700 if fresh else 250
            try:
                breaker.run(lambda v=views, p=pose, r=renderer: r.render(v, p), int(rng.integers(1, total)))
            except Broken:
                places.add(breaker.where)
            assert asked() == before, breaker.where
            views, pose = plan[following]
            picture = renderer.render(views, pose)
            assert np.array_equal(picture, expected[following]), (kind.name, breaker.where, index, following)
            if type(renderer) is Renderer:
                assert renderer.stats.drawn > 0 and renderer.stats.splats > 0
        renderer.release()
        if users is not None and context is not None:
            with users:
                assert users.ctx.error == "GL_NO_ERROR"
            context.release()
            users.release()
    assert len(places) > min(60, TIMES // 8)


def test_a_load_that_is_broken_off_leaves_the_old_scene(monkeypatch: pytest.MonkeyPatch) -> None:
    from glsplat.errors import GlsplatError

    kind = KINDS[0]
    with kind.make() as renderer:
        picture = kind.draw(renderer)
        with pytest.raises(GlsplatError, match="an item shows Splats, an Avatar or a RiggedMesh, not int"):
            renderer.load(7)  # type: ignore[union-attr]
        assert np.array_equal(kind.draw(renderer), picture)
        with monkeypatch.context() as patch:
            patch.setattr("glsplat.renderer.gpu_scene.ItemBuffers", broken)
            with pytest.raises(Broken):
                renderer.load(limb())  # type: ignore[union-attr]
        assert np.array_equal(kind.draw(renderer), picture)
        renderer.load(limb())  # type: ignore[union-attr]
        assert renderer.render(VIEWS, bent()).any()


def broken(*_: object) -> None:
    raise Broken


def test_posed_after_a_frame_that_failed() -> None:
    """The bones of one pose with the skin pass of another would be a body that never was."""
    avatar, far = limb(), bent()
    far = replace(far, trans=np.array([4000.0, 0, 0]))
    with Probe(avatar, size=(SIZE, SIZE)) as renderer:
        renderer.render(VIEWS, bent())
        means, shapes = renderer.posed()
        write = Arena._write
        try:
            Arena._write = broken  # type: ignore[method-assign, assignment]
            with pytest.raises(Broken):
                renderer.render(VIEWS, far)
        finally:
            Arena._write = write  # type: ignore[method-assign]
        from glsplat.errors import GlsplatError

        with pytest.raises(GlsplatError, match="not rendered yet"):
            renderer.posed()
        renderer.render(VIEWS, bent())
        again = renderer.posed()
        assert np.array_equal(again[0], means) and np.array_equal(again[1], shapes)
