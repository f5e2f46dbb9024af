"""What the terminal says when the server is ready."""

from __future__ import annotations

import io
import os
import re
import shutil
import webbrowser
from pathlib import Path

import pytest

from apps.serve import ready
from apps.serve.keys import Keys
from apps.serve.ready import Endpoint, announce, open_page

TOKEN = "correct-horse-battery"
SECURE = Keys((Path("k.pem"), Path("k.pem")), TOKEN, Path("/s/token"), "AB:CD")


class Terminal(io.TextIOWrapper):
    """A file that says it is a terminal, or not."""

    def __init__(self, person=True, encoding="utf-8"):
        super().__init__(io.BytesIO(), encoding=encoding)
        self.person = person

    def isatty(self):
        return self.person

    def text(self):
        self.flush()
        return self.buffer.getvalue().decode(self.encoding)


@pytest.fixture(autouse=True)
def addresses(monkeypatch):
    found = {"0.0.0.0": ("192.0.2.7", "10.0.0.1"), "::": ("192.0.2.7", "fd00::a")}
    monkeypatch.setattr(ready, "reachable_at", lambda host: found.get(host, (host,)))
    monkeypatch.setattr(ready, "machine_names", lambda: ("box", "box.local"))
    monkeypatch.setattr(shutil, "get_terminal_size", lambda: os.terminal_size((80, 24)))


def said(place, out=None, show_qr=False):
    out = out or Terminal()
    announce(place, out, show_qr)
    return out.text()


@pytest.mark.extra(name="operations")
def test_on_this_machine():
    text = said(Endpoint("127.0.0.1", 8000))
    assert "  page        http://localhost:8000/vr\n" in text and "  WebSocket   ws://localhost:8000/ws\n" in text
    assert "adb reverse tcp:8000 tcp:8000," in text
    assert "\u2580" not in text and "\u2580" in said(Endpoint("127.0.0.1", 8000), show_qr=True)
    assert "token" not in text and "certificate" not in text and "also at" not in text


def test_beyond_it():
    text = said(Endpoint("0.0.0.0", 8443, SECURE))
    assert f"  page        https://192.0.2.7:8443/vr#token={TOKEN}\n" in text and text.count(TOKEN) == 1
    assert "  status      https://192.0.2.7:8443/\n" in text and "  also at     10.0.0.1\n" in text
    assert "  certificate SHA-256 AB:CD\n" in text and "  token       in /s/token\n" in text and "adb" not in text


def test_addresses(monkeypatch):
    assert "  no VR       browsers offer it on https" in said(Endpoint("192.0.2.7", 8000))
    for host, name in (("::", "192.0.2.7"), ("fd00::a", "[fd00::a]"), ("::1", "[::1]")):
        place = Endpoint(host, 1, SECURE)
        assert place.page(place.names[0]) == f"https://{name}:1/vr"
    monkeypatch.setattr(ready, "reachable_at", lambda host: ())  # without a network it is the machine's name
    assert Endpoint("0.0.0.0", 1, SECURE).names == ("box.local",)


@pytest.mark.extra(name="operations")
def test_a_file_gets_neither_token_nor_code():
    """Standard output may be a journal that others read."""
    text = said(Endpoint("0.0.0.0", 8000, SECURE), Terminal(person=False))
    assert TOKEN not in text and "\u2580" not in text and "\x1b" not in text and "in /s/token" in text
    text = said(Endpoint("0.0.0.0", 8000, SECURE), Terminal(person=False), show_qr=True)  # unless it is asked for
    assert TOKEN in text and "\u2580" in text


def test_without_the_extra_there_is_no_code(monkeypatch):
    monkeypatch.setattr(ready, "plugin", lambda name: None)
    text = said(Endpoint("0.0.0.0", 8000))
    assert "(a QR code needs glsplat.extras.operations, which is not installed)" in text


@pytest.mark.extra(name="operations")
def test_a_terminal_that_cannot_show_the_code(monkeypatch):
    text = said(Endpoint("0.0.0.0", 8000), Terminal(encoding="latin-1"))
    assert "(no QR code: it needs UTF-8, this terminal has latin-1)" in text
    monkeypatch.setattr(shutil, "get_terminal_size", lambda: os.terminal_size((30, 24)))
    found = re.search(r"\(no QR code: it needs a terminal of (\d+) columns\)", text := said(Endpoint("0.0.0.0", 8000)))
    assert 30 < int(found[1]) < 45 and "\u2580" not in text


@pytest.mark.parametrize("failure", [None, webbrowser.Error("none"), OSError(2, "no such file")])
def test_the_browser_here_is_opened_or_a_line_says_why(monkeypatch, caplog, failure):
    asked = []

    def open_(url):
        asked.append(url)
        if failure:
            raise failure
        return len(asked) == 1

    monkeypatch.setattr(webbrowser, "open", open_)
    open_page(Endpoint("127.0.0.1", 1)).join(60)
    open_page(Endpoint("0.0.0.0", 1, SECURE)).join(60)
    assert asked[0] == "http://localhost:1/vr" and len(caplog.messages) == (2 if failure else 1)
    assert caplog.messages[-1] == "open: no browser could be started; open https://localhost:1/vr"
