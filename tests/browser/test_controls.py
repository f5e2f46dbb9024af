"""The flat page: its controls and settings in both directions, by keyboard, and on a phone."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
import pytest

from glsplat.extras.operations.qr import svg
from tests.browser.flat_page import flat_page

NAMED = "button, select, input, canvas, summary, a, details, section, aside, form"


# the controls alone: what they ask for is kept in window.asked
MAIN = """
import { Page } from '/vr/page.js';
import { Settings } from '/vr/settings.js';
const settings = new Settings();
const page = new Page(document, settings);
const asked = [];
for (const type of ['enter-vr', 'enter-ar', 'token', 'record', 'file', 'calibrate', 'fullscreen']) {
  page.addEventListener(type, (event) => asked.push([type, event.detail?.name ?? event.detail ?? null]));
}
Object.assign(window, { settings, page, asked });
"""


@pytest.fixture(scope="module")
def loaded(chromium):
    with flat_page(chromium, MAIN) as page:
        yield page


@pytest.fixture
def page(loaded):
    """The page as a new user finds it."""
    loaded.evaluate("localStorage.clear()")
    again(loaded)
    return loaded


def again(page):
    page.reload()
    page.wait_for_function("window.page !== undefined")
    page.evaluate("settings.set('drawer', true)")


def test_controls_and_settings_follow_each_other(page):
    page.select_option("#view", "own")
    page.select_option("#size", "512")
    page.check("#stereo")
    page.fill("#height", "1.62")
    page.locator("#height").blur()
    page.evaluate("settings.setOptions('room', [{value: ''}, {value: 'lab'}])")  # else there are no fields for it
    page.fill("#name", " Zoë ")
    page.locator("#name").blur()
    page.locator("#quality").focus()
    page.keyboard.press("ArrowRight")
    got = page.evaluate("Object.fromEntries(settings.names.map((n) => [n, settings.get(n)]))")
    assert got == {
        "view": "own", "place": "day", "avatar": "", "room": "", "name": "Zoë",
        "size": 512, "quality": 81, "drawn": "auto", "driver": "rest", "stereo": True, "height": 1.62,
        "figures": False, "drawer": True, "light": True,
    }  # fmt: skip
    assert page.text_content("#quality-value") == "81"
    page.evaluate("settings.set('view', 'facing'); settings.set('figures', true); settings.set('height', null)")
    assert page.input_value("#view") == "facing" and page.is_checked("#figures") and page.input_value("#height") == ""
    again(page)
    assert page.input_value("#view") == "facing" and page.input_value("#size") == "512"
    assert page.is_checked("#stereo") and page.input_value("#quality") == "81"
    assert page.is_checked("#figures") and page.get_attribute("#figures-box", "hidden") is None


def test_choices_come_from_the_server_and_earlier_ones_come_back(page):
    assert page.is_disabled("#avatar")
    page.evaluate("settings.setOptions('avatar', [{value: 'a'}, {value: 'b', label: 'Bea <b>'}])")
    assert page.input_value("#avatar") == "a"
    page.select_option("#avatar", "b")
    assert page.locator("#avatar option:checked").text_content() == "Bea <b>"
    changes = page.evaluate("""() => {
      const seen = []; settings.addEventListener('change', (e) => seen.push([e.detail.name, e.detail.value]));
      settings.setOptions('avatar', [{value: 'c'}]); settings.setOptions('avatar', [{value: 'c'}, {value: 'b'}]);
      settings.setOptions('driver', [{value: 'rest'}, {value: 'motion:idle', label: 'idle'}]);
      return seen;
    }""")
    assert changes == [["avatar", "c"], ["avatar", "b"], ["driver", "motion:idle"]]
    assert page.input_value("#avatar") == "b" and page.input_value("#driver") == "motion:idle"


def test_what_no_setting_may_be_and_storage_that_is_none_are_refused(page):
    kept = "([n, v]) => { const before = settings.get(n); return [settings.set(n, v), settings.get(n) === before]; }"
    for name, value in (
        ("view", "above"), ("size", 600), ("quality", 49), ("quality", 96), ("quality", "x"), ("quality", None),
        ("height", 3), ("height", "tall"), ("height", math.inf), ("stereo", "yes"), ("figures", 1),
    ):  # fmt: skip
        assert page.evaluate(kept, [name, value]) == [False, True], (name, value)
    for text in ("{", "[1]", "null", '{"size": 7, "view": {}, "quality": "80", "stereo": 3}'):
        page.evaluate("(kept) => localStorage.setItem('glsplat.settings', kept)", text)
        again(page)
        got = page.evaluate("['size', 'view', 'quality', 'stereo'].map((n) => settings.get(n))")
        assert got == [1024, "mirror", 80, False]
    assert page.evaluate("""() => {
      const broken = { getItem() { throw new Error('no'); }, setItem() { throw new Error('no'); } };
      return import('/vr/settings.js').then(({ Settings }) => [broken, null].map((s) => {
        const settings = new Settings(s); return settings.set('size', 512) && settings.get('size'); }));
    }""") == [512, 512]


def test_a_wrong_height_is_said_in_words(page):
    page.fill("#height", "175")
    page.locator("#height").blur()
    assert page.get_attribute("#height", "aria-invalid") == "true" and "metres" in page.text_content("#height-note")
    assert page.evaluate("settings.get('height')") is None
    page.fill("#height", "1.75")
    page.locator("#height").blur()
    assert page.get_attribute("#height", "aria-invalid") == "false" and "Optional" in page.text_content("#height-note")
    assert page.evaluate("settings.get('height')") == 1.75


def test_the_buttons_ask_and_say_why_they_cannot(page):
    assert page.is_disabled("#enter-vr") and page.text_content("#vr-note") == "looking for a headset…"
    page.evaluate("window.page.xr({ vr: true, ar: 'no headset here' })")
    assert page.text_content("#ar-note") == "no headset here" and page.is_disabled("#enter-ar")
    for button in ("#enter-vr", "#record", "#fullscreen"):
        page.click(button)
    assert page.is_disabled("#calibrate")
    page.evaluate("window.page.inside(true); window.page.recording(true)")
    page.click("#calibrate")
    assert page.is_disabled("#enter-vr") and page.text_content("#record") == "Stop and save"
    page.select_option("#driver", "file")
    page.set_input_files("#file", {"name": "mine.jsonl", "mimeType": "text/plain", "buffer": b"{}"})
    asked = [["enter-vr", None], ["record", None], ["fullscreen", None], ["calibrate", None], ["file", "mine.jsonl"]]
    assert page.evaluate("asked") == asked
    again(page)
    assert page.input_value("#driver") == "rest" and page.is_hidden("#file-row")  # the file is gone, so is the choice


def test_the_token_is_asked_for_and_handed_over_once(page):
    assert page.is_hidden("#token-form")
    page.evaluate("window.page.askToken('The server wants a token.')")
    assert page.evaluate("document.activeElement.id") == "token"
    page.keyboard.type(" geheim ")
    page.keyboard.press("Enter")
    assert page.evaluate("asked") == [["token", "geheim"]] and page.is_hidden("#token-form")
    assert page.input_value("#token") == "" and "geheim" not in page.url
    assert page.evaluate("JSON.stringify(localStorage)").find("geheim") < 0


def test_every_control_has_a_name_and_the_keyboard_reaches_it(page):
    page.evaluate("""window.page.xr({ vr: true, ar: true }); window.page.askToken('why');
      settings.setOptions('avatar', [{value: 'a'}]); settings.set('driver', 'file');
      settings.set('figures', true); window.page.numbers({ fps: '30' });
      document.getElementById('help').open = true;""")
    wanted = set("canvas token enter-vr enter-ar avatar driver file view size quality".split())
    wanted |= set("height stereo figures record fullscreen".split())
    page.evaluate("document.activeElement.blur()")
    reached = set()
    for _ in range(60):
        page.keyboard.press("Tab")
        reached.add(page.evaluate("document.activeElement.id"))
        outline = page.evaluate("getComputedStyle(document.activeElement).outlineStyle")
        assert outline != "none" or page.evaluate("document.activeElement === document.body")
    assert wanted <= reached
    nameless = page.evaluate(
        """(named) => [...document.querySelectorAll(named)].filter((e) => !(e.getAttribute('aria-label') ||
          e.labels?.length || ['SUMMARY', 'BUTTON', 'A'].includes(e.tagName) && e.textContent.trim() ||
          e.tagName === 'DETAILS')).map((e) => e.outerHTML)""",
        NAMED,
    )
    assert nameless == []
    assert page.get_attribute("html", "lang") == "en" and page.title() and page.locator("main, aside").count() == 2
    ids = page.evaluate("[...document.querySelectorAll('[id]')].map((e) => e.id)")
    assert len(ids) == len(set(ids))


SIZED = """
import { Page } from '/vr/page.js';
import { Settings } from '/vr/settings.js';
import { Dock } from '/vr/show/dock.js';
const settings = new Settings();
const page = new Page(document, settings);
new Dock(document, settings, { picture: async () => null, add: () => {} });
settings.setOptions('avatar', ['default', 'anna', 'ben', 'A rather long name of somebody'].map((value) => ({ value })));
const motions = ['rest', 'motion:idle', 'motion:walk', 'motion:wave-and-turn'];
settings.setOptions('driver', motions.map((value) => ({ value, label: value })));
page.xr({ vr: 'No headset is connected to this device.', ar: 'No headset is connected to this device.' });
page.status('The server ended the connection: no valid request in time', 'error');
page.title('A rather long name of somebody', 'Try again now');
window.settings = settings;
"""
MOST = {(320, 640): 0.27, (640, 320): 0.27, (960, 600): 0.17, (3840, 2160): 0.12}


def test_the_controls_leave_the_window_to_the_avatar(chromium: Any) -> None:
    with flat_page(chromium, SIZED) as page:
        page.wait_for_selector("#people-3")
        for (width, height), most in MOST.items():
            page.set_viewport_size({"width": width, "height": height})
            page.wait_for_timeout(100)
            dock = page.evaluate("document.getElementById('dock').getBoundingClientRect().height")
            assert 0.02 < dock / height < most, (width, height)
            assert page.evaluate("document.documentElement.scrollWidth") <= width
            # every button can be brought into the window, and has room for a finger
            for button in page.query_selector_all("#dock button, #top button"):
                if not button.is_visible():
                    continue
                button.scroll_into_view_if_needed()
                x, y, wide, high = (button.bounding_box()[name] for name in ("x", "y", "width", "height"))
                assert x >= -1 and y >= 0 and x + wide <= width + 1 and y + high <= height + 1, button.inner_text()
                assert min(wide, high) >= 44, button.inner_text()
            text = float(page.evaluate("parseFloat(getComputedStyle(document.getElementById('who')).fontSize)"))
            assert text >= max(16, min(width, height) / 110)  # a wall is read from afar


SHOWN = """
import { Elsewhere } from '/vr/show/elsewhere.js';
const found = { page: 'https://192.168.1.7:8000/vr', local: false };
window.other = new Elsewhere(document, async () => ({ ...found, svg: window.code }));
"""


def test_the_code_for_another_device_is_whole_in_a_narrow_window(chromium: Any) -> None:
    address = "https://192.168.1.7:8000/vr"
    with flat_page(chromium, SHOWN, "window.other", viewport={"width": 320, "height": 800}) as page:
        page.evaluate("(code) => { window.code = code; return other.open(); }", svg(address))
        picture = page.locator("#code img")
        page.wait_for_timeout(200)
        assert picture.evaluate("async (image) => { await image.decode(); return image.naturalWidth; }") > 100
        seen = cv2.imdecode(np.frombuffer(picture.screenshot(), np.uint8), cv2.IMREAD_COLOR)
        seen = cv2.copyMakeBorder(seen, 20, 20, 20, 20, cv2.BORDER_CONSTANT, value=(255, 255, 255))
        assert cv2.QRCodeDetector().detectAndDecode(cv2.resize(seen, None, fx=2, fy=2))[0] == address
