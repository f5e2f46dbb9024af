"""Draws the pictures of docs/vr.md anew: both eyes of a headset in each view, other places, the page, a photograph; and
of docs/light.md the avatar in three places.

    python -m tools.docs.vr_pictures [docs/images [mirror facing own places page light photo]]

The avatar is glsplat's own, the headset the fake one with a Quest 3's frusta, or the middle
of them. Look at every picture.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import cv2
import numpy as np

import glsplat
from apps.serve.wiring import assemble
from glsplat.data import PEOPLE, participants_folder
from glsplat.formats.scene_file import SceneFile
from glsplat.net.served_scene import ServedScene
from tests.browser.opened import Opened
from tests.browser.served import Served
from tests.browser.vr import enter, fresh, hands, pose, see, settings, steer
from tools.docs.chromium import chromium, page_of

QUALITY = 88  # JPEG
PATIENCE = 240  # seconds for a picture
LIT = ("day", "studio", "night")

# view: the head, the left and the right wrist, and the frusta, degrees of the left eye: None for the headset's own,
# else the middle of what it shows, so that a face is more than a few pixels
STANDING = pose([0, 1.735, 0], pitch=-6), pose([-0.25, 0.86, 0.0], pitch=-80), pose([0.3, 1.42, -0.22], pitch=70)
MIDDLE = {"left": 27, "right": 27, "up": 20, "down": 34}
UPRIGHT = slice(230, 794)  # columns of those views: who stands there, without the menu beside
DEVICE = {
    "mirror": (*STANDING, MIDDLE),
    "facing": (*STANDING, MIDDLE),
    "own": (
        pose([0, 1.68, 0], pitch=-42),
        pose([-0.2, 1.2, -0.38], pitch=15),
        pose([0.22, 1.25, -0.4], pitch=25),
        None,
    ),
}
SETTLING = 5  # pictures until the body has followed its hands


def save(folder: Path, name: str, image: Any) -> None:
    path = folder / f"{name}.jpg"
    cv2.imwrite(str(path), image[..., 2::-1], [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    print(path, image.shape, path.stat().st_size // 1024, "kB")


def seen_in(browser: Any, address: str, view: str, **values: Any) -> dict[str, Any]:
    """What both eyes see once the body has followed its hands."""
    init = settings(view=view, size=1024, quality=90, driver="rest", **values)
    with page_of(browser, address, init) as page:
        head, left, right, frusta = DEVICE[view]
        steer(page, head=head, input="hands", hands=hands(left, right), **({"fov": frusta} if frusta else {}))
        enter(page, run=False)
        for _ in range(SETTLING):
            fresh(page, PATIENCE)
        return see(page)


def lit_in(browser: Any, address: str, place: str) -> np.ndarray:
    """The middle of the flat page, where the avatar stands in a place."""
    init = settings(size=1024, quality=90, driver="motion:idle", place=place)
    with page_of(browser, address, init, (900, 800), xr=False) as page:
        page.until("window.glsplat.stats().shown > 3", PATIENCE)
        page.js("document.body.style.visibility = 'hidden'")
        page.js("document.querySelector('canvas').style.visibility = 'visible'")
        return shot_of(page, {"x": 210, "width": 480})


def photo(browser: Any) -> np.ndarray:
    """The page of a server of its own: a picture is chosen, its avatar is made, and worn."""
    with tempfile.TemporaryDirectory() as made:
        command = [sys.executable, "-m", "apps.cli", "serve", "--port", "0", "--json", "--allow-upload", made]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
            try:
                assert server.stdout is not None
                port = urlsplit(json.loads(server.stdout.readline())["url"]).port
                init = settings(size=512, driver="motion:idle", drawer=True)
                with page_of(browser, f"http://localhost:{port}/vr", init, (1280, 800), xr=False) as page:
                    return np.hstack(list(shots(page)))
            finally:
                server.terminate()


def shots(page: Opened) -> Iterator[np.ndarray]:
    """The drawer with the picture, the drawer with the steps, and the avatar that is worn."""
    page.until("!document.querySelector('#photo').hidden", PATIENCE)
    page.js("document.querySelector('#photo').open = true")
    page.page.set_input_files("#photo-front", str(participants_folder() / "capture" / "p06.jpg"))
    page.page.check("#photo-consent")
    page.js("document.querySelector('#photo-shown').scrollIntoView({block: 'center'})")
    drawer = page.page.locator("#panel")
    yield shot_of(page, drawer.bounding_box())
    page.page.click("#photo-make")
    page.until("document.querySelectorAll('#photo-steps li').length > 4", 4 * PATIENCE)
    page.js("document.querySelector('#photo-steps').scrollIntoView({block: 'center'})")
    yield shot_of(page, drawer.bounding_box())
    page.until("!document.querySelector('#photo-wear').hidden", 4 * PATIENCE)
    page.page.click("#photo-wear")
    before = page.js("window.glsplat.stats().shown")
    page.until(f"window.glsplat.stats().shown > {before} + 12", PATIENCE)
    yield shot_of(page, {"x": 0, "y": 0, "width": 910, "height": 800})


def shot_of(page: Opened, box: Any) -> np.ndarray:
    """A part of the page, 800 pixels high, RGB."""
    encoded = np.frombuffer(page.page.screenshot(clip=dict(box) | {"y": 0, "height": 800}), np.uint8)
    image = cv2.imdecode(encoded, cv2.IMREAD_COLOR)
    assert image is not None
    return np.asarray(image[..., ::-1])


def main(folder: Path, names: list[str]) -> None:
    ben = ServedScene(file=SceneFile.of(glsplat.default_avatar()), title="ben")
    with (
        Served(make=lambda config: assemble(ben, config, people=PEOPLE)) as served,
        chromium() as browser,
    ):
        for view in DEVICE:
            if view in names:
                seen = seen_in(browser, served.page, view)
                columns = slice(None) if DEVICE[view][3] is None else UPRIGHT
                save(folder, f"vr-{view}", np.hstack([seen[eye][:, columns] for eye in ("left", "right")]))
        if "places" in names:
            eyes = [seen_in(browser, served.page, "mirror", place=place)["right"] for place in ("studio", "night")]
            save(folder, "vr-places", np.hstack(eyes))
        if "page" in names:
            init = settings(size=1024, quality=90, driver="motion:idle")
            with page_of(browser, served.page, init, (1280, 800), xr=False) as page:
                page.until("window.glsplat.stats().shown > 6", PATIENCE)
                page.until("document.querySelector('#people img') !== null", PATIENCE)
                save(folder, "vr-page", shot_of(page, {"x": 0, "width": 1280}))
        if "light" in names:
            save(folder, "light-places", np.hstack([lit_in(browser, served.page, place) for place in LIT]))
        if "photo" in names:
            save(folder, "vr-photo", photo(browser))


if __name__ == "__main__":
    given = sys.argv[2:] or [*DEVICE, "places", "page", "light", "photo"]
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "docs/images"), given)
