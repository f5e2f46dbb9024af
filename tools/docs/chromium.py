"""Chromium for scripts, as the tests have it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from playwright.sync_api import sync_playwright

from tests import needs
from tests.browser.conftest import _FLAGS
from tests.browser.opened import FAKE_XR, WATCH, Opened


def launched(play: Any) -> Any:
    """A Browser of Playwright's, which its caller closes."""
    path = needs.program("chromium")
    assert path, "no Chromium found"
    return play.chromium.launch(executable_path=path, headless=True, args=_FLAGS)


@contextmanager
def chromium() -> Iterator[Any]:
    """Playwright's Browser."""
    with sync_playwright() as play:
        browser = launched(play)
        yield browser
        browser.close()


@contextmanager
def page_of(
    browser: Any, address: str, init: str, size: tuple[int, int] = (1100, 640), xr: bool = True
) -> Iterator[Opened]:
    """A page with storage of its own, with the fake headset unless ``xr`` is False."""
    context = browser.new_context(viewport={"width": size[0], "height": size[1]}, ignore_https_errors=True)
    context.add_init_script((FAKE_XR if xr else "") + WATCH)
    context.add_init_script(init)
    opened = Opened(context.new_page())
    opened.page.goto(address)
    opened.js("watch.reading = false")  # reading the stamps back takes the page's time
    yield opened
    context.close()
