"""The page's "Your photo": choosing, watching, what is wrong, wearing and deleting; by keyboard, and on a phone."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from glsplat.avatar import Avatar
from glsplat.extras.uploads.job import UploadConfig
from glsplat.extras.uploads.routes import Uploads
from glsplat.net.backend import AvatarInfo
from glsplat.net.served_scene import server_of
from glsplat.net.server import Server, ServerConfig
from tests.browser.conftest import OpenPage
from tests.browser.markers import as_tracked
from tests.browser.opened import Opened
from tests.browser.stored import StoredPairs
from tests.browser.vr import visit
from tests.extras.uploads.makers import make

OFFERED = (AvatarInfo(name="stored", solver=as_tracked, height=1.75, parts=frozenset({"head"})),)


def picture(words: str = "", side: int = 320) -> dict[str, Any]:
    """A file for an input: a JPEG with ``words`` behind its end, which the stub does."""
    image = np.full((side * 3 // 2, side, 3), 190, np.uint8)
    cv2.ellipse(image, (side // 2, side), (side // 5, side // 2), 0, 0, 360, (90, 60, 30), -1)
    cv2.circle(image, (side // 2, side // 3), side // 10, (120, 150, 200), -1)
    data = cv2.imencode(".jpg", image)[1].tobytes() + words.encode()
    return {"name": "me.jpg", "mimeType": "image/jpeg", "buffer": data}


@pytest.fixture
def taking(serve: Any, tmp_path: Path) -> Any:
    """``taking(**of UploadConfig)``: a server whose pictures are stored, and whose avatars a stub makes."""

    def described(name: str, avatar: Avatar) -> AvatarInfo:
        title = str(avatar.meta.get("title"))
        return AvatarInfo(name=name, title=title, solver=as_tracked, height=1.7, parts=frozenset({"head"}), made=True)

    def start(**options: Any) -> Any:
        folder = tmp_path / "avatars"
        folder.mkdir(exist_ok=True)

        def server(config: ServerConfig) -> Server:
            uploads = Uploads(UploadConfig(folder=folder, make=make, nice=0, **options), described)
            return server_of(StoredPairs(), config, OFFERED, [uploads])

        served = serve(make=server)
        served.folder = folder
        return served

    return start


def opened(open_page: OpenPage, served: Any, **options: Any) -> Opened:
    """The page with its panel open."""
    page = visit(open_page, served, **options)
    page.until("document.querySelector('#photo')?.hidden === false")
    page.page.click("#photo summary")
    return page


def send(page: Opened, file: dict[str, Any]) -> None:
    page.page.set_input_files("#photo-front", file)
    page.page.check("#photo-consent")
    page.page.click("#photo-make")


def said(page: Opened) -> str:
    return page.page.text_content("#photo-said")


def test_a_picture_is_sent_watched_and_worn_and_the_avatar_deleted(
    open_page: OpenPage, taking: Any, serve: Any, tmp_path: Path
) -> None:
    other = visit(open_page, serve(StoredPairs(), offered=OFFERED))
    other.until("window.glsplat.stats().shown > 0")
    assert other.page.is_hidden("#photo")  # where the server takes no pictures
    served = taking()
    page = opened(open_page, served)
    page.allowed.append("404 .*/thumbnails/photo-")  # asked for while it is deleted
    page.page.set_input_files("#photo-front", picture(f"hold {tmp_path / 'go on'}"))
    page.until("document.getElementById('photo-shown').naturalWidth === 320")
    assert page.page.is_visible("#photo-shown")
    page.page.fill("#photo-height", "1.62")
    page.page.check("#photo-consent")
    page.page.click("#photo-make")
    page.until("document.querySelector('#photo-said').textContent === 'Looking at the picture…'")
    assert page.page.is_visible("#photo-share") and page.page.is_hidden("#photo-form")
    page.page.reload()  # a page that is loaded again goes on watching
    page.until("document.querySelector('#photo-work')?.hidden === false")
    page.js("document.querySelector('#photo').open = true")
    (tmp_path / "go on").touch()
    page.until("!document.querySelector('#photo-wear').hidden")
    assert said(page) == "Your avatar is ready."
    assert page.page.locator("#photo-steps li").all_text_contents() == ["looking at the picture", "making the person"]
    name = page.js("[...document.querySelector('#avatar').options].at(-1).value")
    assert name.startswith("photo-") and page.page.input_value("#avatar") == "stored"
    page.page.click("#photo-wear")
    page.until(f"document.querySelector('#avatar').value === {name!r}")
    page.until("window.glsplat.stats().state === 'open'")
    assert page.page.is_visible("#photo-form") and page.page.input_value("#photo-front") == ""
    assert not page.page.is_checked("#photo-consent") and page.page.is_hidden("#photo-shown")
    assert [path.name for path in served.folder.iterdir()] == [f"{name}.glb"]

    page.page.click("#photo-delete")
    assert "Press again" in page.page.text_content("#photo-delete") and list(served.folder.iterdir())
    page.page.click("#photo-delete")
    page.until("document.querySelector('#avatar').value === 'stored'")
    page.until("document.querySelector('#avatar').options.length === 1")
    assert list(served.folder.iterdir()) == [] and page.page.is_hidden("#photo-delete-row")


def test_what_is_wrong_is_said_and_it_is_made_anyway(open_page: OpenPage, taking: Any) -> None:
    """The second request sends no picture again; a busy server is asked once more."""
    served = taking(waiting=0)
    page = opened(open_page, served, allow=["503"])
    posted: list[tuple[str, int]] = []
    page.page.on(
        "request", lambda one: one.method == "POST" and posted.append((one.url, len(one.post_data_buffer or b"")))
    )
    send(page, picture("doubt known"))
    page.until("!document.querySelector('#photo-anyway').hidden")
    found = page.page.locator("#photo-findings li").all_text_contents()
    assert found and said(page) == "The picture may not be suitable:" and page.page.is_visible("#photo-again")
    queue = served.server.feature(Uploads)._queue
    other = queue.book("elsewhere")
    page.page.click("#photo-anyway")
    page.until("document.querySelector('#photo-said').textContent.includes('try again in a minute')")
    queue.cancel(other)
    page.page.click("#photo-anyway")
    page.until("!document.querySelector('#photo-wear').hidden")
    assert page.page.is_hidden("#photo-findings")
    assert [url.rpartition("/")[2] for url, _ in posted] == ["avatars", "anyway", "anyway"] and posted[2][1] == 0


def test_a_failure_is_said_another_picture_chosen_and_cancelled(open_page: OpenPage, taking: Any) -> None:
    served = taking()
    page = opened(open_page, served)
    send(page, {"name": "me.heic", "mimeType": "image/heic", "buffer": b"not a picture"})
    page.until("document.querySelector('#photo-warning').textContent !== ''")
    assert "cannot read me.heic" in page.page.text_content("#photo-warning")
    send(page, picture("refuse"))
    page.until("!document.querySelector('#photo-again').hidden")
    assert said(page) == "It failed: the JPEG file is damaged; copy it again"
    assert page.page.is_hidden("#photo-anyway")
    page.page.click("#photo-again")
    assert page.page.is_visible("#photo-form") and page.js("document.activeElement.id") == "photo-front"
    send(page, picture("wait"))
    page.until("document.querySelector('#photo-said').textContent === 'Looking at the picture…'")
    there = sum(served.stats()["uploads"].values())
    page.page.click("#photo-cancel")
    assert page.page.is_visible("#photo-form")
    page.meanwhile(lambda: sum(served.stats()["uploads"].values()) < there)


def test_what_is_missing_is_asked_for_and_its_owner_names_it(open_page: OpenPage, taking: Any) -> None:
    page = opened(open_page, taking())

    def asked(field: str, line: str) -> None:
        page.page.click("#photo-make")
        page.until(f"document.activeElement.id === {field!r}")
        assert line in page.page.text_content("#photo-warning")
        assert page.page.get_attribute(f"#{field}", "aria-invalid") == "true"

    asked("photo-front", "Choose or take a picture")
    page.page.set_input_files("#photo-front", picture() | {"name": "<img src=x>.jpg"})
    page.page.fill("#photo-height", "162")
    page.page.check("#photo-consent")
    asked("photo-height", "metres from 0.5 to 2.8")
    page.page.fill("#photo-height", "")
    page.page.uncheck("#photo-consent")
    asked("photo-consent", "First confirm")
    page.page.check("#photo-consent")
    page.page.fill("#photo-name", "<b>no</b>")
    asked("photo-name", "up to 32 letters")
    assert not any("/avatars" in address for address in page.requests)
    page.page.fill("#photo-name", "")  # then it is the file's
    page.page.click("#photo-make")
    page.until("!document.querySelector('#photo-wear').hidden")
    page.page.click("#photo-wear")
    page.until("document.querySelector('#avatar').value.startsWith('photo-')")
    assert page.page.text_content("#who") == "img src x"
    assert page.page.text_content("#photo-delete") == "Delete img src x"
    tile = "[...document.querySelectorAll('#people .person')].find((one) => one.ariaPressed === 'true')"
    page.until(f"{tile}.querySelector('img')?.naturalWidth > 0")  # and has a picture


def test_a_picture_over_the_limit_is_made_smaller_and_others_are_sent_as_they_are(
    open_page: OpenPage, taking: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = opened(open_page, taking(picture_bytes=30_000))
    small = picture("x" * 100)
    got = page.js(
        """async ([small, large]) => {
          const { fitted } = await import('/vr/photo/upload.js');
          const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
          const file = (text) => new File([bytes(text)], 'a', { type: 'image/jpeg' });
          const kept = await fitted(file(small), 30000);
          const made = await fitted(file(large), 30000);
          const bitmap = await createImageBitmap(made);
          return [kept.size, made.size, bitmap.width, bitmap.height];
        }""",
        [
            base64.b64encode(small["buffer"]).decode(),
            base64.b64encode(turned(picture("x" * 60_000)["buffer"])).decode(),
        ],
    )
    assert got[0] == len(small["buffer"]) and got[1] <= 30_000
    assert got[2:] == [480, 320]  # upright, as EXIF says
    send(page, picture("x" * 60_000))
    page.until("!document.querySelector('#photo-wear').hidden")


def test_a_phone_offers_its_camera(open_page: OpenPage, taking: Any) -> None:
    page = opened(open_page, taking(), size=(360, 640), has_touch=True, is_mobile=True)
    assert page.page.is_visible("#photo-take") and page.page.get_attribute("#photo-take", "capture") == "environment"
    assert page.js("[document.documentElement.scrollWidth, panel.scrollWidth - panel.clientWidth]") == [360, 0]
    nameless = page.js("""() => [...document.querySelectorAll('#photo button, #photo input, #photo img, progress')]
      .filter((e) => !(e.labels?.length || e.alt || e.textContent.trim() || e.ariaLabel ||
        e.getAttribute('aria-labelledby'))).map((e) => e.outerHTML)""")
    assert nameless == []
    page.page.set_input_files("#photo-front", picture("a"))
    page.page.set_input_files("#photo-take", picture("b"))
    assert page.page.input_value("#photo-front") == ""  # the one taken last counts


def turned(data: bytes) -> bytes:
    """The JPEG with EXIF that says: turned by 90 degrees."""
    exif = b"Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0"
    return data[:2] + b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif + data[2:]
