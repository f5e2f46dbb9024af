"""From the smallest phone to a wall, upright and lying: the avatar keeps the window, and everything can be reached."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest

from glsplat.net.pages.qr import svg
from tests.browser.flat_page import flat_page

MAIN = """
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
MOST = {(320, 640): 0.27, (640, 320): 0.27, (3840, 2160): 0.12}


@pytest.mark.parametrize("size", MOST, ids=lambda size: f"{size[0]}x{size[1]}")
def test_the_controls_leave_the_window_to_the_avatar(chromium: Any, size: tuple[int, int]) -> None:
    width, height = size
    with flat_page(chromium, MAIN, viewport={"width": width, "height": height}) as page:
        page.wait_for_selector("#people-3")
        dock = page.evaluate("document.getElementById('dock').getBoundingClientRect().height")
        assert 0.02 < dock / height < MOST[size], "of the height is the dock's"
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
window.tried = true;
"""


@pytest.mark.parametrize("width", [320, 3840])
def test_the_code_for_another_device_is_whole_at_any_size(chromium: Any, width: int) -> None:
    """As the dialog shows it it is read again: nothing of it is cut off."""
    address = "https://192.168.1.7:8000/vr"
    with flat_page(chromium, SHOWN, viewport={"width": width, "height": 800}) as page:
        page.wait_for_function("() => window.tried", polling=50)
        page.evaluate("(code) => { window.code = code; return other.open(); }", svg(address))
        picture = page.locator("#code img")
        page.wait_for_timeout(200)
        assert picture.evaluate("async (image) => { await image.decode(); return image.naturalWidth; }") > 100
        seen = cv2.imdecode(np.frombuffer(picture.screenshot(), np.uint8), cv2.IMREAD_COLOR)
        seen = cv2.copyMakeBorder(seen, 20, 20, 20, 20, cv2.BORDER_CONSTANT, value=(255, 255, 255))
        assert cv2.QRCodeDetector().detectAndDecode(cv2.resize(seen, None, fx=2, fy=2))[0] == address
