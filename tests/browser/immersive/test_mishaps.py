"""In VR: pictures are those of the poses sent, in three views, and every mishap ends well and is said in words."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from glsplat.net.guard.access import Access
from glsplat.net.server import ServerConfig
from tests.browser.conftest import OpenPage
from tests.browser.markers import offered, samples
from tests.browser.opened import Opened
from tests.browser.stored import StoredPairs
from tests.browser.vr import enter, hands, pose, steer, visit

SMALL = 256  # pixels of an eye: what is tested here is not in the pixels
LOST = ["WebSocket connection to", "net::ERR_CONNECTION", "Failed to load resource"]  # what Chromium itself says of it


@pytest.fixture
def stored(serve: Any) -> Any:
    return serve(StoredPairs(), offered=offered)


def inside(open_page: OpenPage, served: Any, mode: str = "vr", **options: Any) -> Opened:
    """In VR, with moving head and hands, pictures coming."""
    page = visit(open_page, served, options.pop("values", None), **options)
    steer(page, input="hands", hands=hands(pose([-0.3, 1, -0.3]), pose([0.3, 1.1, -0.3])), side=SMALL)
    page.js("""() => { fakeXR.motion = (time, device) => {
      const turn = 0.1 * Math.sin(time / 400);
      device.head = [0.05 * Math.sin(time / 700), 1.6, 0, 0, Math.sin(turn), 0, Math.cos(turn)];
      device.hands.right.joints.forEach((joint) => { joint[1] = 1.1 + 0.1 * Math.sin(time / 300); });
    }; }""")
    enter(page, mode)
    pictures(page)
    return page


def pictures(page: Opened, more: int = 3) -> None:
    """Wait for some more pictures to be shown."""
    shown = page.stats()["shown"]
    page.until(f"window.glsplat.stats().shown >= {shown + more}")


def test_every_picture_is_the_one_that_was_asked_for_and_mishaps_are_no_end(open_page: OpenPage, stored: Any) -> None:
    page = visit(open_page, stored)
    page.until("window.glsplat.stats().shown > 0")
    page.js("fakeXR.device.grants = false")  # a refused session leaves the page as it was
    page.page.click("#enter-vr")
    page.until("/annot enter VR/.test(document.querySelector('#status').textContent)")
    page.page.close()
    page = inside(open_page, stored)
    # after each XR frame: the id that the page says it shows, and the ones that its textures hold
    page.js("""() => {
      window.matches = [];
      let seen = watch.count;
      const step = fakeXR.step;
      fakeXR.step = function spied(...args) {
        const went = step.apply(this, args);
        if (watch.count !== seen) {
          seen = watch.count;
          const stamps = watch.uploads.filter(({id}) => id !== null);
          const held = [0, 1].map((eye) => stamps.findLast((upload) => upload.eye === eye)?.id);
          matches.push([window.glsplat.stats().shownId, ...held]);
        }
        return went;
      };
    }""")
    pictures(page, 20)
    matches = page.js("matches")
    assert len(matches) >= 15 and all(told == left == right for told, left, right in matches), matches
    assert [told for told, *_ in matches] == sorted(told for told, *_ in matches)
    page.js("fakeXR.visibility('visible-blurred')")  # the system's menu: no hands, but frames
    page.frames(4)
    page.js("fakeXR.visibility('hidden')")  # the headset rests, and goes on
    page.meanwhile(lambda: all(one["under_way"] + one["waiting"] == 0 for one in stored.stats()["clients"]))
    sent = page.stats()["sentId"]
    page.wait(0.3)
    assert page.stats()["sentId"] <= sent + 1
    page.js("fakeXR.visibility('visible')")
    pictures(page)
    page.js("() => { fakeXR.motion = null; }")
    for lost in ({"hands": {"left": None, "right": None}}, {"hands": {}}, {"head": None}):
        steer(page, **lost)
        page.frames(4)
    steer(page, head=pose([0, 1.6, 0]), input="controllers", controllers={"right": {"grip": pose([0.3, 1, -0.3])}})
    pictures(page)
    page.js("fakeXR.session.end()")  # by the headset's own button, and in again
    page.until("window.glsplat.stats().session === 'none'")
    pictures(page)
    enter(page)
    pictures(page)
    assert page.stats()["reconnects"] == 0 and page.js("fakeXR.sessions") == 2


def test_what_is_sent_is_what_the_device_says(open_page: OpenPage, serve: Any) -> None:
    backend = StoredPairs()
    page = inside(open_page, serve(backend, offered=offered), values={"view": "own"})
    page.js("() => { fakeXR.motion = null; fakeXR.stop(); }")
    head = pose([0.12, 1.58, -0.07], yaw=15, pitch=-20)
    left, right = pose([-0.25, 1.2, -0.4], yaw=5), pose([0.2, 1.3, -0.35], pitch=30)
    steer(page, head=head, hands=hands(left, right))
    count = len(backend.requests)
    page.until(f"(() => {{ fakeXR.step(); return window.glsplat.stats().shown > {count + 1}; }})()")
    request = backend.requests[-1]
    sample = samples[request.frame_id or 0]
    np.testing.assert_allclose(sample.head, head, atol=2e-6)
    np.testing.assert_allclose(sample.left, left, atol=2e-6)
    np.testing.assert_allclose(sample.right, right, atol=2e-6)
    joints = np.reshape(sample.left_joints, (25, -1))[:, :3]
    np.testing.assert_allclose(joints, [j[:3] for j in hands(left, None)["left"]["joints"]], atol=2e-6)
    assert request.options.hide == ("head",)
    apart = [camera.position for camera in request.cameras]
    assert np.linalg.norm(apart[1] - apart[0]) == pytest.approx(0.063, abs=1e-5)
    for name, camera in zip(("left", "right"), request.cameras, strict=True):
        eye = np.reshape(page.js(f"fakeXR.last.eyes.{name}.matrix"), (4, 4)).T
        np.testing.assert_allclose(camera.position, eye[:3, 3], atol=1e-5)
        # asked for is what the eye can see, and a margin
        K, width, height = camera.K, camera.width, camera.height
        across = np.degrees(np.arctan([K[0, 2] / K[0, 0], (width - K[0, 2]) / K[0, 0]]))
        upright = np.degrees(np.arctan([K[1, 2] / K[1, 1], (height - K[1, 2]) / K[1, 1]]))
        most = {"left": (54, 40), "right": (40, 54)}[name]
        assert (across <= np.add(most, 22)).all() and (upright <= np.add((44, 53), 22)).all()


def test_a_server_that_comes_back_is_found_again(open_page: OpenPage, stored: Any) -> None:
    page = inside(open_page, stored, allow=LOST)
    stored.stop()
    page.until("window.glsplat.stats().state !== 'open'")
    page.until("/trying again/.test(document.querySelector('#status').textContent)")
    frames = page.js("fakeXR.frames")
    page.until(f"fakeXR.frames > {frames + 5}")  # the headset goes on meanwhile
    stored.start()
    page.until("window.glsplat.stats().state === 'open'", 30)
    pictures(page)
    assert page.stats()["reconnects"] == 1 and page.stats()["session"] == "vr"


def test_a_full_server_is_said_and_waited_for(open_page: OpenPage, serve: Any) -> None:
    served = serve(StoredPairs(), ServerConfig(port=0, max_clients=1), offered=offered)
    first = visit(open_page, served)
    first.until("window.glsplat.stats().shown > 0")
    second = visit(open_page, served, allow=LOST)
    second.until("/full/.test(document.querySelector('#status').textContent)")
    enter(second)  # also in VR
    assert second.stats()["problem"] == "full"
    first.page.close()
    second.until("window.glsplat.stats().shown > 0", 30)
    assert second.stats()["problem"] == ""


def test_a_token_is_asked_for_until_it_is_right(open_page: OpenPage, serve: Any) -> None:
    served = serve(StoredPairs(), ServerConfig(port=0, access=Access(token="s3cret")), offered=offered)
    page = visit(open_page, served, allow=LOST)
    page.until("!document.querySelector('#token-form').hidden")
    page.page.fill("#token", "wrong")
    page.page.keyboard.press("Enter")
    page.until("/Wrong/.test(document.querySelector('#token-why').textContent)")
    page.until("!document.querySelector('#token-form').hidden")
    page.page.fill("#token", "s3cret")
    page.page.keyboard.press("Enter")
    page.until("window.glsplat.stats().shown > 0")
    page.page.reload()  # this tab knows it from now on
    page.until("window.glsplat.stats().shown > 0")
    assert page.js("document.querySelector('#token-form').hidden")
    linked = visit(open_page, served, address=f"{served.page}#token=s3cret")
    linked.until("window.glsplat.stats().shown > 0")
    assert "s3cret" not in linked.page.url + linked.js("JSON.stringify(localStorage)")
    asked = [address.partition("#")[0] for address in (*page.requests, *linked.requests)]
    assert not [address for address in asked if "s3cret" in address]


def test_a_button_and_two_pinches_change_the_view(open_page: OpenPage, stored: Any) -> None:
    page = inside(open_page, stored, values={"view": "mirror"})
    page.js("() => { fakeXR.motion = null; }")
    aside = pose([-0.4, 1.2, -0.2], yaw=120)  # points at nothing
    steer(page, hands=hands(aside, None))
    page.js("() => { fakeXR.press('left'); fakeXR.press('left'); }")
    page.until("window.glsplat.stats().view === 'facing'")
    steer(page, input="controllers", controllers={"right": {"grip": pose([0.3, 1, -0.3], yaw=-120)}})
    frames = page.js("fakeXR.frames")
    page.until(f"fakeXR.frames > {frames + 2}")
    steer(page, buttons={"left": {}, "right": {"a": 1}})
    page.until("window.glsplat.stats().view === 'own'")
    page.frames(10)
    assert page.stats()["view"] == "own", "a held button counts once"
    steer(page, buttons={"left": {}, "right": {}})
    pictures(page)
