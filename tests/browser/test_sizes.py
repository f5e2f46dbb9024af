"""From the smallest phone to a wall, upright and lying: the avatar keeps the window, and everything can be reached."""

from __future__ import annotations

from typing import Any

import pytest

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
MOST = {(320, 640): 0.27, (640, 320): 0.27, (360, 780): 0.25, (3840, 2160): 0.12, (2160, 3840): 0.12}


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
