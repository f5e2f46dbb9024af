"""What a user does in VR besides looking: calibrating, recording, pressing the panel; and a device without a floor."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from glsplat.net.backend import AvatarInfo
from glsplat.tracking.recording import replay
from glsplat.tracking.sample import Sample, wrist_from_grip
from tests.browser.conftest import OpenPage
from tests.browser.markers import as_tracked, samples
from tests.browser.opened import Opened
from tests.browser.stored import StoredPairs
from tests.browser.vr import enter, hands, pose, steer, visit

SMALL = 256


class Told:
    """What clients told of their users: (height, span), and their requests."""

    def __init__(self) -> None:
        self.users: list[tuple[float | None, float | None]] = []
        self.backend = StoredPairs()

    def solver(self, height: float | None, span: float | None) -> Any:
        self.users.append((height, span))
        return as_tracked(height, span)

    def tracked(self, page: Opened, after: int = 0, timeout: float = 60.0) -> Sample:
        """The newest tracking among the requests from number ``after`` on; waits for one."""
        end = time.monotonic() + timeout
        while not (
            told := [job for job in self.backend.requests[after:] if job.pose is not None and job.frame_id in samples]
        ):
            assert time.monotonic() < end, f"no tracking within {timeout:g} s\n{page.state()}"
            page.wait(0.05)
        return samples[told[-1].frame_id or 0]


@pytest.fixture
def told() -> Told:
    return Told()


def inside(open_page: OpenPage, serve: Any, told: Told, device: dict[str, Any] | None = None, **values: Any) -> Opened:
    served = serve(told.backend, offered=(AvatarInfo(name="stored", solver=told.solver, height=1.75),))
    page = visit(open_page, served, {"view": "mirror"} | values, accept_downloads=True)
    around = hands(pose([-0.72, 1.45, 0]), pose([0.72, 1.45, 0]))  # arms stretched sideways
    steer(page, **({"head": pose([0, 1.65, 0]), "input": "hands", "hands": around, "side": SMALL} | (device or {})))
    enter(page)
    page.until("window.glsplat.stats().shown > 3")
    told.tracked(page)  # pictures from before the session count as shown, too
    return page


def test_calibrating_tells_the_server_who_one_is(open_page: OpenPage, serve: Any, told: Told) -> None:
    page = inside(open_page, serve, told)
    assert told.users[-1] == (None, None)
    page.page.click("#calibrate")
    page.until("localStorage.getItem('glsplat.calibration') !== null", 20)
    page.until("window.glsplat.stats().reconnects === 1 && window.glsplat.stats().state === 'open'")
    height, span = told.users[-1]
    assert height == pytest.approx(1.65 / 0.936, abs=0.005) and span == pytest.approx(1.44, abs=0.005)
    shown = page.stats()["shown"]
    page.until(f"window.glsplat.stats().shown > {shown + 3}")
    page.page.reload()  # it is kept
    page.until("window.glsplat.stats().shown > 0")
    assert told.users[-1] == (pytest.approx(height), pytest.approx(span))


def test_a_typed_height_finds_the_floor(open_page: OpenPage, serve: Any, told: Told) -> None:
    """The device thinks its floor 0.2 m too high; the user is 1.75 m tall."""
    eyes = 0.936 * 1.75 - 0.2
    page = inside(open_page, serve, told, {"head": pose([0, eyes, 0])}, height=1.75)
    page.page.click("#calibrate")
    page.until("localStorage.getItem('glsplat.calibration') !== null", 20)
    count = len(told.backend.requests)
    page.until("window.glsplat.stats().reconnects === 1 && window.glsplat.stats().state === 'open'")
    shown = page.stats()["shown"]
    page.until(f"window.glsplat.stats().shown > {shown + 5}")
    assert told.users[-1][0] == pytest.approx(1.75)
    tracking = told.tracked(page, after=count)
    assert tracking.head[1] == pytest.approx(0.936 * 1.75, abs=0.002)


def test_what_was_tracked_is_sent_and_recorded(open_page: OpenPage, serve: Any, told: Told, tmp_path: Path) -> None:
    """A body's places of the joints that drive the avatar, of a body that has more; without one there is no key."""
    body = {"hips": pose([0, 0.95, 0.02]), "left-foot-ball": pose([-0.1, 0.02, 0]), "chest": pose([0, 1.3, 0])}
    page = inside(open_page, serve, told, {"body": body})
    found = told.tracked(page).body
    assert found == {name: pytest.approx(body[name][:3], abs=2e-6) for name in ("hips", "left-foot-ball")}
    page.js("""() => { fakeXR.motion = (time, device) => { device.head[0] = 0.1 * Math.sin(time / 300); }; }""")
    page.page.click("#record")
    frames = page.js("fakeXR.frames")
    page.until(f"fakeXR.frames > {frames + 40}")
    with page.page.expect_download() as coming:
        page.page.click("#record")
    path = tmp_path / "recording.jsonl"
    coming.value.save_as(path)
    samples = list(replay(path))
    assert len(samples) >= 35
    times = np.array([sample.t for sample in samples])
    assert times[0] == 0 and (np.diff(times) > 0).all()
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    np.testing.assert_allclose(lines[0]["body"]["hips"], body["hips"], atol=2e-6)
    heads = np.array([line["head"] for line in lines])
    assert np.ptp(heads[:, 0]) > 0.02 and np.allclose(heads[:, 1], 1.65, atol=1e-5)
    assert all(len(np.ravel(line["left_joints"])) == 75 for line in lines)
    steer(page, body=None)
    count = len(told.backend.requests)
    page.until(f"window.glsplat.stats().shown > {page.stats()['shown'] + 3}")
    assert told.tracked(page, count).body is None


def test_the_panel_is_pressed_by_pointing(open_page: OpenPage, serve: Any, told: Told) -> None:
    page = inside(open_page, serve, told, {"input": "controllers", "controllers": {}})
    beside = np.array([0.85, 0, -1.2])  # the panel's middle is 0.3 m beside the glass, which is 1.1 m wide
    origin = np.array([0.2, 1.4, -0.1])
    left = False
    for height in np.arange(0.95, 1.6, 0.015):  # from below: leaving is the lowest row that does something
        x, y, z = beside + [0, height, 0] - origin
        aim = pose(origin, yaw=np.degrees(np.arctan2(-x, -z)), pitch=np.degrees(np.arctan2(y, np.hypot(x, z))))
        steer(page, controllers={"right": {"grip": aim, "ray": aim}})
        frames = page.js("fakeXR.frames")
        page.until(f"fakeXR.frames > {frames + 1}")
        page.js("fakeXR.press('right')")
        page.frames(5, or_="window.glsplat.stats().session === 'none'")
        left = page.stats()["session"] == "none"
        if left:
            break
        assert page.stats()["view"] == "mirror", "another row than the lowest was met first"
    assert left, "no row answered"
    page.until("fakeXR.session === null")


def test_a_device_without_a_floor_has_one_all_the_same(open_page: OpenPage, serve: Any, told: Told) -> None:
    device = {"features": ["viewer", "local", "hand-tracking"], "head": pose([0, 1.9, 0])}
    page = inside(open_page, serve, told, device)
    assert "local-floor" not in page.js("fakeXR.session.enabledFeatures")
    # where the head was at the beginning is taken for the eyes of somebody who stands
    assert told.tracked(page).head[1] == pytest.approx(1.6, abs=0.001)


def test_controllers_close_the_hands(open_page: OpenPage, serve: Any, told: Told) -> None:
    grip = pose([0.3, 1.1, -0.3], pitch=20)
    page = inside(open_page, serve, told, {"input": "controllers", "controllers": {"right": {"grip": grip}}})
    curls = []
    for pressed in ({}, {"squeeze": 0.5}, {"squeeze": 1, "trigger": 1}):
        steer(page, buttons={"left": {}, "right": pressed})
        page.frames(3)
        sent = page.stats()["sentId"]
        page.until(f"window.glsplat.stats().shownId > {sent}")
        count = len(told.backend.requests)
        tracking = told.tracked(page, after=count)
        assert tracking.left is None
        np.testing.assert_allclose(tracking.right, wrist_from_grip(tuple(grip), "right"), atol=4e-6)
        curls.append(tracking.right_curl)
    assert 0 <= curls[0] < curls[1] < curls[2] == pytest.approx(1)
