"""The flat page's camera: what it shows, and how mouse, fingers and keys turn it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.browser.flat_page import flat_page

ORBIT = """
import { Orbit } from '/vr/show/orbit.js';
const orbit = new Orbit();
orbit.attach(document.getElementById('canvas'));
document.getElementById('panel').hidden = true;
Object.assign(window, { orbit, Orbit });
"""


@pytest.fixture(scope="module")
def canvas(chromium):
    with flat_page(chromium, ORBIT, "window.orbit", viewport={"width": 800, "height": 600}, has_touch=True) as page:
        yield page


@pytest.fixture
def camera(canvas):
    """A camera at its start, without the focus."""
    canvas.evaluate("orbit.detach(); window.orbit = new Orbit(); orbit.attach(document.getElementById('canvas'))")
    canvas.evaluate("document.activeElement.blur()")
    return canvas


def views(page, width=800, height=600, **options):
    got = page.evaluate("([w, h, o]) => orbit.views(w, h, o)", [width, height, options])
    for view in got:
        for key in ("transform", "projection"):
            view[key] = np.array(view[key]).reshape(4, 4).T
    return got


def seen(view, point):
    """Where a room point is in the view's pixels, y down, and its depth."""
    x, y, _, w = view["projection"] @ np.linalg.inv(view["transform"]) @ [*point, 1]
    port = view["viewport"]
    return np.array([port["x"] + (x / w + 1) / 2 * port["width"], port["y"] + (1 - y / w) / 2 * port["height"]]), w


def test_the_camera_looks_at_its_target(camera):
    camera.evaluate("orbit.turn(0.7, 0.4)")
    (view,) = views(camera)
    assert view["eye"] == "none"
    rotation = view["transform"][:3, :3]
    assert np.abs(rotation.T @ rotation - np.eye(3)).max() < 1e-12 and np.linalg.det(rotation) == pytest.approx(1)
    pixel, depth = seen(view, camera.evaluate("orbit.target"))
    assert pixel == pytest.approx([400, 300]) and depth == pytest.approx(camera.evaluate("orbit.distance"))
    assert rotation[1, 1] > 0 and rotation[1, 0] == 0  # upright, no roll
    assert 2 * math.degrees(math.atan(1 / view["projection"][1, 1])) == pytest.approx(40)
    camera.evaluate("orbit.reset()")
    assert views(camera)[0]["transform"][2, 3] > 2.5  # in front of an avatar that faces +z
    left, right = views(camera, 1001, 500, stereo=True, ipd=0.06)
    assert (left["eye"], right["eye"]) == ("left", "right")
    assert left["viewport"] == {"x": 0, "y": 0, "width": 500, "height": 500} and right["viewport"]["x"] == 500
    apart = right["transform"][:3, 3] - left["transform"][:3, 3]
    assert apart == pytest.approx(0.06 * left["transform"][:3, 0])
    camera.evaluate("orbit.follow([-0.4, 0, -0.2, 0.4, 1.8, 0.2], 0)")
    camera.focus("#canvas")
    camera.keyboard.press("f")  # shows the face, and goes back
    assert seen(views(camera)[0], [0, 1.67, 0])[0] == pytest.approx([400, 300], abs=1)
    camera.keyboard.press("f")
    assert not camera.evaluate("orbit.close")
    camera.evaluate("orbit.inset = {top: 40, right: 200, bottom: 160, left: 0}")  # what lies over the picture
    assert seen(views(camera)[0], camera.evaluate("orbit.target"))[0] == pytest.approx([300, 240], abs=1e-6)


def test_the_left_button_circles_and_the_right_one_pans(camera):
    before = camera.evaluate("orbit.target")
    camera.mouse.move(400, 300)
    camera.mouse.down()
    camera.mouse.move(460, 330, steps=3)
    camera.mouse.up()
    camera.mouse.move(100, 100)
    assert camera.evaluate("[orbit.yaw, orbit.pitch]") == pytest.approx([-math.pi / 10, 0.06 + math.pi / 20])
    assert camera.evaluate("orbit.target") == pytest.approx(before)
    for button in ("right", "middle"):
        camera.mouse.move(400, 300)
        camera.mouse.down(button=button)
        camera.mouse.move(470, 260, steps=4)
        camera.mouse.up(button=button)
    assert seen(views(camera)[0], before)[0] == pytest.approx([540, 220], abs=1e-6)  # it stays under the pointer


def test_the_pitch_and_the_distance_have_limits(camera):
    camera.evaluate("orbit.turn(100, 100)")
    assert camera.evaluate("orbit.pitch") < math.pi / 2
    camera.evaluate("orbit.zoom(1e9)")
    assert camera.evaluate("orbit.distance") == 30
    camera.evaluate("orbit.zoom(1e-9); orbit.pan(1e9, 1e9, 1e9)")
    assert camera.evaluate("orbit.distance") == 0.3 and max(map(abs, camera.evaluate("orbit.target"))) < 12
    assert np.isfinite(views(camera, 0, 0)[0]["projection"]).all()


def test_zooming_goes_to_the_pointer(camera):
    """What lies under it, in the plane of the target, stays there."""
    camera.evaluate("orbit.follow([-0.4, 0, -0.2, 0.4, 1.8, 0.2], 0)")
    (view,) = views(camera)
    target, right = np.array(camera.evaluate("orbit.target")), view["transform"][:3, 0]
    up = view["transform"][:3, 1]
    point = target + 0.12 * right + 0.7 * up  # beside the head
    before = seen(view, point)[0]
    camera.mouse.move(*before)
    for _ in range(3):
        camera.mouse.wheel(0, -180)
    camera.wait_for_function("orbit.distance < 1.8")
    (view,) = views(camera)
    assert seen(view, point)[0] == pytest.approx(before, abs=0.5)


def test_keys_do_what_the_help_says(camera):
    camera.keyboard.press("r")  # without the focus nothing happens
    camera.focus("#canvas")
    state = "[orbit.yaw, orbit.pitch, orbit.distance, ...orbit.target]"
    start = camera.evaluate(state)
    changed = {"ArrowLeft": 0, "ArrowRight": 0, "ArrowUp": 1, "ArrowDown": 1, "+": 2, "-": 2,
               "a": 3, "d": 3, "q": 4, "e": 4, "w": 5, "s": 5}  # fmt: skip
    signs = []
    for key, which in changed.items():
        camera.keyboard.press(key)
        difference = np.array(camera.evaluate(state)) - start
        assert difference[which] != 0, key
        signs.append(int(np.sign(difference[which])))
        camera.keyboard.press("r")
        assert camera.evaluate(state) == pytest.approx(start)
    assert signs == [-1, 1, 1, -1, -1, 1, -1, 1, -1, 1, -1, 1]
    camera.keyboard.press("Control+-")
    assert camera.evaluate(state) == pytest.approx(start)  # the browser's own keys stay its own


def test_fingers_circle_pinch_and_pan(camera):
    session = camera.context.new_cdp_session(camera)

    def touch(kind, *points):
        places = [{"x": x, "y": y, "id": i} for i, (x, y) in enumerate(points)]
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": places})
        camera.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")

    touch("touchStart", (400, 300))
    touch("touchMove", (460, 300))
    assert camera.evaluate("orbit.yaw") == pytest.approx(-math.pi / 10)
    touch("touchEnd")
    camera.evaluate("orbit.reset()")
    target = camera.evaluate("orbit.target")
    touch("touchStart", (350, 300), (450, 300))
    touch("touchMove", (300, 300), (500, 300))  # twice as far apart, the middle stays
    assert camera.evaluate("[orbit.distance, orbit.yaw]") == pytest.approx([1.7, 0])
    touch("touchMove", (330, 340), (530, 340))  # both by the same: a pan
    touch("touchEnd")
    assert seen(views(camera)[0], target)[0] == pytest.approx([430, 340], abs=8)
    assert camera.evaluate("orbit.distance") == pytest.approx(1.7, rel=1e-3)


def test_the_camera_follows_gently(camera):
    box = [-0.4, 0, -0.2, 0.4, 1.8, 0.2]
    start = camera.evaluate("(box) => { orbit.follow(box, 0); return orbit.target; }", box)
    assert start == pytest.approx([0, 0.9, 0])
    near = [v + (0.2 if i % 3 == 0 else 0) for i, v in enumerate(box)]
    assert camera.evaluate("(box) => { orbit.follow(box, 100); return orbit.target; }", near) == pytest.approx(start)
    far = [v + (2 if i % 3 == 0 else 0) for i, v in enumerate(box)]
    path = camera.evaluate(
        """(box) => {
          const out = [];
          for (let t = 116; t < 5000; t += 16) {
            orbit.follow(box, t);
            out.push(orbit.target[0]);
          }
          return out;
        }""",
        far,
    )
    assert path[0] < 0.1 and (np.diff(path) >= 0).all() and path[-1] == pytest.approx(2 - 0.34, abs=0.01)
    camera.evaluate("orbit.pan(0.5, 0); orbit.follow(null); orbit.follow([NaN, 0, 0, 0, 0, 0], 6000)")
    assert camera.evaluate("orbit.target")[0] == pytest.approx(path[-1] + 0.5)
    camera.evaluate("(box) => { orbit.reset(); orbit.follow(box, 6000); }", far)
    assert camera.evaluate("orbit.target") == pytest.approx([2, 0.9, 0])
