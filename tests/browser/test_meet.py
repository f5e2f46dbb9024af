"""People who meet in a room from the page: sharp, face to face, named, and in VR without a headset."""

from __future__ import annotations

import json
import time
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from glsplat.extras.rooms.feature import Rooms
from glsplat.net.backend import AvatarInfo, RenderJob
from glsplat.net.server import ServerConfig
from tests.browser.conftest import OpenPage
from tests.browser.flat_page import flat_page
from tests.browser.markers import Markers, as_tracked, samples
from tests.browser.opened import Opened
from tests.browser.test_rooms import OFFERED, RIG, people
from tests.browser.vr import visit

CONFIG = ServerConfig(port=0, rooms={"lab": 4})
SIZE = (1100, 700)
SHORT = 0.3  # seconds of a pinch that makes no step; a busy machine takes longer for one of 0.1
TWO = (*OFFERED, AvatarInfo(name="bob", skeleton=RIG, solver=as_tracked, height=1.75, parts=frozenset({"head"})))
MODULES = """import { Names } from './show/names.js'; import { Steps } from './track/steps.js';
import { panelPlace } from './show/reach.js'; import { Framing } from './space/framing.js';
import { Place } from './place/place.js'; import * as matrix from './space/matrix.js';
Object.assign(window, { Names, Steps, panelPlace, Framing, Place, ...matrix });"""


def seen(job: RenderJob) -> dict[str, Any]:
    """Of a room: the viewer in red in the mirror, others in green before it, and lower."""
    people = [] if job.room is None else [one for one in job.room.people if one.pose is not None]
    wanted = mirrored(job)
    up = (0, 1.75 if wanted else 1.3, 0)
    at = {one.key == job.room.viewer: one.transform @ (*one.pose.trans + up, 1) for one in people}
    return {"red" if wanted else "green": at[wanted][:3]} if wanted in at else {}


@pytest.fixture
def served(serve: Any) -> Any:
    return serve(Markers(seen, radius=0.1), config=CONFIG, offered=TWO)


def jobs(served: Any, viewer: int | None = None) -> list[RenderJob]:
    """The pictures asked for so far, of one person of the room or of who is alone."""
    found = served.server.drawer.worker._backend.requests
    return [one for one in found if (None if one.room is None else one.room.viewer) == viewer]


def enter_emulated(open_page: OpenPage, served: Any, query: str, **values: Any) -> Opened:
    page = visit(open_page, served, {"drawer": False} | values, address=served.page + query, xr=False, size=SIZE)
    page.until("window.glsplat?.stats().shown > 0")
    page.page.click("#try-vr")
    page.until("window.glsplat.stats().session === 'vr'")
    return page


def sockets(page: Opened) -> list[str]:
    return [address for address in page.requests if address.startswith("ws")]


def look_left(page: Opened, radians: float = np.pi / 2) -> None:
    """Turn the emulated head."""
    page.page.mouse.move(200, 200)
    page.page.mouse.down()
    page.page.mouse.move(200 + round(radians / 0.004), 200, steps=8)
    page.page.mouse.up()


def density(job: RenderJob) -> float:
    """Pixels a unit of tangent of the eye that has fewest, across and up alike."""
    return min(float(np.sqrt(camera.K[0, 0] * camera.K[1, 1])) for camera in job.cameras)


def mirrored(job: RenderJob) -> bool:
    return float(np.linalg.det(job.cameras[0].viewmat[:3, :3])) < 0


def on_show(page: Opened) -> tuple[bool, bool]:
    """Whether the user is to be seen in the mirror, and others before it."""
    picture = cv2.imdecode(np.frombuffer(page.page.screenshot(), np.uint8), cv2.IMREAD_COLOR)
    _, g, r = picture.astype(int).reshape(-1, 3).T
    return bool((r > 100 + g).any()), bool((g > 100 + r).any())


def test_a_room_is_as_sharp_as_the_same_view_alone(open_page: OpenPage, served: Any) -> None:
    """In the mirror and in the own view, for both emulated eyes, whoever else is there.

    With the mirror beside the others both are shown, in pictures that take turns, whichever is straight ahead.
    """
    alone = enter_emulated(open_page, served, "")
    alone.meanwhile(lambda: any(map(mirrored, jobs(served))))
    wanted = density(list(filter(mirrored, jobs(served)))[-1])
    alone.page.close()
    other = visit(open_page, served, address=f"{served.page}?room=lab&name=Bob")
    other.until("window.glsplat.stats().shown > 0")
    page = enter_emulated(open_page, served, "?room=lab&name=Ann")

    def met(mirror: bool) -> list[RenderJob]:
        # the third connection: in VR the page connects anew, with the height
        all_ = [one for one in jobs(served, 3) if one.room is not None and len(one.room.people) == 2]
        return [one for one in all_ if mirrored(one) == mirror]

    def sharp(mirror: bool) -> bool:  # the first pictures are asked for before the others' places are known
        return any(density(one) >= 0.98 * wanted and len(one.cameras) == 2 for one in met(mirror)[-1:])

    page.meanwhile(lambda: sharp(mirror=False))
    # it is not in sight: once the head has turned to the others no picture is of it, where every third would be
    page.meanwhile(lambda: len(last := jobs(served, 3)[-6:]) == 6 and not any(map(mirrored, last)))
    look_left(page)
    page.meanwhile(lambda: sharp(mirror=True))
    page.page.keyboard.press("v")  # one eye sees 57 degrees to both sides
    look_left(page, np.radians(-40))
    page.meanwhile(lambda: on_show(page) == (True, True))
    other.page.focus("#canvas")
    for _ in range(4):
        other.page.keyboard.press("d")
    look_left(page, np.radians(25))
    drawn = len(met(mirror=False))
    page.meanwhile(lambda: len(met(mirror=False)) > drawn + 5)
    page.meanwhile(lambda: on_show(page) == (True, True))


def test_all_guests_stand_in_one_place(open_page: OpenPage, served: Any) -> None:
    """Who stands opposite sees the wall behind the other, and light falls on both from one side."""
    lit = {"place": "day", "drawer": False}
    ann, bob = (visit(open_page, served, lit, address=f"{served.page}?room=lab&name={who}") for who in ("Ann", "Bob"))

    def lights() -> list[NDArray[np.float64]]:
        """The light that each asked for last, in the room: from the left, the right, behind and before."""
        asked = [one.options.light for viewer in (1, 2) for one in jobs(served, viewer)[-1:]]
        return [
            one.irradiance(np.array([[-1, 0, 0], [1, 0, 0], [0, 0, -1], [0, 0, 1]])) for one in asked if one is not None
        ]

    bob.meanwhile(lambda: len(found := lights()) == 2 and np.allclose(*found, atol=1e-3))
    assert np.ptp(lights()[0], axis=0).max() > 0.1

    def walls() -> list[NDArray[np.float64]]:
        """What each page shows above the heads."""
        seen = [np.frombuffer(page.page.screenshot(), np.uint8) for page in (ann, bob)]
        return [cv2.imdecode(picture, cv2.IMREAD_COLOR)[80:160].astype(float) for picture in seen]

    bob.meanwhile(lambda: np.abs(np.subtract(*walls())).mean() > 5)  # a page shows its place some time after it asked


SLOW = """() => { const { postMessage } = Worker.prototype; Worker.prototype.postMessage = function (message, ...rest) {
  setTimeout(() => postMessage.call(this, message, ...rest), 'skip' in message ? 500 : 0); }; }"""


def test_a_mirror_hangs_ahead_until_others_come(open_page: OpenPage, served: Any) -> None:
    page = enter_emulated(open_page, served, "?room=lab&name=Ann")

    def looks_at_herself() -> bool:
        return mirrored(jobs(served, 2)[-1])  # the second connection: in VR the page connects anew

    page.meanwhile(lambda: jobs(served, 2) and looks_at_herself())
    page.meanwhile(lambda: on_show(page) == (True, False))
    page.js(SLOW)  # one of these pictures is being decoded when others come
    other = visit(open_page, served, address=f"{served.page}?room=lab&name=Bob")
    other.until("window.glsplat.stats().shown > 0")
    page.meanwhile(lambda: not looks_at_herself())
    page.meanwhile(lambda: on_show(page)[1])
    assert on_show(page) == (False, True)


def test_vr_without_a_headset_faces_the_middle_with_arms_down(open_page: OpenPage, served: Any) -> None:
    """It shows its keys, walks and raises its hands by them, and a click presses the panel."""
    page = enter_emulated(open_page, served, "?room=lab&name=Ann")

    def sent() -> Any:
        return samples[max(samples)] if samples else None

    page.meanwhile(lambda: sent() is not None and sent().left is not None)
    first = sent()
    x, y, z, w = np.abs(first.head[3:])
    assert y > 0.99 and max(x, z, w) < 0.05  # half a turn: to +z, where the middle of the room is
    assert first.left[1] < 1.0 and first.right[1] < 1.0 and first.left[0] > 0 > first.right[0]
    # upright: the server fits the avatar to this height; longer arms would be those of a taller person who bends
    assert first.head[1] == pytest.approx(0.936 * 1.71, abs=0.01) and "height=1.71" in sockets(page)[-1]
    hang = [np.linalg.norm(np.subtract(hand[:3], first.head[:3])) for hand in (first.left, first.right)]
    assert max(hang) < 0.53 * first.head[1]
    assert page.page.is_visible("#emulated-keys")
    page.page.keyboard.press("w")
    page.meanwhile(lambda: sent().head[2] == pytest.approx(0.4, abs=0.02))
    page.page.keyboard.press("h")
    page.meanwhile(lambda: sent().left is not None and sent().left[1] > 1.1)
    look_left(page)  # the hands follow
    page.meanwhile(lambda: sent().left[0] > 0.3)
    page.page.keyboard.press("Escape")
    page.until("window.glsplat.stats().session === 'none'")
    alone = enter_emulated(open_page, served, "")
    for y in range(520, 330, -8):  # the panel beside the mirror, from its last row up: "Leave" ends the session
        alone.page.mouse.click(490, y)
        alone.wait(0.3)
        if alone.stats()["session"] == "none":
            break
    assert alone.stats()["session"] == "none"


def test_a_pinch_that_is_held_steps_to_the_floor_but_not_into_another(open_page: OpenPage, served: Any) -> None:
    other = visit(open_page, served, address=f"{served.page}?room=lab&name=Bob")
    other.until("window.glsplat.stats().shown > 0")
    page = enter_emulated(open_page, served, "?room=lab&name=Ann")

    def head() -> Any:
        return np.array(samples[max(number for number, one in list(samples.items()) if one.left is not None)].head[:3])

    def pinch(seconds: float) -> tuple[Any, float]:
        """Return where the head was before, and the seconds that the pinch took at most."""
        page.page.keyboard.press("h")  # the level hand points at the floor 2 m before it
        page.meanwhile(lambda: samples[max(samples)].left[1] > 1.1)
        before, started = head(), time.monotonic()
        page.page.keyboard.down("t")
        page.wait(seconds)
        page.page.keyboard.up("t")
        held = time.monotonic() - started
        page.wait(1.0)
        page.page.keyboard.press("h")
        return before, held

    page.meanwhile(lambda: any(one.left is not None for one in list(samples.values())))
    page.meanwhile(lambda: any(len(one.room.people) == 2 for one in jobs(served, 3) if one.room))
    before, _ = pinch(2.0)
    assert np.abs(head() - before).max() < 0.02  # there is Bob
    look_left(page)
    before, held = pinch(0.1)
    if held < SHORT:
        assert np.abs(head() - before).max() < 0.02  # too short
    if head()[0] - before[0] < 1:  # a busy page may have met both ends of a long pinch at once
        before, _ = pinch(2.0)
    page.meanwhile(lambda: head()[0] - before[0] > 1.5)
    by = head() - before
    assert by[0] < 3.5 and np.abs(by[1:]).max() < 0.6


def company(text: str) -> str:
    return f"document.querySelector('#company')?.textContent === {json.dumps(text)}"


def test_an_address_brings_people_together_who_see_whom_they_meet(open_page: OpenPage, served: Any) -> None:
    """Whatever is stored; who chose nobody wears what nobody wears, and the page says so."""
    first = visit(open_page, served, {"room": "", "name": "Carl"}, address=f"{served.page}?room=lab&name=Dee")
    first.until("document.querySelector('#company').textContent === 'You are Dee, as ann. Nobody else is here yet.'")
    second = visit(open_page, served, address=f"{served.page}?room=lab&name=Eve")
    second.until(company("You are Eve, as bob. Here: Dee."))
    first.until(company("You are Dee, as ann. Here: Eve."))
    assert second.page.input_value("#avatar") == "bob"
    assert first.page.inner_text("#who") == "Room lab"
    assert second.page.get_attribute("#people-1", "aria-pressed") == "true"
    seats = served.server.feature(Rooms)._rooms["lab"]._guests
    ahead = [guest.person.seat[:3, 2] for guest in seats.values()]
    assert ahead[0] @ ahead[1] == pytest.approx(-1)  # face to face
    second.page.click("#invite")
    second.until("document.querySelector('#code-address').textContent.endsWith('/vr?room=lab')")
    words = second.page.inner_text("#code-words")
    assert "only on this computer" in words and "--host" in words
    assert not second.js("document.querySelector('#code img')")


ELSEWHERE = "document.querySelector('#status')?.textContent === 'You are in this room in another tab.'"


def test_a_second_tab_says_so_and_takes_over(open_page: OpenPage, served: Any) -> None:
    """It continues as the same person in the same place."""
    address = f"{served.page}?room=lab&name=Ann"
    first = visit(open_page, served, address=address)
    first.until("window.glsplat.stats().shown > 0")
    room = served.server.feature(Rooms)._rooms["lab"]

    def ann() -> tuple[Any, ...]:
        person = room._guests["Ann"].person
        return person.resume, person.avatar, person.seat.tobytes()

    def stands_at(z: float) -> bool:
        return abs(room._guests["Ann"].person.newest.pose.trans[2] - z) < 0.02

    before = ann()
    first.page.focus("#canvas")
    first.page.keyboard.press("w")
    first.page.keyboard.press("w")
    first.meanwhile(lambda: stands_at(0.8))
    second = Opened(first.page.context.new_page(), ["Unexpected response code: 409"])
    second.page.goto(address)
    second.until(
        "window.glsplat && document.querySelector('#status').textContent === 'You are in this room in another tab.'"
    )
    assert second.page.inner_text("#again") == "Continue here"
    second.page.click("#again")
    second.until("window.glsplat.stats().state === 'open'")
    first.until(ELSEWHERE)
    second.meanwhile(lambda: stands_at(0.8))
    assert people(served) == ["Ann"] and ann() == before and not second.unexpected()
    assert first.stats()["state"] == "off"


NAMES = """(people, glass = null, flat = false, height = 512) => {
  const painter = { texture: () => ({}), fill() {} };
  const projection = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0];
  const eye = { transform: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 1.6, 0, 1], projection, viewport: { height } };
  const label = (name) => `driven by ${name}, synthetic`;
  const all = people.map(([name, x, z], key) => ({ key, name, label: label(name), head: [x, 1.5, z], glass }));
  return new window.Names().labels(all, eye, painter, flat)
    .map(({ transform: m, width, height: high }) => [m[12], m[13] - 1.6, m[14], width, high]);
}"""


def test_names_keep_their_size_and_cover_nobody(chromium: Any) -> None:
    with flat_page(chromium, MODULES) as page:
        near, far = page.evaluate(NAMES, [["Ann", 0, -1.5], ["Bob", 3, -6]])
        tall = [one[4] / np.hypot(one[0], one[2]) for one in (near, far)]
        assert tall[0] == pytest.approx(tall[1]) and tall[0] * 512 / 2 >= 30  # pixels of 512 that 90 degrees have
        for x, up, z, _, high in (near, far):
            assert up - high / 2 >= -0.1 + 0.2 and np.hypot(x, z) < 10  # over the head
        assert page.evaluate(NAMES, [["Ann", 0, -10.5]]) == []
        # behind another: over both, and not over the other's name
        first, second = page.evaluate(NAMES, [["Ann", 0, -1.5], ["Bob", 0, -5]])
        lower, upper = ([(up + sign * high / 2) / -z for sign in (-1, 1)] for _, up, z, _, high in (first, second))
        assert upper[0] >= lower[1] > lower[0] >= (1.5 + 0.2 - 1.6) / 1.5
        # in a mirror once, and only through its glass
        glass = [[-0.5, 0, -1], [0.5, 0, -1], [0.5, 2, -1], [-0.5, 2, -1]]
        seen = page.evaluate(f"({NAMES})([['Ann', 0, -3], ['Bob', 3, -3], ['Eve', 0, -0.5]], {glass})")
        assert len(seen) == 1 and seen[0][2] == -3
        # on a screen of one height and over the head, also at the side of a wide picture
        flat = page.evaluate(f"({NAMES})([['Ann', 0, -1.5], ['Bob', 3, -2]], null, true)")
        assert [(x, z) for x, _, z, _, _ in flat] == [pytest.approx((0, -1.5)), pytest.approx((3, -2))]
        for _, up, z, _, high in flat:
            assert high / -z == pytest.approx(tall[0]) and up - high / 2 == pytest.approx(-0.1 + 0.24)


PANEL = """(others) => {
  const sample = { left: [0.2, 1.4, -0.5, 0, 0, 0, 1] };
  const heads = others.map(([x, z]) => [x, 1.5, z]);
  const { transform: m, width } = window.panelPlace({}, window.translation([0, 1.6, 0]), sample, heads);
  return [-1, 1].map((side) => Math.atan2(m[12] + (side * m[0] * width) / 2, -m[14] - (side * m[2] * width) / 2));
}"""


def test_the_panel_at_the_hand_covers_nobody(chromium: Any) -> None:
    """It moves aside to the left, not out of sight. Level angles of its edges, radians to the right of -z."""
    with flat_page(chromium, MODULES) as page:
        low, high = page.evaluate(PANEL, [])
        assert low < 0 < high
        assert page.evaluate(PANEL, [(0, 2.4), (1.2, -1.2)]) == pytest.approx([low, high])
        for others in ([(0, -2.4)], [(0, -2.4), (1.2, -1.2)], [(0, -2.4), (-1.2, -1.2), (1.2, -1.2)]):
            low, high = page.evaluate(PANEL, others)
            assert -1 < low < high < -np.arctan2(0.3, 2.4)
        crowd = [(2 * np.sin(a), -2 * np.cos(a)) for a in np.linspace(-1.5, 0.5, 8)]
        assert -1 < np.mean(page.evaluate(PANEL, crowd)) < 0


ASKED = """([pitch, left]) => {
  const framing = new window.Framing();
  framing.learn(null, { head: null }, [{ at: [0, 0, 0], you: true }, { at: [0, 0, -2.4], you: false }]);
  const head = [0, 1.6, 0, Math.sin(pitch / 2), 0, 0, Math.cos(pitch / 2)];
  const view = { transform: window.fromPose(head), projection: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, -1, -1, 0, 0, -0.1, 0] };
  const where = { view: 'own', shown: window.IDENTITY, whole: true };
  const { frustum: f } = framing.frame([view], where, { head, left }, 512, 0.05, 1000).cameras[0];
  return [f.left, f.right, f.down, f.up];
}"""


def test_pixels_go_to_what_the_eye_sees_of_people(chromium: Any) -> None:
    """Not to one's own body while it is out of sight; all of it is drawn for who looks down or raises a hand."""
    hangs, raised = [-0.23, 0.97, 0, 0, 0, 0, 1], [-0.2, 1.4, -0.4, 0, 0, 0, 1]
    with flat_page(chromium, MODULES) as page:  # its eye sees 45 degrees to all sides: tangents
        left, right, down, up = page.evaluate(ASKED, [0, hangs])
        assert 0.4 < right == -left < 0.7 and 0.2 < up < 0.5 and down < -0.8
        for pitch, hand in ((0, raised), (-1.0, hangs)):
            left, right, down, up = page.evaluate(ASKED, [pitch, hand])
            assert left < -1 and right > 1 and down < -1 and up > -0.1


MIRROR = """() => {
  const { Place, invert, multiply, translation, turnY } = window;
  const gl = new OffscreenCanvas(128, 128).getContext('webgl2', { antialias: false });
  gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
  const place = new Place(gl);
  place.choose('day');
  const projection = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, -1.002, -1, 0, 0, -0.1, 0];
  const pixels = (side, draw) => {
    const transform = multiply(translation([1 + 1.5 * side, 1.6, 0]), turnY((side * Math.PI) / 2));
    gl.clearColor(0, 0, 1, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    draw({ transform, projection }, new Float32Array(multiply(projection, invert(transform))));
    const out = new Uint8Array(4 * 128 * 128);
    gl.readPixels(0, 0, 128, 128, gl.RGBA, gl.UNSIGNED_BYTE, out);
    return [...out];
  };
  const glass = [[1, 1, -1], [1, 1, 1], [1, 2.2, 1], [1, 2.2, -1]]; // towards the windows of the wall at -x
  return [
    pixels(-1, (eye, clip) => place.mirror(eye, clip, { glass, normal: [-1, 0, 0] }, [], false)),
    pixels(1, (eye, clip) => place.room(eye, clip)),
  ];
}"""


def test_a_mirror_shows_the_room_as_it_is(chromium: Any) -> None:
    """Its windows, too, as an eye behind the glass sees them that looks the other way; and nothing beside the glass."""
    with flat_page(chromium, MODULES) as page:
        mirror, straight = np.array(page.evaluate(MIRROR), float).reshape(2, 128, 128, 4)[..., :3]
    inside = np.s_[46:84, 24:104]  # of the glass, rows from below
    straight = straight[:, ::-1][inside]
    assert straight.std() > 20  # windows in a wall
    np.testing.assert_allclose(mirror[inside], 0.76 * straight + [0, 4, 4], atol=3)
    assert (mirror[100:] == [0, 0, 255]).all()


def test_nobody_steps_into_another(chromium: Any) -> None:
    with flat_page(chromium, MODULES) as page:
        walked = page.evaluate("""() => {
          const steps = new window.Steps(() => [[0, 1.5, 2]]);
          const head = () => [steps.matrix[12], 1.5, steps.matrix[14]];
          let count = 0;
          while (count < 20 && steps.step(head(), [0, 0, 1], 0.4, 0)) count++;
          steps.turn(head(), Math.PI / 2);
          const { pose } = steps.moved({ pose: { trans: [0, 0.1, 0] } });
          const moved = steps.moved({ tracking: { head: [0, 1.6, 0, 0, 0, 0, 1], left: null } });
          const { head: to, left } = moved.tracking;
          return { count, trans: pose.trans, root: pose.root_pose, head: to, left };
        }""")
        assert walked["count"] == 3 and walked["left"] is None
        np.testing.assert_allclose(walked["trans"], [0, 0.1, 1.2], atol=1e-6)
        np.testing.assert_allclose(walked["root"], [0, np.pi / 2, 0], atol=1e-6)
        np.testing.assert_allclose(walked["head"], [0, 1.6, 1.2, 0, np.sqrt(0.5), 0, np.sqrt(0.5)], atol=1e-6)


def test_a_face_is_asked_for_with_the_pixels_that_it_covers(open_page: OpenPage, served: Any) -> None:
    """Of the display, up to twice the side of the setting; from 1.4 m on, those of the setting."""
    page = visit(open_page, served, {"drawer": False}, size=(700, 460))
    sides = page.js("""async () => {
      const { Framing } = await import('/vr/space/framing.js');
      const { IDENTITY, translation } = await import('/vr/space/matrix.js');
      const framing = new Framing();
      framing.learn([-0.3, 0, -0.15, 0.3, 1.8, 0.15], { head: null });
      const f = 1 / Math.tan(0.4);
      const projection = [(f * 460) / 700, 0, 0, 0, 0, f, 0, 0, 0, 0, -1, -1, 0, 0, -0.02, 0];
      const viewport = { x: 0, y: 0, width: 700, height: 460 };
      const where = { view: 'viewer', shown: IDENTITY };
      return [2.5, 0.6, 1.3, 1.5].map((away) => {
        const view = { transform: translation([0, 1.6, away]), projection, viewport };
        const { size } = framing.frame([view], where, null, 256, 0.05, 1000 * away);
        return Math.sqrt(size[0] * size[1]);
      });
    }""")
    assert sides == pytest.approx([256, 512, 384, 256], rel=0.06)
