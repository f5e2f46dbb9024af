"""Pages that draw by themselves: Chromium on Mesa's llvmpipe through ANGLE, or on SwiftShader, without a server."""

from __future__ import annotations

import base64
import json
import mimetypes
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.camera import Camera
from glsplat.shaders.web import page_programs
from glsplat.splats import Splats
from tests import needs
from tests.browser.conftest import _FLAGS
from tests.browser.draw.exported import camera_file, exported
from tests.browser.opened import FAKE_XR, WATCH, Opened

_WEB = Path(__file__).resolve().parents[3] / "glsplat" / "net" / "web"
_HERE = Path(__file__).parent
_ROOT = "http://localhost:1/vr/"
_MESA = ["--use-gl=angle", "--use-angle=gl-egl", "--ignore-gpu-blocklist"]


@pytest.fixture(scope="package")
def mesa(play: Any) -> Iterator[Any]:
    """Chromium whose WebGL is Mesa's own driver, as a desktop's is a GPU's."""
    browser = play.chromium.launch(executable_path=needs.program("chromium"), headless=True, args=[*_FLAGS, *_MESA])
    yield browser
    browser.close()


class Bench(Opened):
    """A page with the modules of the site and of this folder, and data by name."""

    data: dict[str, bytes]

    def offer(self, name: str, content: Splats | Avatar) -> str:
        """Put splats or an avatar where the page's load(name) finds it, exactly."""
        header, body = exported(content)
        self.data[f"{name}.json"], self.data[f"{name}.bin"] = json.dumps(header).encode(), body
        return name

    def pictures(self, cameras: list[Camera], **question: Any) -> dict[str, Any]:
        """What page.js draws: pictures [V, H, W, 4] by kind, rows as they lie in the texture, and `drawn`."""
        question["cameras"] = [camera_file(camera) for camera in cameras]
        found = self.js("(question) => import('/vr/test/page.js').then((m) => m.pictures(question))", question)
        assert found["error"] == 0
        shape = (len(cameras), cameras[0].height, cameras[0].width, 4)
        for kind in question["kinds"]:
            found[kind] = floats(found[kind]).reshape(shape)
        return found


def floats(text: str) -> NDArray[np.float32]:
    """Floats of page.js."""
    return np.frombuffer(base64.b64decode(text), np.float32)


def _answer(bench: Bench, route: Any) -> None:
    path = route.request.url.removeprefix(_ROOT).partition("?")[0]
    folder, _, name = path.partition("/")
    file = _HERE / name if folder == "test" else _WEB / path
    if path == "modules":
        route.fulfill(body="<!doctype html><title>modules</title>", content_type="text/html")
    elif path == "draw/programs.json":
        route.fulfill(body=json.dumps(page_programs()), content_type="application/json")
    elif folder == "data" and name in bench.data:
        route.fulfill(body=bench.data[name], content_type="application/octet-stream")
    elif file.is_file():
        kind = mimetypes.guess_type(file.name)[0] or "application/octet-stream"
        route.fulfill(body=file.read_bytes(), content_type=kind)
    else:
        route.fulfill(status=404, body="no such file")


@pytest.fixture
def bench_of() -> Iterator[Callable[[Any], Bench]]:
    """``bench_of(browser)``: a fresh page there. What it complains about fails the test."""
    opened: list[tuple[Any, Bench]] = []

    def make(browser: Any) -> Bench:
        context = browser.new_context()
        bench = Bench(context.new_page())
        bench.data = {}
        bench.page.route("**/*", lambda route: _answer(bench, route))
        bench.page.goto(f"{_ROOT}modules")
        opened.append((context, bench))
        return bench

    yield make
    for context, _ in opened:
        context.close()
    faults = [fault for _, bench in opened for fault in bench.unexpected()]
    assert not faults, "the page complained:\n" + "\n".join(faults[:20])


@pytest.fixture
def bench(mesa: Any, bench_of: Callable[[Any], Bench]) -> Bench:
    """A page on llvmpipe."""
    return bench_of(mesa)


def shot(page: Opened) -> NDArray[np.uint8]:
    """What the window shows: [H, W, 3]."""
    data = np.frombuffer(page.page.screenshot(), np.uint8)
    return cv2.imdecode(data, cv2.IMREAD_COLOR)[..., ::-1]


@pytest.fixture
def visit(mesa: Any, serve: Any) -> Iterator[Callable[..., Opened]]:
    """``visit(address, size, init, allow)``: a whole page on llvmpipe with a fake headset, closed before servers stop.

    What it complains about fails the test, unless a pattern of ``allow`` fits.
    """
    opened: list[tuple[Any, Opened]] = []

    def open_(
        address: str, size: tuple[int, int] = (480, 360), init: str = "", allow: list[str] | None = None
    ) -> Opened:
        context = mesa.new_context(viewport={"width": size[0], "height": size[1]})
        for text in (FAKE_XR, WATCH, init):
            context.add_init_script(text)
        page = Opened(context.new_page(), list(allow or []))
        opened.append((context, page))
        page.page.goto(address)
        return page

    yield open_
    for context, _ in opened:
        context.close()
    faults = [fault for _, page in opened for fault in page.unexpected()]
    assert not faults, "\n".join(faults[:20])
