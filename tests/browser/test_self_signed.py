"""With a certificate and a token that the server made: the page under TLS, its token, the QR code that leads to it."""

from __future__ import annotations

from urllib.parse import urlsplit

import cv2
import numpy as np
import pytest

from glsplat.net.guard.access import Access, is_loopback
from glsplat.net.guard.certificate import kept_certificate
from glsplat.net.guard.kept import kept_token, state_folder
from glsplat.net.server import ServerConfig
from tests.browser.stored import StoredPairs

UNASKED = [r"401 \(Unauthorized\)"]  # Chromium reports the answer to a question without a token


@pytest.fixture
def secured(state, serve):
    """(server, token); the server is reached from other devices, too."""
    folder = state_folder()
    kept, token = kept_certificate(folder, ()), kept_token(folder)
    config = ServerConfig(port=0, tls=(kept.path, kept.path), access=Access(host="0.0.0.0", tls=True, token=token))
    return serve(StoredPairs(), config), token


def test_the_printed_address_is_enough(secured, open_page):
    served, token = secured
    opened = open_page(f"{served.page}#token={token}")
    opened.until("window.glsplat?.stats().shown > 2", timeout=60)
    assert opened.js("isSecureContext") and token not in opened.page.url
    assert any(url.startswith(f"wss://localhost:{served.port}/ws") for url in opened.requests)
    assert not any(token in url for url in opened.requests)


def test_the_status_pages_code_is_read_from_the_screen(secured, open_page):
    served, token = secured
    who = {"username": "me", "password": token}
    opened = open_page(f"{served.origin}/", http_credentials=who, allow=UNASKED, device_scale_factor=3)
    code = opened.page.locator("svg:not(.curve)")
    code.wait_for()
    picture = cv2.imdecode(np.frombuffer(code.screenshot(), np.uint8), cv2.IMREAD_COLOR)
    told = cv2.QRCodeDetector().detectAndDecode(picture)[0]
    assert opened.page.locator("code", has_text=told).first.is_visible()
    address = urlsplit(told)
    assert (address.scheme, address.port, address.path) == ("https", served.port, "/vr")
    assert address.hostname and not is_loopback(address.hostname)  # which is another machine to a phone
