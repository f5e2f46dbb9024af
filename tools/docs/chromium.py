"""Chromium as in the tests, and a server to open in it, for scripts."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from playwright.sync_api import sync_playwright

from tests import needs
from tests.browser.conftest import _FLAGS
from tests.browser.opened import FAKE_XR, WATCH, Opened


def launched(play: Any, *flags: str) -> Any:
    """Return a Browser of Playwright's with more flags, which its caller closes."""
    path = needs.program("chromium")
    assert path, "no Chromium found"
    return play.chromium.launch(executable_path=path, headless=True, args=[*_FLAGS, *flags])


@contextmanager
def serving(options: Sequence[str]) -> Iterator[str]:
    """Yield the address of the page of `glsplat serve` in a process of its own."""
    words = [sys.executable, "-m", "apps.cli", "serve", "--port", "0", "--json", *options]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as server:
        try:
            assert server.stdout is not None
            yield json.loads(server.stdout.readline())["page"]
        finally:
            server.terminate()


@contextmanager
def chromium() -> Iterator[Any]:
    """Yield Playwright's Browser."""
    with sync_playwright() as play:
        browser = launched(play)
        yield browser
        browser.close()


@contextmanager
def page_of(
    browser: Any, address: str, init: str, size: tuple[int, int] = (1100, 640), xr: bool = True
) -> Iterator[Opened]:
    """Yield a page with its own storage, and with the fake headset unless ``xr`` is False."""
    context = browser.new_context(viewport={"width": size[0], "height": size[1]}, ignore_https_errors=True)
    context.add_init_script((FAKE_XR if xr else "") + WATCH)
    context.add_init_script(init)
    opened = Opened(context.new_page())
    opened.page.goto(address)
    opened.js("watch.reading = false")  # reading the stamps back takes the page's time
    yield opened
    context.close()
