"""Threads, forks, and renderers that nobody released."""

from __future__ import annotations

import asyncio
import gc
import os
import subprocess
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from glsplat.errors import ContextError, GlsplatError, PoseError
from glsplat.extras.authoring.mesh_truth import MeshTruth
from glsplat.gl.context import create_context
from glsplat.renderer import Renderer
from tests.api.current_context import GL, asked, nothing_current
from tests.api.variants import KINDS, SIZE, VIEWS, bent
from tests.scenes import cloud, limb

pytestmark = pytest.mark.gl
ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(autouse=True)
def _nothing_before() -> Iterator[None]:
    nothing_current()
    yield
    nothing_current()


def on_thread(call: Callable[[], object], name: str = "another") -> BaseException | None:
    """What ``call`` raises there."""
    caught: list[BaseException | None] = [None]

    def run() -> None:
        try:
            call()
        except BaseException as error:
            caught[0] = error

    thread = threading.Thread(target=run, name=name)
    thread.start()
    thread.join(60)
    return caught[0]


@pytest.mark.parametrize("kind", [KINDS[0], KINDS[-1]], ids=lambda kind: kind.name)
def test_another_thread_is_told_so(kind: object) -> None:
    renderer = kind.make()  # type: ignore[attr-defined]
    picture = kind.draw(renderer)  # type: ignore[attr-defined]
    calls = [lambda: renderer.render(VIEWS), renderer.release, renderer.context.release]
    if type(renderer) is Renderer:
        calls += [
            lambda: renderer.draw(VIEWS),
            lambda: renderer.load(cloud()),
            renderer.drop_targets,
            lambda: renderer.prepare(VIEWS),
            lambda: Renderer(cloud(), context=renderer.context),
        ]
    for call in calls:
        error = on_thread(call)
        assert isinstance(error, ContextError)
        assert "'another'" in str(error) and "'MainThread'" in str(error) and "ThreadPoolExecutor(1)" in str(error)
        assert "\n" not in str(error)
        assert np.array_equal(kind.draw(renderer), picture)  # type: ignore[attr-defined]
    renderer.release()
    assert on_thread(renderer.release) is None  # there is nothing left to do


def test_a_renderer_a_thread() -> None:
    """Each thread its own renderer, at the same time."""
    kinds = [KINDS[0], KINDS[4], KINDS[-1]] * 2
    expected = {}
    for kind in kinds:
        with kind.make() as renderer:
            expected[kind.name] = kind.draw(renderer)

    def work(index: int) -> bool:
        kind = kinds[index]
        with kind.make() as renderer:
            return all(np.array_equal(kind.draw(renderer), expected[kind.name]) for _ in range(5))

    with ThreadPoolExecutor(len(kinds)) as pool:
        assert all(pool.map(work, range(len(kinds))))


def test_one_worker_thread_draws_for_many_threads_and_asyncio() -> None:
    """The recipe of docs/python.md: a renderer is made, used and released on the one thread of a pool."""
    poses = [bent(angle=0.1 * i) for i in range(6)]
    with Renderer(limb(), size=(SIZE, SIZE)) as renderer:
        expected = [renderer.render(VIEWS, pose) for pose in poses]
    with ThreadPoolExecutor(1) as worker:
        shared = worker.submit(lambda: Renderer(limb(), size=(SIZE, SIZE))).result()
        with ThreadPoolExecutor(6) as pool:
            pictures = list(pool.map(lambda pose: worker.submit(shared.render, VIEWS, pose).result(), poses * 3))
        assert all(np.array_equal(p, e) for p, e in zip(pictures, expected * 3, strict=True))

        async def main() -> list[object]:
            loop = asyncio.get_running_loop()
            return await asyncio.gather(*(loop.run_in_executor(worker, shared.render, VIEWS, pose) for pose in poses))

        results = asyncio.run(main())
        assert all(np.array_equal(r, e) for r, e in zip(results, expected, strict=True))  # type: ignore[arg-type]
        with pytest.raises(PoseError):
            worker.submit(shared.render, VIEWS, bent(9)).result()
        assert not asked()[0]  # no context is current on this thread
        worker.submit(shared.release).result()


@pytest.mark.check
def test_what_was_dropped_is_freed_and_named() -> None:
    kind = KINDS[0]
    for make, name in (
        (kind.make, "a Renderer .500 splats, 64x64."),
        (KINDS[-1].make, "a _MeshTruthRenderer .0 splats, 128x128."),
    ):
        with pytest.warns(ResourceWarning, match=name + " was never released"):
            make()
        gc.collect()
    with pytest.warns(ResourceWarning, match="a context of glsplat .egl. was never released"):
        create_context()
        gc.collect()


@pytest.mark.check
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_dropped_renderers_do_not_add_up() -> None:
    kind, context = KINDS[0], create_context()
    gl = GL(context.ctx)

    def buffers() -> int:
        with context:
            return sum(gl.IsBuffer(name) & 255 for name in range(1, 500))

    stays = kind.make(context)
    kind.draw(stays)
    live = buffers()
    for _ in range(20):
        kind.draw(kind.make(context))
    assert 0 < buffers() == live
    stays.release()
    context.release()


@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_dropped_on_another_thread_is_freed_on_its_own() -> None:
    kind = KINDS[0]
    stays = kind.make()
    picture = kind.draw(stays)
    holder = [kind.make()]
    context = holder[0].context
    kind.draw(holder[0])

    def drop() -> None:
        holder.clear()
        gc.collect()
        assert not asked()[0]  # nothing was made current there

    assert on_thread(drop) is None
    assert not context.released
    assert np.array_equal(kind.draw(stays), picture)  # between frames, here, it goes
    del context
    gc.collect()
    stays.release()


@pytest.mark.check
@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_dropped_in_the_middle_of_a_frame() -> None:
    """The collector runs whenever it likes: what shares the context waits until the frame is over."""
    kind, context = KINDS[0], create_context()
    with kind.make(context) as renderer:
        picture = kind.draw(renderer)
        for _ in range(3):
            other = [kind.make(context)]
            kind.draw(other[0])
            timer = renderer.timer  # type: ignore[union-attr]
            mark = type(timer).mark

            def drop(stage: str, mark: object = mark, other: list[object] = other, timer: object = timer) -> None:
                other.clear()
                gc.collect()
                mark(timer, stage)  # type: ignore[operator]

            timer.mark = drop  # type: ignore[method-assign]
            assert np.array_equal(kind.draw(renderer), picture)
            del timer.mark  # type: ignore[method-assign]
            assert np.array_equal(kind.draw(renderer), picture)
    context.release()


FORK = """
import os, sys, signal
import numpy as np
from glsplat import create_context
from glsplat.renderer import Renderer
from glsplat.scene import Item
from tests.scenes import cloud, eyes
renderer = Renderer(cloud(), size=(64, 64))
picture = renderer.render(eyes())
child = os.fork()
if child == 0:
    signal.alarm(20)  # it used to hang
    said = []
    for call in (lambda: renderer.render(eyes()), lambda: Renderer(cloud()), create_context, renderer.drop_targets):
        try:
            call()
        except Exception as error:
            said.append(type(error).__name__ == "ContextError" and "forked" in str(error) and "spawn" in str(error))
    renderer.release()  # harmless: a with block ends in the child too
    os._exit(0 if said == [True] * 4 else 3)
status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
assert status == 0, status
assert np.array_equal(renderer.render(eyes()), picture)
renderer.release()
child = os.fork()  # nothing in the parent needs OpenGL any more, but its driver was started
os._exit(0) if child == 0 else os.waitpid(child, 0)
print("right")
"""


@pytest.mark.check
@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_a_forked_child_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "program.py"
    file.write_text(FORK)
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, file], capture_output=True, text=True, timeout=120, env=environment)
    assert done.stdout.strip() == "right", done.stdout + done.stderr


def test_nothing_is_said_at_exit() -> None:
    """A program that ends without release() is no leak."""
    script = (
        "from glsplat.renderer import Renderer\nfrom tests.scenes import cloud, eyes\n"
        "renderer = Renderer(cloud(), size=(64, 64))\nassert renderer.render(eyes()).any()\n"
    )
    done = subprocess.run(
        [sys.executable, "-X", "dev", "-W", "error::ResourceWarning:glsplat", "-c", script],
        capture_output=True, text=True, timeout=120, cwd=ROOT,
    )  # fmt: skip
    assert done.returncode == 0 and "never released" not in done.stderr, done.stderr


def test_mesh_and_splats_release_twice() -> None:
    for kind in (KINDS[0], KINDS[-1]):
        renderer = kind.make()
        renderer.release()
        renderer.release()
        assert isinstance(renderer, Renderer | MeshTruth)
        with pytest.raises(GlsplatError, match="this renderer was released"):
            renderer.render(VIEWS)
    context = create_context()
    late = KINDS[0].make(context)
    context.release()
    context.release()
    late.release()  # its context is gone, and all of it with it
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        del late
