"""Pages that draw by themselves: Chromium on Mesa's llvmpipe through ANGLE, or on SwiftShader, without a server."""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.camera import Camera
from glsplat.skinning.pose import Pose
from glsplat.splats import Splats
from tests import needs
from tests.browser.conftest import _FLAGS, OpenPage
from tests.browser.flat_page import WEB, answer_file
from tests.browser.opened import Opened

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

    def answer(self, route: Any) -> None:
        path = route.request.url.removeprefix(_ROOT).partition("?")[0]
        folder, _, name = path.partition("/")
        if path == "modules":
            route.fulfill(body="<!doctype html><title>modules</title>", content_type="text/html")
        elif folder == "data" and name in self.data:
            route.fulfill(body=self.data[name], content_type="application/octet-stream")
        elif folder == "test":
            answer_file(route, name, (Path(__file__).parent / name).read_bytes())
        elif path in WEB:
            answer_file(route, path, WEB[path])
        else:
            route.fulfill(status=404, body="no such file")


def floats(text: str) -> NDArray[np.float32]:
    """Floats of page.js."""
    return np.frombuffer(base64.b64decode(text), np.float32)


@contextmanager
def bench_on(browser: Any) -> Iterator[Bench]:
    """A page in that browser. A complaint fails the test."""
    context = browser.new_context()
    bench = Bench(context.new_page())
    bench.data = {}
    bench.page.route("**/*", bench.answer)
    bench.page.goto(f"{_ROOT}modules")
    yield bench
    context.close()
    assert not bench.faults


@pytest.fixture(scope="module")
def bench(mesa: Any) -> Iterator[Bench]:
    """A page on llvmpipe."""
    with bench_on(mesa) as bench:
        yield bench


def shot(page: Opened) -> NDArray[np.uint8]:
    """What the window shows: [H, W, 3]."""
    data = np.frombuffer(page.page.screenshot(), np.uint8)
    return cv2.imdecode(data, cv2.IMREAD_COLOR)[..., ::-1]


@pytest.fixture
def visit(mesa: Any, open_page: OpenPage) -> Callable[..., Opened]:
    """``visit(address, size, init, allow)``: a whole page on llvmpipe with a fake headset."""

    def open_(address: str, size: tuple[int, int] = (480, 360), **options: Any) -> Opened:
        return open_page(address, size=size, browser=mesa, **options)

    return open_


def exported(content: Splats | Avatar) -> tuple[dict[str, Any], bytes]:
    """(header, bytes): arrays by name with type and place in the bytes, and the skeleton."""
    splats = content.splats if isinstance(content, Avatar) else content
    arrays: dict[str, np.ndarray] = {
        "means": splats.means,
        "quats": splats.quats,
        "scales": splats.scales,
        "opacities": splats.opacities,
        "sh": splats.sh.reshape(len(splats), -1),
    }
    header: dict[str, Any] = {
        "count": len(splats),
        "degree": splats.sh_degree,
        "antialias": splats.antialias,
        "skeleton": None,
    }
    if splats.surface is not None:
        arrays["normals"], arrays["occlusion"] = splats.surface.normals, splats.surface.occlusion
        arrays["shade"] = splats.surface.shades_or_one()
    if isinstance(content, Avatar):
        arrays["joints"], arrays["weights"] = content.skin.joints.astype(np.uint16), content.skin.weights
        rig = content.skeleton
        header["influences"] = content.skin.influences
        header["skeleton"] = {
            "names": list(rig.names),
            "parents": rig.parents.tolist(),
            "rest": rig.rest[:, :3].ravel().tolist(),
            "inverseBind": rig.inverse_bind[:, :3].ravel().tolist(),
        }
        if content.shapes is not None:
            shapes = content.shapes
            arrays["starts"], arrays["texels"] = shapes.starts.astype(np.uint32), shapes.texels()
            header["shapes"] = {"sizes": shapes.sizes.tolist(), "names": list(shapes.names)}
    body, header["arrays"] = b"", {}
    for name, array in arrays.items():
        data = np.ascontiguousarray(
            array if array.dtype in (np.uint16, np.uint32, np.int8, np.uint8) else array.astype(np.float32)
        )
        header["arrays"][name] = [str(data.dtype), len(body), data.size]
        body += data.tobytes() + bytes(-data.nbytes % 4)
    return header, body


def posed(pose: Pose) -> dict[str, Any]:
    """A pose for Drawing.pose: rotation vectors, root."""
    stretched = None if pose.translations is None else pose.translations.ravel().tolist()
    return {"vectors": pose.rotations.ravel().tolist(), "root": pose.trans.tolist(), "translations": stretched}


def camera_file(camera: Camera) -> dict[str, Any]:
    """The object of a camera file."""
    return {
        "width": camera.width,
        "height": camera.height,
        "fx": camera.K[0, 0],
        "fy": camera.K[1, 1],
        "cx": camera.K[0, 2],
        "cy": camera.K[1, 2],
        "w2c": camera.viewmat.tolist(),
    }
