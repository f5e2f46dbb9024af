"""What people see: the page at three sizes in both colour schemes, VR in each place, and nothing axe finds fault with.

Pictures are held against what they have to contain, measured by area and colour, not against stored pixels: fonts and
rasterizers differ from machine to machine.
"""

from __future__ import annotations

import subprocess
import tarfile
import tempfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

import glsplat
from glsplat.net.served_scene import gl_server
from tests import needs
from tests.browser.conftest import OpenPage
from tests.browser.served import Served
from tests.browser.vr import enter, fresh, pose, see, settings, steer

COVERED = 0.62  # of the window's height that the avatar's free part has at least


@pytest.fixture(scope="module")
def demo() -> Any:
    """The server as a new user starts it, with one avatar more."""
    avatars = {"another": glsplat.default_avatar()}
    with Served(make=lambda config: gl_server(glsplat.default_avatar(), config, avatars=avatars)) as served:
        yield served


@pytest.fixture(scope="module")
def axe(request: pytest.FixtureRequest) -> str:
    return axe_script(Path(str(request.config.cache.mkdir("axe"))))  # type: ignore[union-attr]


def shot(page: Any) -> NDArray[np.uint8]:
    """The window as people see it [H, W, 3]."""
    data = np.frombuffer(page.page.screenshot(), np.uint8)
    return cv2.imdecode(data, cv2.IMREAD_COLOR)[..., ::-1]


def blue(image: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Where the demo avatar's shirt is: a blue that no place and no control has."""
    r, g, b = image.astype(int).transpose(2, 0, 1)
    return (b > 90) & (b - r > 55) & (b - g > 30) & (r < 110)


@pytest.mark.parametrize(("size", "scheme"), [((320, 640), "dark"), ((1280, 800), "light")], ids=lambda one: str(one))
def test_the_page_shows_somebody_in_a_lit_place(
    open_page: OpenPage, demo: Any, axe: str, size: tuple[int, int], scheme: str
) -> None:
    page = open_page(demo.page, xr=False, size=size, init=settings(size=512), color_scheme=scheme)
    page.until("window.glsplat?.stats().shown > 3")
    page.until("document.querySelectorAll('#people img').length === 2", 60)
    free = page.js("""() => ['top', 'dock'].map((id) => document.getElementById(id).getBoundingClientRect())
      .map(({top, bottom}) => [top, bottom])""")
    (_, above), (below, _) = free
    assert (below - above) / size[1] > (0.55 if size[0] < 400 else COVERED)
    image = shot(page)
    shirt = blue(image)
    rows, columns = np.nonzero(shirt[int(above) : int(below)])
    assert shirt[int(above) : int(below)].sum() > 0.006 * (below - above) * size[0], "nobody is there"
    assert abs(columns.mean() / size[0] - 0.5) < 0.08 and 0.15 < rows.mean() / (below - above) < 0.6
    place = image[int(above) : int(below), :][~shirt[int(above) : int(below)]].astype(float)
    assert place.mean() > 60 and (place.max(axis=1) < 12).mean() < 0.02  # it stands in no black void
    dock = image[int(below) + 2 :].astype(float).mean()
    assert dock > 170 if scheme == "light" else dock < 110  # by the system's wish
    assert page.js("document.documentElement.scrollWidth") <= size[0]
    assert violations(page.page, axe) == []
    page.page.click("#drawer")
    assert violations(page.page, axe) == []


def test_vr_stands_in_a_place_before_its_mirror(open_page: OpenPage, demo: Any) -> None:
    page = open_page(demo.page, init=settings(view="mirror", size=512, driver="rest", place="day"))
    steer(page, head=pose([0, 1.65, 0], pitch=-14))
    enter(page, run=False)
    page.until("(() => { fakeXR.step(); return window.glsplat.stats().place.triangles; })()")  # it is there by then
    fresh(page, 60)
    eyes = see(page)
    for side in ("left", "right"):
        image = eyes[side][..., :3]
        assert 80 < image[-200:].mean() < 190  # a floor that is lit as the place is
        shirt = blue(image)
        assert shirt.sum() > 1500, "nobody is in the mirror"
        y, x = (int(v.mean()) for v in np.nonzero(shirt))
        # the glass shows the room beside the person: what is there is neither black nor the person
        beside = image[y - 20 : y + 20, x + 110 : x + 140].astype(float)
        assert beside.mean() > 4 and not blue(image[y - 20 : y + 20, x + 110 : x + 140]).any()
        feet = image[int(np.nonzero(shirt)[0].max()) :].astype(float)
        assert feet.std() > 5


def test_the_status_page_shows_who_is_there(open_page: OpenPage, demo: Any, axe: str) -> None:
    viewer = open_page(demo.page, xr=False, init=settings(size=512))
    viewer.until("window.glsplat?.stats().shown > 3")
    page = open_page(f"{demo.origin}/", xr=False, size=(1280, 900))
    page.until("document.querySelectorAll('#pictures img').length > 0", 60)
    page.until("document.querySelectorAll('.curve polyline').length === 3", 60)
    page.until("document.querySelectorAll('#people figcaption').length > 0")  # their pictures are drawn first
    assert page.page.locator("#people figcaption").all_text_contents() == ["default", "another"]
    assert "a second" in page.page.text_content("#clients th:nth-child(4)")
    assert violations(page.page, axe) == []
    assert all(address.startswith((demo.origin, "blob:", "data:")) for address in page.requests)


PACKAGE = "axe-core@4.10.3"


def axe_script(cache: Path) -> str:
    """Return the script, from ``cache`` or from npm. Skips where neither has it."""
    stored = cache / f"{PACKAGE}.js"
    if not stored.exists():
        needs.require("npm")
        # a folder of its own: another process of the same run may fetch it, too
        with tempfile.TemporaryDirectory(dir=cache) as folder:
            command = ["npm", "pack", "--silent", PACKAGE]
            done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120)
            if done.returncode:
                pytest.skip(f"npm cannot fetch {PACKAGE}: {(done.stderr or done.stdout).strip()[:200]}")
            with tarfile.open(Path(folder) / done.stdout.split()[-1]) as files:
                member = files.extractfile("package/axe.min.js")
                assert member is not None
                (Path(folder) / "script.js").write_bytes(member.read())
            (Path(folder) / "script.js").replace(stored)
    return stored.read_text(encoding="utf-8")


def violations(page: Any, script: str) -> list[str]:
    """Return what axe finds on a page of Playwright, by all rules of WCAG 2.1 A and AA and best practice."""
    page.evaluate(script)
    found = page.evaluate("async () => (await axe.run(document)).violations")
    return [f"{one['id']}: {one['help']}: {[node['html'][:160] for node in one['nodes'][:4]]}" for one in found]
