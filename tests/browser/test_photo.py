"""The page's "Your photo": choosing, watching, what is wrong, wearing and deleting; by keyboard, and on a phone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from glsplat.avatar import Avatar
from glsplat.data import default_avatar
from glsplat.models.catalogue import PHOTO
from glsplat.models.store import state_of
from glsplat.net.backend import AvatarInfo
from glsplat.net.backends.server import make_server
from glsplat.net.server import Server, ServerConfig
from glsplat.net.uploads.job import UploadConfig
from glsplat.net.uploads.routes import Uploads
from tests.apps.serve.quick import make_avatar
from tests.browser.conftest import OpenPage
from tests.browser.markers import as_tracked
from tests.browser.opened import Opened
from tests.browser.stored import StoredPairs
from tests.browser.vr import visit
from tests.net.uploads.makers import make

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
            return Server(
                StoredPairs(),
                config,
                OFFERED,
                Uploads(UploadConfig(folder=folder, make=make, nice=0, **options), described),
            )

        served = serve(make=server)
        served.folder = folder
        return served

    return start


def opened(open_page: OpenPage, served: Any, **options: Any) -> Opened:
    """The page with its panel open."""
    page = visit(open_page, served, **options)
    page.until("!document.querySelector('#photo').hidden")
    page.page.click("#photo summary")
    return page


def send(page: Opened, file: dict[str, Any]) -> None:
    page.page.set_input_files("#photo-front", file)
    page.page.check("#photo-consent")
    page.page.click("#photo-make")


def said(page: Opened) -> str:
    return page.page.text_content("#photo-said")


def test_nothing_is_shown_where_the_server_takes_no_pictures(open_page: OpenPage, serve: Any) -> None:
    page = visit(open_page, serve(StoredPairs(), offered=OFFERED))
    page.until("window.glsplat.stats().shown > 0")
    assert page.page.is_hidden("#photo")


def test_a_picture_is_sent_watched_and_worn_and_the_avatar_deleted(
    open_page: OpenPage, taking: Any, tmp_path: Path
) -> None:
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
    page = opened(open_page, taking())
    send(page, picture("doubt"))
    page.until("!document.querySelector('#photo-anyway').hidden")
    found = page.page.locator("#photo-findings li").all_text_contents()
    assert found == ["From the front: Come nearer.", "From behind: Make more light."]
    assert said(page) == "The picture may not do:" and page.page.is_visible("#photo-again")
    page.page.click("#photo-anyway")
    page.until("!document.querySelector('#photo-wear').hidden")
    assert page.page.is_hidden("#photo-findings")


def test_made_anyway_sends_no_picture_again(open_page: OpenPage, taking: Any) -> None:
    page = opened(open_page, taking())
    posted: list[tuple[str, int]] = []
    page.page.on(
        "request", lambda one: one.method == "POST" and posted.append((one.url, len(one.post_data_buffer or b"")))
    )
    send(page, picture("doubt known"))
    page.until("!document.querySelector('#photo-anyway').hidden")
    page.page.click("#photo-anyway")
    page.until("!document.querySelector('#photo-wear').hidden")
    assert [url.rpartition("/")[2] for url, _ in posted] == ["avatars", "anyway"] and posted[1][1] == 0
    # the picture was looked at once
    assert page.page.locator("#photo-steps li").all_text_contents() == ["looking at the picture", "making the person"]


def test_what_a_busy_server_cannot_make_now_can_be_asked_for_again(open_page: OpenPage, taking: Any) -> None:
    served = taking(waiting=0)
    page = opened(open_page, served, allow=["503"])
    send(page, picture("doubt known"))
    page.until("!document.querySelector('#photo-anyway').hidden")
    queue = served.server._uploads._queue
    other = queue.book("elsewhere")
    page.page.click("#photo-anyway")
    page.until("document.querySelector('#photo-said').textContent.includes('try again in a minute')")
    assert page.page.is_visible("#photo-anyway")
    queue.cancel(other)
    page.page.click("#photo-anyway")
    page.until("!document.querySelector('#photo-wear').hidden")


@pytest.mark.parametrize(
    ("file", "written", "shown"),
    [("Zoë 2.jpg", "", "Zoë 2"), ("<img src=x>.jpg", "", "img src x"), ("x.jpg", "Ann O'Neil", "Ann O'Neil")],
)
def test_its_owner_names_it(open_page: OpenPage, taking: Any, file: str, written: str, shown: str) -> None:
    served = taking()
    page = opened(open_page, served)
    page.page.set_input_files("#photo-front", picture() | {"name": file})
    if written:
        page.page.fill("#photo-name", "<b>no</b>")
        page.page.check("#photo-consent")
        page.page.click("#photo-make")
        page.until("document.activeElement.id === 'photo-name'")
        assert "up to 32 letters" in page.page.text_content("#photo-warning")
        page.page.fill("#photo-name", written)
    page.page.check("#photo-consent")
    page.page.click("#photo-make")
    page.until("!document.querySelector('#photo-wear').hidden")
    page.page.click("#photo-wear")
    page.until("document.querySelector('#avatar').value.startsWith('photo-')")
    assert page.page.text_content("#who") == shown
    assert page.page.text_content("#photo-delete") == f"Delete {shown}"
    tile = "[...document.querySelectorAll('#people .person')].find((one) => one.ariaPressed === 'true')"
    assert page.js(f"{tile}.lastElementChild.textContent") == shown
    page.until(f"{tile}.querySelector('img')?.naturalWidth > 0")  # and has a picture


def test_a_failure_is_said_and_another_picture_chosen(open_page: OpenPage, taking: Any) -> None:
    page = opened(open_page, taking())
    send(page, picture("refuse"))
    page.until("!document.querySelector('#photo-again').hidden")
    assert said(page) == "It did not work: the JPEG file is damaged; copy it again"
    assert page.page.is_hidden("#photo-anyway")
    page.page.click("#photo-again")
    assert page.page.is_visible("#photo-form") and page.js("document.activeElement.id") == "photo-front"


def test_it_can_be_cancelled(open_page: OpenPage, taking: Any) -> None:
    served = taking()
    page = opened(open_page, served)
    send(page, picture("wait"))
    page.until("document.querySelector('#photo-said').textContent === 'Looking at the picture…'")
    page.page.click("#photo-cancel")
    assert page.page.is_visible("#photo-form")
    page.meanwhile(lambda: sum(served.stats()["uploads"].values()) == 0)


def test_a_page_that_is_loaded_again_goes_on_watching(open_page: OpenPage, taking: Any, tmp_path: Path) -> None:
    page = opened(open_page, taking())
    send(page, picture(f"hold {tmp_path / 'go on'}"))
    page.until("document.querySelector('#photo-said').textContent === 'Looking at the picture…'")
    page.page.reload()
    page.until("!document.querySelector('#photo-work').hidden")
    (tmp_path / "go on").touch()
    page.until("!document.querySelector('#photo-wear').hidden")


@pytest.mark.parametrize(
    ("leave_out", "line", "field"),
    [("front", "Choose or take a picture", "photo-front"), ("consent", "Say first", "photo-consent"),
     ("height", "metres from 0.5 to 2.8", "photo-height")],
)  # fmt: skip
def test_what_is_missing_is_asked_for(open_page: OpenPage, taking: Any, leave_out: str, line: str, field: str) -> None:
    page = opened(open_page, taking())
    if leave_out != "front":
        page.page.set_input_files("#photo-front", picture())
    if leave_out != "consent":
        page.page.check("#photo-consent")
    if leave_out == "height":
        page.page.fill("#photo-height", "162")
    page.page.click("#photo-make")
    page.until(f"document.activeElement.id === {field!r}")
    assert line in page.page.text_content("#photo-warning")
    assert page.page.get_attribute(f"#{field}", "aria-invalid") == "true"
    assert not any("/avatars" in address for address in page.requests)


def test_a_picture_over_the_limit_is_made_smaller_and_others_are_sent_as_they_are(
    open_page: OpenPage, taking: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = opened(open_page, taking(picture_bytes=30_000))
    small = picture("x" * 100)
    got = page.js(
        """async ([small, large]) => {
          const { fitted } = await import('/vr/photo/shrink.js');
          const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
          const file = (text) => new File([bytes(text)], 'a', { type: 'image/jpeg' });
          const kept = await fitted(file(small), 30000);
          const made = await fitted(file(large), 30000);
          const bitmap = await createImageBitmap(made);
          return [kept.size, made.size, bitmap.width, bitmap.height];
        }""",
        [_base64(small["buffer"]), _base64(turned(picture("x" * 60_000)["buffer"]))],
    )
    assert got[0] == len(small["buffer"]) and got[1] <= 30_000
    assert got[2:] == [480, 320]  # upright, as EXIF says
    send(page, picture("x" * 60_000))
    page.until("!document.querySelector('#photo-wear').hidden")


def test_what_is_no_picture_is_refused_by_the_browser(open_page: OpenPage, taking: Any) -> None:
    page = opened(open_page, taking())
    send(page, {"name": "me.heic", "mimeType": "image/heic", "buffer": b"not a picture"})
    page.until("document.querySelector('#photo-warning').textContent !== ''")
    assert "cannot read me.heic" in page.page.text_content("#photo-warning")


def test_the_keyboard_and_a_screen_reader_do(open_page: OpenPage, taking: Any) -> None:
    page = opened(open_page, taking())
    reached = set()
    page.page.focus("#photo summary")
    for _ in range(12):
        page.page.keyboard.press("Tab")
        reached.add(page.js("document.activeElement.id"))
    assert {"photo-front", "photo-height", "photo-consent", "photo-make"} <= reached
    page.page.set_input_files("#photo-front", picture("hold"))
    page.page.focus("#photo-consent")
    page.page.keyboard.press("Space")
    page.page.focus("#photo-make")
    page.page.keyboard.press("Enter")
    page.until("document.activeElement.id === 'photo-cancel'")  # the form went away under it
    page.until("document.activeElement.id === 'photo-wear'")
    page.page.keyboard.press("Enter")
    page.until("document.querySelector('#avatar').value.startsWith('photo-')")
    nameless = page.js("""() => [...document.querySelectorAll('#photo button, #photo input, #photo img, progress')]
      .filter((e) => !(e.labels?.length || e.alt || e.textContent.trim() || e.ariaLabel ||
        e.getAttribute('aria-labelledby'))).map((e) => e.outerHTML)""")
    assert nameless == []


def test_a_phone_offers_its_camera(open_page: OpenPage, taking: Any) -> None:
    page = opened(open_page, taking(), size=(360, 640), has_touch=True, is_mobile=True)
    assert page.page.is_visible("#photo-take") and page.page.get_attribute("#photo-take", "capture") == "environment"
    assert page.js("[document.documentElement.scrollWidth, panel.scrollWidth - panel.clientWidth]") == [360, 0]
    page.page.set_input_files("#photo-front", picture("a"))
    page.page.set_input_files("#photo-take", picture("b"))
    assert page.page.input_value("#photo-front") == ""  # the one taken last counts


@pytest.mark.gl
@pytest.mark.shared
@pytest.mark.slow
@pytest.mark.timeout(700)
def test_a_real_capture_is_worn(open_page: OpenPage, serve: Any, tmp_path: Path, shared_data: Path) -> None:
    if any(state_of(model) != "here" for model in PHOTO.models):
        pytest.skip("needs the networks of 'glsplat models get'")
    uploads = UploadConfig(folder=tmp_path / "avatars", make=make_avatar)
    served = serve(make=lambda config: make_server(default_avatar(), config, uploads=uploads))
    # taking the picture of the canvas alone wants a style that the page does not allow
    page = opened(open_page, served, allow=["Applying inline style"])
    data = (shared_data / "participants" / "capture" / "p01.jpg").read_bytes()
    send(page, {"name": "me.jpg", "mimeType": "image/jpeg", "buffer": data})
    ended = "['#photo-wear', '#photo-again'].some((id) => !document.querySelector(id).hidden)"
    page.until(ended, timeout=650, every=1)
    assert page.page.is_visible("#photo-wear"), said(page)
    page.page.click("#photo-wear")
    page.until("document.querySelector('#avatar').value.startsWith('photo-')")
    shown = page.stats()["shown"]
    page.until(f"window.glsplat.stats().shown > {shown + 2}", timeout=60)
    assert page.canvas().max() > 60


def turned(data: bytes) -> bytes:
    """The JPEG with EXIF that says: turned by 90 degrees."""
    exif = b"Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0"
    return data[:2] + b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif + data[2:]


def _base64(data: bytes) -> str:
    import base64

    return base64.b64encode(data).decode()
