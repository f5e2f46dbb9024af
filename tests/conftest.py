"""Fixtures shared by all tests."""

from __future__ import annotations

import asyncio
import inspect
import os
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:  # a folder whose tests need neither OpenGL nor NumPy starts without them
    import numpy as np

    from glsplat.avatar import Avatar
    from glsplat.gl.context import Context
    from glsplat.renderer.probe import Probe
    from glsplat.splats import Splats

SHARED_DATA = Path(__file__).resolve().parents[1].parent / "shared" / "data"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Reference scenes, people and images that lie beside the checkout and may not be copied into it."""
    if not SHARED_DATA.is_dir():
        pytest.skip(f"no reference data at {SHARED_DATA}")
    return SHARED_DATA


@pytest.fixture(scope="session", autouse=True)
def _state_of_the_tests(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Servers that tests start, in processes of their own too, keep nothing in the user's folder.

    What was asked of this pytest (PYTEST_ADDOPTS) is not asked of those that tests start.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("PYTEST_ADDOPTS", raising=False)
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        yield


@pytest.fixture(scope="session", autouse=True)
def _patient_clients() -> Iterator[None]:
    """A client that a test makes waits a minute for what would otherwise have to come within ten seconds."""
    from glsplat.net.client import Client

    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(Client.__init__.__kwdefaults__, "timeout", 60.0)
        yield


@pytest.fixture
def rng() -> np.random.Generator:
    import numpy as np

    return np.random.default_rng(20260)


@pytest.fixture
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """XDG_STATE_HOME, not there yet: what a server keeps between its starts."""
    home = tmp_path / "state"
    monkeypatch.setenv("XDG_STATE_HOME", str(home))
    return home


def pytest_configure() -> None:
    """Property tests draw few examples unless HYPOTHESIS_PROFILE=check asks for many."""
    from hypothesis import settings

    settings.register_profile("few", max_examples=20, deadline=None)
    settings.register_profile("check", max_examples=120, deadline=None)
    settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "few"))


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave the browser tests, which are all checks, unread where `make test` asks for none."""
    return True if collection_path.name == "browser" and config.option.markexpr.startswith("not check") else None


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool | None:
    """Run an ``async def`` test on an event loop of its own."""
    if not inspect.iscoroutinefunction(pyfuncitem.obj):
        return None
    names = pyfuncitem._fixtureinfo.argnames
    asyncio.run(pyfuncitem.obj(**{name: pyfuncitem.funcargs[name] for name in names}))
    return True


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """One line a reason for what was skipped, with how many tests; the reason says what to install."""
    reasons = Counter(
        report.longrepr[2].removeprefix("Skipped: ") for report in terminalreporter.stats.get("skipped", [])
    )
    if reasons:
        terminalreporter.section("skipped")
        for reason, count in reasons.most_common():
            terminalreporter.write_line(f"{count:5d} {reason}")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--update-goldens", action="store_true", help="write the golden images instead of comparing")


@pytest.fixture(scope="session")
def context() -> Iterator[Context]:
    """One context for all GL tests of the session: making one costs more than most tests."""
    from glsplat.gl.context import create_context
    from tests.compare import AS_ON_A_GPU

    context = create_context()
    yield replace(context, software=context.software and not AS_ON_A_GPU)
    context.release()


@pytest.fixture
def gl(context: Context) -> Iterator[Context]:
    """The shared context as the thread's current one: another test may have ended with none or its own."""
    with context.ctx:
        yield context


@pytest.fixture
def renderer_of(context: Context) -> Iterator[Callable[..., Probe]]:
    """Makes renderers on the shared context and releases them after the test."""
    from glsplat.config import RenderConfig, with_fields
    from glsplat.renderer.probe import Probe
    from tests.compare import AS_ON_A_GPU

    made: list[Probe] = []

    def make(scene: Splats | Avatar, size: tuple[int, int] = (64, 64), views: int = 1, **config: Any) -> Probe:
        config.setdefault("output", "float32")
        config.setdefault("target", "auto" if AS_ON_A_GPU else "32f")
        renderer = Probe(scene, size=size, views=views, config=with_fields(RenderConfig(), **config), context=context)
        made.append(renderer)
        return renderer

    with context.ctx:
        yield make
        for renderer in made:
            renderer.release()
        assert context.ctx.error == "GL_NO_ERROR"
