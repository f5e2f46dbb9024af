"""/vr?emulate: an emulated headset, served by us, for whoever has none."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from glsplat.net.backend import AvatarInfo
from tests.browser.conftest import OpenPage
from tests.browser.markers import as_tracked
from tests.browser.stored import StoredPairs
from tests.browser.vr import visit

OFFERED = (AvatarInfo(name="stored", solver=as_tracked, height=1.75, parts=frozenset({"head"})),)


def test_vr_is_entered_without_a_headset(open_page: OpenPage, serve: Any) -> None:
    served = serve(StoredPairs(), offered=OFFERED)
    plain = visit(open_page, served, xr=None)
    plain.until("window.glsplat?.stats().shown > 0")
    assert not [address for address in plain.requests if "emulate" in address]  # nobody else loads it
    page = visit(open_page, served, {"drawer": False}, xr=None, address=f"{served.page}?emulate")
    page.until("window.glsplat?.stats().shown > 0")
    page.until("!document.querySelector('#enter-vr').disabled")
    page.page.click("#enter-vr")
    page.until("window.glsplat.stats().session === 'vr'")
    shown = page.stats()["shown"]
    page.until(f"window.glsplat.stats().shown > {shown + 2}")
    for _ in range(8):  # a canvas that is cleared for each frame shows one each time
        seen = cv2.imdecode(np.frombuffer(page.page.screenshot(), np.uint8), cv2.IMREAD_COLOR)
        assert seen.max() > 100
    assert all(address.startswith((served.origin, "ws://localhost", "blob:", "data:")) for address in page.requests)
    licence = page.js("fetch('/vr/emulate/LICENSE-iwer.txt').then((answer) => answer.text())")
    assert "MIT License" in licence and "Meta Platforms" in licence
