"""The folder that ``glsplat page`` writes: on a plain file server, in a browser, in VR, through a lost context."""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from apps import cli
from glsplat import Camera, Item, Pose, Scene, similarity
from glsplat.extras.browser.web_format.read import decode_avatar
from glsplat.renderer.levels import Proxy, chosen
from tests.browser.draw.conftest import shot
from tests.browser.draw.test_parity import psnr, truth
from tests.browser.opened import Opened
from tests.browser.served import Quiet, hosted
from tests.browser.vr import pose, see, steer

STATS = "window.glsplat?.stats()"


def _answer(route: Any, answer: dict[str, Any]) -> None:
    route.fulfill(**answer)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("page")
    assert cli.main(["page", "-o", str(out), "--name", "Robin <b>"]) == 0
    return out


@pytest.fixture(scope="module")
def host(folder: Path) -> Iterator[str]:
    """Any file host: here Python's."""
    with hosted(folder) as address:
        yield address


def started(page: Opened) -> Opened:
    page.until(f"{STATS}?.shown > 1 && {STATS}.drawn >= 4500")
    return page


def test_it_shows_the_avatar_and_asks_nobody_else(visit: Callable[..., Opened], host: str) -> None:
    page = started(visit(f"{host}?place=plain"))
    assert page.page.title() == "Robin <b>" and page.page.inner_text("#name") == "Robin <b>"
    assert page.page.inner_text("#status") == ""
    chips = page.page.locator("#motions button")
    assert chips.all_inner_texts() == ["Stand", "Idle", "Walk", "Wave and turn"]
    chips.nth(2).click()
    assert chips.nth(2).get_attribute("aria-pressed") == "true"
    before = page.stats()["shown"]
    page.until(f"{STATS}.shown > {before + 2}")
    assert all(request.startswith((host, "data:")) for request in page.requests)
    chips.nth(0).click()
    page.wait(1.0)
    canvas = shot(page).astype(int)
    assert (canvas.max(axis=2) > 90).mean() > 0.02  # somebody is there
    page.page.locator("#canvas").focus()
    for _ in range(6):
        page.page.keyboard.press("ArrowLeft")
    page.wait(1.0)
    assert np.abs(shot(page).astype(int) - canvas).mean() > 0.5  # seen from another side


def test_layers_are_chosen_for_what_is_drawn(visit: Callable[..., Opened], folder: Path) -> None:
    """Not for the coarsest level alone, which comes first, and again for a headset's display."""
    rest = threading.Event()

    class Slow(Quiet):
        def copyfile(self, source: Any, outputfile: Any) -> None:
            if self.path.endswith("avatar.splats"):
                outputfile.write(source.read(90_000))
                rest.wait(30)
            super().copyfile(source, outputfile)

    with hosted(folder, Slow) as address:
        watch = f"""window.measured = [];
          import('{address}draw/own.js').then(({{ Own }}) => {{
            const measure = Own.prototype.measure;
            Own.prototype.measure = function (...what) {{
              window.measured.push(this.people[0].avatar.levels.size);
              return measure.apply(this, what);
            }};
          }});"""
        page = visit(address, init=f"if (location.origin !== 'null') {{ {watch} }}")
        page.until(f"window.measured?.length === 1 && {STATS}.drawn === 4500")
        page.wait(0.5)
        assert page.js("window.measured") == [1]
        rest.set()
        page.until("window.measured.length === 2")
        assert page.js("window.measured") == [1, 4]
        page.until("!document.querySelector('#enter-vr').disabled")
        page.page.click("#enter-vr")
        page.until(f"{STATS}.session === 'vr'")
        steer(page, head=pose([0, 1.5, 0]))
        see(page)
        see(page)
        assert page.js("window.measured") == [1, 4, 4]


def shift(picture: NDArray[Any], expected: NDArray[Any]) -> NDArray[np.float64]:
    """[2] pixels by which a picture is off where somebody opaque is seen: least squares over the picture's slopes."""
    inside = cv2.erode((expected[..., 3] > 0.99).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    assert inside.sum() > 3000
    smooth = [cv2.GaussianBlur(image[..., :3].astype(np.float64), (0, 0), 1.0) for image in (picture, expected)]
    dy, dx = np.gradient(smooth[1], axis=(0, 1))
    slopes = np.stack([dx[inside].ravel(), dy[inside].ravel()], 1)
    found: NDArray[np.float64] = np.linalg.lstsq(slopes, (smooth[1] - smooth[0])[inside].ravel(), rcond=None)[0]
    return found


def test_the_picture_is_of_the_pose_of_its_frame_while_the_head_turns(
    visit: Callable[..., Opened], host: str, folder: Path
) -> None:
    """90 degrees a second at 72 Hz: 1.25 degrees a frame; a picture that is a frame old would be off by that."""
    page = started(visit(f"{host}?place=plain"))
    page.page.locator("#motions button").nth(0).click()
    page.until("!document.querySelector('#enter-vr').disabled")
    page.page.click("#enter-vr")
    page.until(f"{STATS}.session === 'vr'")
    avatar = decode_avatar((folder / "avatar.splats").read_bytes())
    # one placed frame: 1.6 m ahead of where the head looks at first, turned to it
    steer(page, head=pose([0, 1.5, 0]))
    see(page)
    stands, densities = similarity((0, 0, -1.6), (0, 0, 0, 1)), [level.density for level in avatar.levels]
    for frame in range(3):
        steer(page, head=pose([0.02 * frame, 1.5, 0], yaw=1.25 * (frame - 1), pitch=-8))
        seen = see(page)
        side = seen["left"].shape[0]
        cameras = []
        for matrix, projection in (seen["eyes"]["left"], seen["eyes"]["right"]):
            fx, fy = projection[0, 0] * side / 2, projection[1, 1] * side / 2
            K = np.array(
                [[fx, 0, (1 - projection[0, 2]) * side / 2], [0, fy, (1 + projection[1, 2]) * side / 2], [0, 0, 1]]
            )
            cameras.append(Camera(np.diag([1.0, -1, -1, 1]) @ np.linalg.inv(matrix), K, side, side))
        if frame < 2:
            continue  # every frame is drawn; the last is held against the truth
        density = max(Proxy.of(avatar).density(camera, stands) for camera in cameras)
        level = chosen(densities, density)
        content = avatar if level == 0 else avatar.levels[level - 1].content
        expected = truth(Scene([Item(replace(content, levels=()), pose=Pose.zero(), transform=stands)]), cameras)
        for eye, name in enumerate(("left", "right")):
            picture = seen[name].astype(np.float32) / 255
            off = shift(picture, expected[eye]) / (cameras[eye].K[0, 0], cameras[eye].K[1, 1])
            assert np.degrees(np.hypot(*off)) <= 0.02
            inside = expected[eye][..., 3] > 0.99
            assert psnr(picture[inside][:, :3], expected[eye][inside][:, :3]) > 45


DAMAGE = [
    ("HTMLCanvasElement.prototype.getContext = () => null;", "This browser has no WebGL 2"),
    ("window.DecompressionStream = undefined;", "This browser cannot unpack avatars"),
]


def test_what_is_missing_or_damaged_is_a_sentence(visit: Callable[..., Opened], host: str) -> None:
    for damage, words in DAMAGE:
        page = visit(host, init=damage)
        page.until("document.querySelector('#status').dataset.level === 'error'")
        assert words in page.page.inner_text("#status")
    page = visit("about:blank")
    page.allowed.append("404")
    broken, missing = {"body": b"GSAV\1\0\0\0" + bytes(100)}, {"status": 404}
    for answer, words in ((broken, "avatar"), (missing, "Cannot load avatar.splats (404)")):
        page.page.unroute("**/avatar.splats")
        page.page.route("**/avatar.splats", functools.partial(_answer, answer=answer))
        page.page.goto(host)
        page.until("document.querySelector('#status').dataset.level === 'error'")
        assert words in page.page.inner_text("#status")
