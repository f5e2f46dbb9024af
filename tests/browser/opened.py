"""A page in Chromium and what went wrong on it; how tests wait for it and read its pictures back."""

from __future__ import annotations

import base64
import re
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["FAKE_XR", "Opened", "decoded", "script"]

_JS = Path(__file__).parent / "js"


def script(*names: str) -> str:
    """Files of js/ as one function, to run before the page."""
    return "(() => {" + "\n".join((_JS / f"{name}.js").read_text(encoding="utf-8") for name in names) + "})();"


FAKE_XR = script("fake_xr_types", "pixels", "fake_xr", "fake_xr_session")
WATCH = script("pixels", "watch")


@dataclass
class Opened:
    """One page. ``faults`` holds errors of its console, exceptions nobody caught, and breaches of its CSP."""

    page: Any  # playwright's Page
    allowed: list[str] = field(default_factory=list)  # patterns of faults that this test brings about
    faults: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)  # addresses of everything it asked for

    def __post_init__(self) -> None:
        self.page.on("console", self._console)
        self.page.on("pageerror", lambda error: self.faults.append(f"exception: {error}"))
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.on("websocket", lambda socket: self.requests.append(socket.url))

    def _console(self, message: Any) -> None:
        if message.type == "error":
            self.faults.append(f"console: {message.text} {message.location.get('url', '')}")

    def unexpected(self) -> list[str]:
        """The faults that no pattern of ``allowed`` fits."""
        return [fault for fault in self.faults if not any(re.search(pattern, fault) for pattern in self.allowed)]

    def js(self, expression: str, argument: Any = None) -> Any:
        """The value of an expression or function in the page; promises are awaited."""
        return self.page.evaluate(expression, argument)

    def until(self, expression: str, timeout: float = 60.0, every: float = 0.05) -> Any:
        """The expression's value once it is true. AssertionError, with what the page says of itself, after seconds."""
        end = time.monotonic() + timeout
        while not (value := self.js(expression)):
            if time.monotonic() > end:
                raise AssertionError(f"not within {timeout:g} s: {expression}\n{self.state()}")
            self.wait(every)
        return value

    def meanwhile(self, true: Callable[[], object], timeout: float = 60.0) -> None:
        """Let the page go on until something else came true. AssertionError after seconds."""
        end = time.monotonic() + timeout
        while not true():
            assert time.monotonic() < end, f"not within {timeout:g} s\n{self.state()}"
            self.wait(0.05)

    def frames(self, count: int, or_: str = "false") -> None:
        """So many frames of the fake headset, or until that expression is true."""
        before = self.js("fakeXR.frames")
        self.until(f"fakeXR.frames >= {before + count} || {or_}")

    def wait(self, seconds: float) -> None:
        """Let the page go on; unlike time.sleep, its events are heard meanwhile."""
        self.page.wait_for_timeout(1e3 * seconds)

    def state(self) -> str:
        """What the page says of itself, for messages."""
        said = self.js("(document.querySelector('#status')?.textContent ?? '') + ' ' "
                       "+ JSON.stringify(window.glsplat?.stats?.() ?? null)")  # fmt: skip
        return f"{said} faults: {self.faults[-3:]}"

    def stats(self) -> dict[str, Any]:
        """window.glsplat.stats()."""
        return self.js("window.glsplat.stats()")

    def eye(self, side: str) -> NDArray[np.uint8]:
        """What the fake headset's "left" or "right" eye was shown last: [1024, 1024, 4], rows top-down."""
        return decoded(self.js("(side) => fakeXR.pixels(side)", side))

    def canvas(self) -> NDArray[np.uint8]:
        """The page's #canvas as it is on the screen: [H, W, 3], rows top-down, without what lies over it."""
        shot = self.page.locator("#canvas").screenshot(
            style="body > :not(:has(#canvas)):not(#canvas){visibility:hidden}"
        )
        import cv2  # here: tests of the harness alone do without

        return cv2.imdecode(np.frombuffer(shot, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]


def decoded(pixels: dict[str, Any]) -> NDArray[np.uint8]:
    """What readPixels() of js/pixels.js returned: [H, W, 4], rows top-down."""
    data = np.frombuffer(base64.b64decode(pixels["data"]), np.uint8)
    return data.reshape(pixels["height"], pixels["width"], 4)[::-1].copy()
