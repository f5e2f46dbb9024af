"""The page's own files with a main.js of the test's, without a server: requests are answered from the folder."""

from __future__ import annotations

import mimetypes
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from glsplat.net.pages import page_files

WEB = page_files()
ORIGIN = "http://localhost:8000"
CSP = (
    "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; worker-src 'self'; "
    "img-src 'self' blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)


def answer_file(route: Any, name: str, body: bytes, **headers: str) -> None:
    kind = mimetypes.guess_type(name)[0] or "application/octet-stream"
    route.fulfill(body=body, content_type=kind, headers=headers)


@contextmanager
def flat_page(chromium: Any, main: str = "", ready: str = "true", **options: Any) -> Iterator[Any]:
    """The page with ``main`` as its main.js, once ``ready`` is true. A complaint of the browser fails the test."""
    context = chromium.new_context(**options)
    complaints: list[str] = []

    def answer(route: Any) -> None:
        path = route.request.url.removeprefix(ORIGIN).split("?")[0]
        name = "index.html" if path == "/vr/" else path.removeprefix("/vr/")
        if path == "/vr/main.js":
            route.fulfill(body=main, content_type="text/javascript")
        elif path.startswith("/vr/") and name in WEB:
            answer_file(route, name, WEB[name], **{"Content-Security-Policy": CSP})
        else:
            complaints.append(f"asked for {route.request.url}")
            route.fulfill(status=404)

    try:
        context.route("**/*", answer)
        page = context.new_page()
        page.on("console", lambda message: complaints.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.goto(f"{ORIGIN}/vr/")
        page.wait_for_function(f"Boolean({ready})")
        yield page
        assert not complaints
    finally:
        context.close()
