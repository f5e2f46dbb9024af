"""A scripted participant: does on the study's page what the page asks, in VR by a ray or on the flat page by clicks."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from glsplat.extras.study.design import read_study
from glsplat.extras.study.plan import checked_plan, steps_of
from tests.browser.opened import Opened
from tests.browser.vr import enter, hands, pose, steer

__all__ = ["STUDY", "Scripted", "Service", "wire"]

ROOT = Path(__file__).resolve().parents[3]
HAND = np.array([0.2, 1.3, -0.1])  # where the ray begins

STUDY = """
name = "scripted"
title = "Scripted"
participants = {participants}
seed = 11
consent = "You are a script. You agree."

[factors]
type = ["self", "other"]
method = ["ours", "video", "image"]

[order]
block = "type"
{conditions}
[[task]]
name = "wave"
text = "Wave with your right arm."
seconds = {seconds}
countdown = 1

[questionnaires]
each = ["asked.toml"]
after = ["nasa-tlx"]
"""
CONDITION = """
[[condition]]
name = "{type}-{method}"
type = "{type}"
method = "{method}"
latency = {latency}
hands = {hands}
view = "{view}"
"""
ASKED = """
name = "asked"
title = "How it was"
[[item]]
name = "owned"
text = "It was mine."
[[item]]
name = "strange"
text = "It was strange."
reversed = true
[[item]]
name = "liked"
text = "I liked it."
scale = {kind = "slider", from = 0, to = 100, step = 5, labels = ["no", "yes"]}
[[score]]
name = "ownership"
items = ["owned", "strange"]
[[score]]
name = "liking"
items = ["liked"]
"""


CELLS = tuple((type, method) for type in ("self", "other") for method in ("ours", "video", "image"))


def wire(
    folder: Path,
    participants: int = 3,
    seconds: float = 1.0,
    cells: tuple[tuple[str, str], ...] = CELLS,
    views: tuple[str, str, str] = ("mirror", "mirror", "facing"),
) -> Path:
    """The design that scripts go through, its methods' ``views`` in their order; returns its file."""
    conditions = "".join(
        CONDITION.format(
            type=type,
            method=method,
            latency=100 if method == "video" else 0,
            hands="false" if method == "image" else "true",
            view=dict(zip(("ours", "video", "image"), views, strict=True))[method],
        )
        for type, method in cells
    )
    (folder / "asked.toml").write_text(ASKED)
    path = folder / "study.toml"
    fields = {"participants": participants, "seconds": seconds, "conditions": conditions}
    path.write_text(STUDY.format(**fields))
    return path


@dataclass
class Service:
    """The server of one participant (tests.extras.study.served), which may be killed and restarted on its port."""

    study: Path
    participant: int
    port: int = 0
    links: dict[str, str] | None = None
    process: subprocess.Popen[str] | None = None
    data: Path | None = None  # beside the study

    def __post_init__(self) -> None:
        self.data = self.data or self.study.parent / "data"

    def names(self) -> dict[str, str]:
        """The steps' names in the log, by what the page calls them."""
        assert self.data is not None
        study = read_study(self.study)
        return {step.alias: step.name for step in steps_of(study, checked_plan(self.data, study), self.participant)}

    def start(self) -> None:
        options = map(str, (self.study, self.data, self.participant, self.port))
        words = [sys.executable, "-m", "tests.extras.study.served", *options]
        self.process = subprocess.Popen(words, cwd=ROOT, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        assert line, "the server did not start"
        found = json.loads(line)
        self.port = found["port"]
        if self.links is None:
            pages = {"participant": "study", "experimenter": "watch"}
            origin = f"http://localhost:{self.port}/vr"
            self.links = {who: f"{origin}/{pages[who]}.html?size=256#study={found[who]}" for who in pages}

    def kill(self) -> None:
        """As a power cut does to a process."""
        self._end(signal.SIGKILL)

    def stop(self) -> None:
        self._end(signal.SIGTERM)

    def _end(self, number: int) -> None:
        if self.process is not None:
            self.process.send_signal(number)
            self.process.wait(30)
            assert self.process.stdout is not None
            self.process.stdout.close()
            self.process = None


class Scripted:
    """Goes through the session. ``answer(step, item)`` is what they think; ``hook(state)`` hears of each new state."""

    def __init__(
        self,
        page: Opened,
        answer: Callable[[str, dict[str, Any]], Any],
        vr: bool = True,
        hook: Callable[[dict[str, Any]], bool] = lambda state: False,
        pinch: bool = False,
    ) -> None:
        self.page, self.answer, self.vr, self.hook, self.pinch = page, answer, vr, hook, pinch
        self.pressed: list[str] = []

    def enter(self) -> None:
        """Put the headset on."""
        self.page.until("window.glsplat?.study?.().state")
        if self.vr:
            steer(self.page, head=pose([0, 1.65, 0]), side=64, input="hands" if self.pinch else "controllers")
            self._aim(pose(HAND))
            enter(self.page)

    def _aim(self, ray: list[float]) -> None:
        """The right hand, or what it holds, points that way."""
        if self.pinch:
            right = hands(None, pose(HAND))["right"] | {"ray": ray}
            steer(self.page, hands={"left": None, "right": right})
        else:
            steer(self.page, controllers={"right": {"grip": ray, "ray": ray}})

    def study(self) -> dict[str, Any]:
        return self.page.js("window.glsplat.study()")

    def run(self, timeout: float = 120.0) -> bool:
        """Until the end (True), or until ``hook`` says to stop (False)."""
        end = time.monotonic() + timeout
        while True:
            now = self.study()
            state = now["state"]
            assert time.monotonic() < end, f"stuck at {state} {now['complaint']}"
            if state is not None and self.hook(now):
                return False
            if state is not None and state["ended"]:
                return True
            if state is None or not self._act(now, state):
                self.page.wait(0.05)

    def _act(self, now: dict[str, Any], state: dict[str, Any]) -> bool:
        if state["paused"] or now["complaint"]:
            return False
        if state["kind"] == "consent":
            return self.press("agree")
        if state["kind"] == "task":
            return state["phase"] == "instruction" and self.press("ready")
        if state["kind"] != "questionnaire" or now["item"] is None:
            return False
        item = next(one for one in state["items"] if one["name"] == now["item"])
        value = self.answer(state["step"], item)
        at = (state["step"], item["name"])
        pressed = self.press(f"value:{value:g}")
        last = item is state["items"][-1]
        if pressed and (last or not self.vr or item["kind"] == "slider"):
            self.press("next")
        end = time.monotonic() + 3  # a ray may have met what was not there any more: it is tried again
        while time.monotonic() < end:
            later = self.study()
            if later["state"]["ended"] or (later["state"]["step"], later["item"]) != at or later["complaint"]:
                break
            self.page.wait(0.03)
        return True

    def press(self, what: str) -> bool:
        """Press what is there, if it is; in VR by pointing at it."""
        self.pressed.append(what)
        return self._point(what) if self.vr else self._click(what)

    def _point(self, what: str) -> bool:
        place = self.page.js("(id) => window.glsplat.cell(id)", what)
        if place is None:
            return False
        x, y, z = np.array(place) - HAND
        aim = pose(HAND, yaw=np.degrees(np.arctan2(-x, -z)), pitch=np.degrees(np.arctan2(y, np.hypot(x, z))))
        self._aim(aim)
        self.page.frames(1)
        self.page.js("fakeXR.press('right')")
        self.page.frames(1)
        return True

    def _click(self, what: str) -> bool:
        """By the page's own click: what a script waited for may be replaced before a pointer gets there."""
        value = what.removeprefix("value:")
        return bool(self.page.js(
            """([what, value]) => {
              const slider = document.getElementById('answer');
              if (what !== value && slider) {
                slider.value = value;
                slider.dispatchEvent(new Event('change'));
                return true;
              }
              const one = what === value ? document.getElementById(what)
                : document.querySelector(`input[name=answer][value="${value}"]`);
              if (!one || one.disabled) return false;
              one.click();
              return true;
            }""",
            [what, value],
        ))  # fmt: skip
