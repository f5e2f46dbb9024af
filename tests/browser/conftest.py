"""Chromium for a whole run, pages that fail their test when they complain, and servers in threads."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests import needs
from tests.browser.markers import samples
from tests.browser.opened import FAKE_XR, WATCH, Opened
from tests.browser.served import Served

_FLAGS = [
    "--no-sandbox",  # needs rights that containers do not give, and opens pages of this checkout only
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--ignore-certificate-errors",
    "--enable-unsafe-swiftshader",  # WebGL without a GPU
    "--enable-precise-memory-info",
    "--js-flags=--expose-gc",
]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.browser)
            item.add_marker(pytest.mark.check)  # tests/conftest.py leaves the folder out where these are not asked for


@pytest.fixture(autouse=True)
def nothing_sent() -> None:
    """Requests of other tests' pages have the same numbers."""
    samples.clear()


# of this package, not of the session: playwright's loop occupies the main thread for as long as it lives
@pytest.fixture(scope="package")
def play() -> Iterator[Any]:
    """Playwright; a process has one at a time."""
    playwright = pytest.importorskip("playwright.sync_api", reason="needs the Python package playwright")
    needs.require("chromium", "atomic")
    with playwright.sync_playwright() as play:
        yield play


@pytest.fixture(scope="package")
def chromium(play: Any) -> Iterator[Any]:
    """Playwright's Browser, headless, software WebGL."""
    browser = play.chromium.launch(executable_path=needs.program("chromium"), headless=True, args=_FLAGS)
    yield browser
    browser.close()


OpenPage = Callable[..., Opened]


@pytest.fixture
def open_page(chromium: Any, serve: Any) -> Iterator[OpenPage]:
    """``open_page(address, xr=False, allow=[patterns], size=(width, height), **context options)``.

    Each page has cookies and storage of its own, and is closed before the servers of ``serve`` stop. A fault that no
    pattern of ``allow`` fits fails the test.
    """
    pages: list[Opened] = []
    contexts: list[Any] = []

    def open_(
        address: str | None = None,
        xr: bool = True,
        allow: list[str] | None = None,
        size: tuple[int, int] = (1100, 640),
        init: str = "",
        browser: Any = chromium,
        **options: Any,
    ) -> Opened:
        options.setdefault("ignore_https_errors", True)
        context = browser.new_context(viewport={"width": size[0], "height": size[1]}, **options)
        contexts.append(context)
        for script in (FAKE_XR if xr else "", WATCH, init):
            context.add_init_script(script)
        opened = Opened(context.new_page(), list(allow or []))
        pages.append(opened)
        if address is not None:
            opened.page.goto(address)
        return opened

    yield open_
    for context in contexts:
        context.close()
    unexpected = [fault for opened in pages for fault in opened.unexpected()]
    assert not unexpected, "the page complained:\n" + "\n".join(unexpected[:20])


@pytest.fixture
def serve() -> Iterator[Callable[..., Served]]:
    """``serve(backend, config)``: a started server, stopped after the test."""
    servers: list[Served] = []

    def start(*args: Any, **options: Any) -> Served:
        served = Served(*args, **options)
        served.start()
        servers.append(served)
        return served

    yield start
    for served in servers:
        served.stop()
