"""QR codes are read back by OpenCV from a picture of what is shown."""

from __future__ import annotations

import asyncio
import re
from xml.etree import ElementTree

import aiohttp
import cv2
import numpy as np
import pytest

from glsplat.extras.operations import qr
from glsplat.net.guard.access import Access
from glsplat.net.server import ServerConfig
from tests.net.conftest import serving

TEXTS = (
    "http://localhost:8000/vr",
    "https://192.168.178.123:8000/vr#token=abcDEF_-9hijklmnopqrstuv",
    "https://[2001:db8:1234:5678:9abc:def0:1234:5678]:8000/vr#token=abcDEF_-9hijklmnopqrstuv",
)
HALVES = {" ": (0, 0), "▀": (1, 0), "▄": (0, 1), "█": (1, 1)}


def read(picture):
    return cv2.QRCodeDetector().detectAndDecode(picture)[0]


def screen(lines, ground):
    """Render a terminal's lines with their colour codes, 6x12 pixels a character, on a grey ground."""
    colours = re.compile(r"\x1b\[38;5;(\d+);48;5;(\d+)m(.*)\x1b\[0m")
    grey = {"231": 255, "16": 0}
    rows = []
    for line in lines:
        fore, back, text = colours.fullmatch(line).groups()
        for half in (0, 1):
            rows.append([grey[fore] if HALVES[character][half] else grey[back] for character in text])
    picture = np.kron(np.array(rows, np.uint8), np.ones((6, 6), np.uint8))
    return np.pad(picture, 40, constant_values=ground)


@pytest.mark.parametrize("text", TEXTS)
@pytest.mark.parametrize("ground", [0, 255])
def test_a_terminals_code_is_read_on_any_ground(text, ground):
    lines, columns = qr.terminal(text)
    picture = screen(lines, ground)
    assert {len(re.sub(r"\x1b\[[0-9;]*m", "", line)) for line in lines} == {columns}
    assert read(picture) == text and picture[41, 41] == 255  # dark on light: not every reader takes the inverse


@pytest.mark.parametrize("text", TEXTS)
def test_the_pages_code_is_read(text):
    drawn = qr.svg(text)
    assert drawn.startswith("<svg ") and f"<title>{text}</title>" in drawn and "style" not in drawn
    root = ElementTree.fromstring(drawn)
    assert root.get("viewBox") == f"0 0 {root.get('width')} {root.get('height')}"
    size = int(re.search(r'width="(\d+)" height="\1"', drawn)[1]) // 4
    picture, x, y = np.full((size, size), 255, np.uint8), 0, 0.0
    path = re.search(r'stroke="#000" d="([^"]+)"', drawn)[1]
    for command, numbers in re.findall(r"([Mmh])([-\d. ]+)", path):
        values = [float(number) for number in re.findall(r"-?[\d.]+", numbers)]
        if command == "h":
            picture[int(y), int(x) : int(x + values[0])] = 0
            x += values[0]
        else:
            x, y = (values[0], values[1]) if command == "M" else (x + values[0], y + values[1])
    assert read(np.kron(picture, np.ones((4, 4), np.uint8))) == text


def test_what_a_host_may_be_called_is_escaped():
    assert "<title>&lt;b&gt;&amp;</title>" in qr.svg("<b>&")


async def test_a_page_draws_few_codes_and_each_once(monkeypatch):
    drawn, codes = [], qr.QrCodes(most=2)
    monkeypatch.setattr(qr, "svg", lambda text: drawn.append(text) or f"<svg>{text}</svg>")
    first = await asyncio.gather(*(codes.svg("a") for _ in range(3)))
    later = [await codes.svg(text) for text in "abcab"]
    assert first == ["<svg>a</svg>", "", ""] and drawn == ["a", "b"]
    assert later == ["<svg>a</svg>", "<svg>b</svg>", "", "<svg>a</svg>", "<svg>b</svg>"]


async def test_the_status_page_shows_the_address_it_was_asked_by():
    token = "correct-horse-battery"
    config = ServerConfig(port=0, access=Access(token=token, hosts=("lab.example",)))
    pages = {}
    async with serving(config=config) as server, aiohttp.ClientSession() as http:
        for host in ("lab.example:81", "lab.example"):
            headers = {"Host": host, "Authorization": f"Bearer {token}"}
            async with http.get(f"http://127.0.0.1:{server.port}/", headers=headers) as response:
                pages[host] = await response.text()
                policy = response.headers["Content-Security-Policy"]
                assert "script-src 'self';" in policy and "unsafe" not in policy and "<script>" not in pages[host]
    found = pages
    for host, page in found.items():
        assert qr.svg(f"http://{host}/vr") in page and f"<code>http://{host}/vr</code>. It asks for the token." in page
        assert token not in page


@pytest.mark.parametrize(("listens", "name"), [("0.0.0.0", "192.168.7.9"), ("127.0.0.1", "")])
async def test_a_code_never_leads_a_phone_to_itself(monkeypatch, listens, name):
    monkeypatch.setattr("glsplat.net.guard.host_info.machine_addresses", lambda: ("192.168.7.9", "2001:db8::7"))
    config = ServerConfig(port=0, access=Access(host=listens, insecure=True))
    async with serving(config=config) as server, aiohttp.ClientSession() as http:
        async with http.get(f"http://localhost:{server.port}/") as response:
            port, page = server.port, await response.text()
    assert "http://localhost" not in page
    if name:
        assert qr.svg(f"http://{name}:{port}/vr") in page and f"<code>http://{name}:{port}/vr</code>" in page
    else:
        assert "<svg" not in page and "glsplat serve --host 0.0.0.0 --self-signed" in page
