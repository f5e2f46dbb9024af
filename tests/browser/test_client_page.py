"""The page of docs/protocol.md, "In a browser": a client in JavaScript, of another origin, that shows both eyes."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any

import pytest

from glsplat.net.guard.access import Access
from glsplat.net.server import ServerConfig
from tests.browser.opened import Opened
from tests.browser.stored import StoredPairs

DOC = Path(__file__).resolve().parents[2] / "docs" / "protocol.md"
PORT = "ws://localhost:8000/ws"


class Pages(BaseHTTPRequestHandler):
    """Answers everything with ``text``."""

    text = b""

    def do_GET(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.end_headers()
        self.wfile.write(self.text)

    def log_message(self, *_: Any) -> None:
        pass


@pytest.fixture
def host() -> Iterator[HTTPServer]:
    """A server of pages on a port of its own."""
    server = HTTPServer(("127.0.0.1", 0), type("Own", (Pages,), {}))
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield server
    server.shutdown()
    thread.join()
    server.server_close()


def test_the_client_in_a_page_shows_both_eyes(open_page: Callable[..., Opened], serve: Any, host: HTTPServer) -> None:
    origin = f"http://localhost:{host.server_port}"
    served = serve(StoredPairs(), ServerConfig(port=0, access=Access(origins=(origin,))))
    block = re.search(r"```html\n(.*?)```", DOC.read_text(encoding="utf-8"), re.S)
    assert block is not None and PORT in block[1]
    host.RequestHandlerClass.text = block[1].replace(PORT, f"ws://localhost:{served.port}/ws").encode()  # type: ignore[attr-defined]
    page = open_page(f"{origin}/", xr=None)
    page.until("frame > 3 && ack > 2 && left.naturalWidth === 512 && right.naturalWidth === 512")
    assert page.js("left.src !== right.src")
