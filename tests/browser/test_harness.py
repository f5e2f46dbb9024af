"""The tools of these tests hold what the tests rest on: stamps, the fake headset, watching eyes."""

from __future__ import annotations

import json
import math
import urllib.request
from collections.abc import Callable

import cv2
import numpy as np
import pytest
import simplejpeg

from glsplat.net.codec.encode import encode_picture
from glsplat.net.server import ServerConfig
from tests.browser.conftest import OpenPage
from tests.browser.opened import Opened
from tests.browser.served import Served
from tests.browser.stored import StoredPairs, read_stamp, stamp

ENTER = """async () => {
  const canvas = document.createElement('canvas');
  const gl = window.gl = canvas.getContext('webgl2', {xrCompatible: true});
  const button = document.body.appendChild(document.createElement('button'));
  button.id = 'go';
  button.onclick = async () => {
    const optionalFeatures = ['hand-tracking', 'body-tracking', 'never-heard-of'];
    const session = await navigator.xr.requestSession(window.mode ?? 'immersive-vr',
      {requiredFeatures: ['local-floor'], optionalFeatures});
    session.updateRenderState({baseLayer: new XRWebGLLayer(session, gl), depthNear: 0.05, depthFar: 50});
    window.session = session;
    window.space = await session.requestReferenceSpace('local-floor');
    window.ready = true;
  };
}"""


def entered(page: Opened, mode: str = "immersive-vr") -> Opened:
    page.js("(mode) => { window.mode = mode; }", mode)
    page.js(ENTER)
    page.page.click("#go")
    page.until("window.ready")
    return page


@pytest.mark.parametrize("quality", [30, 80])
def test_a_stamp_survives_the_codec(quality: int) -> None:
    for number in (0, 1, 77, 2**19 - 1, 300_001):
        for eye in (0, 1):
            image = np.random.default_rng(1).integers(0, 255, (128, 160, 4), np.uint8)
            stamp(image, number, eye)
            shown = simplejpeg.decode_jpeg(encode_picture(image, quality))
            assert read_stamp(shown) == (number, eye)
    assert read_stamp(np.zeros((128, 160, 3), np.uint8)) is None
    assert read_stamp(np.full((128, 160, 3), 255, np.uint8)) is None


def test_a_server_comes_back_on_its_port() -> None:
    served = Served(StoredPairs(), ServerConfig(port=0))
    with served:
        port = served.port
        assert json.load(urllib.request.urlopen(f"{served.origin}/stats"))["driver"] == "stored pictures"
        served.stop()
        with pytest.raises(OSError):
            urllib.request.urlopen(served.origin)
        served.start()
        assert served.port == port and served.stats()["clients"] == []


def test_the_fake_eyes_are_as_told(modules: Opened) -> None:
    page = entered(modules)
    page.js("fakeXR.device.head = [0.1, 1.7, 0.2, 0, Math.sin(0.3), 0, Math.cos(0.3)]")
    page.js("""() => session.requestAnimationFrame((time, frame) => {
      const {views, transform} = frame.getViewerPose(space);
      window.seen = {time, head: [...transform.matrix], views: views.map((view) => ({eye: view.eye,
        matrix: [...view.transform.matrix], inverse: [...view.transform.inverse.matrix], P: [...view.projectionMatrix],
        port: (({x, y, width, height}) => [x, y, width, height])(session.renderState.baseLayer.getViewport(view))}))};
    })""")
    assert page.js("fakeXR.step(1234.5)") is True
    seen = page.js("window.seen")
    assert seen["time"] == 1234.5
    left, right = seen["views"]
    assert (left["eye"], left["port"]) == ("left", [0, 0, 1024, 1024])
    assert (right["eye"], right["port"]) == ("right", [1024, 0, 1024, 1024])
    for view, angles in ((left, (54, 40)), (right, (40, 54))):
        P = np.reshape(view["P"], (4, 4)).T
        edges = [(P[0, 2] - 1) / P[0, 0], (P[0, 2] + 1) / P[0, 0], (P[1, 2] - 1) / P[1, 1], (P[1, 2] + 1) / P[1, 1]]
        tangents = [math.tan(math.radians(a)) for a in (-angles[0], angles[1], -53, 44)]
        np.testing.assert_allclose(edges, tangents, rtol=1e-6)
        near, far = P[2, 3] / (P[2, 2] - 1), P[2, 3] / (P[2, 2] + 1)
        np.testing.assert_allclose([near, far], [0.05, 50], rtol=1e-4)
        matrix, inverse = (np.reshape(view[k], (4, 4)).T for k in ("matrix", "inverse"))
        np.testing.assert_allclose(matrix @ inverse, np.eye(4), atol=1e-6)
    apart = np.subtract(right["matrix"][12:15], left["matrix"][12:15])
    np.testing.assert_allclose(apart, 0.063 * np.array([math.cos(0.6), 0, -math.sin(0.6)]), atol=1e-6)
    np.testing.assert_allclose(seen["head"][12:15], [0.1, 1.7, 0.2], atol=1e-6)


def test_the_fake_layer_is_read_eye_by_eye(modules: Opened) -> None:
    page = entered(modules, "immersive-ar")
    assert page.js("session.environmentBlendMode") == "alpha-blend"
    page.js("""() => session.requestAnimationFrame((time, frame) => {
      gl.bindFramebuffer(gl.FRAMEBUFFER, session.renderState.baseLayer.framebuffer);
      gl.enable(gl.SCISSOR_TEST);
      for (const [x, y, w, h, r] of [[0, 0, 1024, 1024, 0.2], [1024, 0, 1024, 1024, 0.4], [1024, 1014, 20, 10, 1]]) {
        gl.scissor(x, y, w, h);
        gl.clearColor(r, 0, 0, 0.6);
        gl.clear(gl.COLOR_BUFFER_BIT);
      }
    })""")
    assert page.js("fakeXR.step(0)") and not page.js("fakeXR.step(1)")  # no callback, no frame
    left, right = page.eye("left"), page.eye("right")
    assert left.shape == (1024, 1024, 4) and (left == (51, 0, 0, 153)).all()
    assert (right[:10, :20] == (255, 0, 0, 153)).all() and (right[10:] == (102, 0, 0, 153)).all()
    page.js("session.requestAnimationFrame(() => {})")
    page.js("fakeXR.step(2)")
    assert not page.eye("left").any(), "a frame begins as transparent black"
    assert page.js("gl.getError()") == 0


def test_fake_hands_and_controllers(modules: Opened) -> None:
    page = entered(modules)
    page.js("""() => {
      const joints = Array.from({length: 25}, (_, i) => [0.01 * i, 1, -0.3, 0, 0, 0, 1, 0.008]);
      Object.assign(fakeXR.device, {input: 'hands', hands: {left: {joints}, right: null}});
      window.changes = [];
      session.oninputsourceschange = (event) => changes.push([event.added.length, event.removed.length]);
      window.look = () => session.requestAnimationFrame((time, frame) => {
        const found = window.found = {};
        for (const source of session.inputSources) {
          const grip = frame.getPose(source.gripSpace, space);
          const at = found[source.handedness] = {grip: grip && [...grip.transform.matrix].slice(12, 15)};
          if (source.hand) {
            const out = new Float32Array(16 * 25);
            at.all = frame.fillPoses(source.hand.values(), space, out);
            at.third = [...out].slice(3 * 16 + 12, 3 * 16 + 15);
            const joint = frame.getJointPose(source.hand.get('index-finger-tip'), space);
            at.tip = joint && [joint.transform.position.x, joint.radius];
            at.names = [...source.hand.keys()];
          }
          if (source.gamepad) at.buttons = source.gamepad.buttons.map((button) => button.value);
        }
      });
      look();
    }""")
    page.js("fakeXR.step(0)")
    found = page.js("found")
    assert (
        found["left"]["all"] and len(found["left"]["names"]) == 25 and found["left"]["names"][9] == "index-finger-tip"
    )
    np.testing.assert_allclose(found["left"]["third"], [0.03, 1, -0.3], atol=1e-6)
    np.testing.assert_allclose(found["left"]["tip"], [0.09, 0.008], atol=1e-6)
    assert found["right"] | {"third": 0, "names": 0} == {
        "grip": None,
        "all": False,
        "third": 0,
        "tip": None,
        "names": 0,
    }
    page.js("""() => {
      fakeXR.device.input = 'controllers';
      fakeXR.device.controllers = {right: {grip: [0.3, 1.1, -0.2, 0, 0, 0, 1]}};
      fakeXR.device.buttons.right = {trigger: 0.75, a: 1};
      window.events = [];
      session.addEventListener('select', (event) => events.push([event.type, event.inputSource.handedness,
        event.frame.getPose(event.inputSource.targetRaySpace, space).transform.position.x]));
      look();
    }""")
    page.js("fakeXR.step(1)")
    found = page.js("found")
    assert list(found) == ["right"] and found["right"]["buttons"][:5] == [0.75, 0, 0, 0, 1]
    page.js("fakeXR.press('right')")
    assert page.js("events") == [["select", "right", pytest.approx(0.3)]]
    assert page.js("changes") == [[2, 0], [1, 2]]


def test_the_fake_is_as_strict_as_the_specification(modules: Opened) -> None:
    page = modules
    asked = "window.refused = navigator.xr.requestSession('immersive-vr').catch((error) => error.name)"
    page.page.add_init_script(asked)  # nobody has clicked yet; what a test evaluates counts as a click
    page.page.reload()
    assert page.js("refused") == "SecurityError"
    entered(page)
    names = page.js("""async () => {
      const name = (act) => { try { act(); return 'allowed'; } catch (error) { return error.name; } };
      let kept;
      session.requestAnimationFrame((time, frame) => { kept = frame; });
      fakeXR.step(0);
      const view = new XRRigidTransform({x: 1}, {w: 2});
      return {
        late: name(() => kept.getViewerPose(space)),
        nothing: name(() => new XRRigidTransform({}, {x: 0, y: 0, z: 0, w: 0})),
        plain: name(() => new XRWebGLLayer(session, document.createElement('canvas').getContext('webgl2'))),
        write: name(() => { 'use strict'; view.position = 3; }),
        twice: view.inverse === view.inverse && view.inverse.inverse === view,
        space: await session.requestReferenceSpace('unbounded').catch((error) => error.name),
        features: session.enabledFeatures,
        orientation: view.orientation.w,
      };
    }""")
    assert names == {
        "late": "InvalidStateError",
        "nothing": "InvalidStateError",
        "plain": "InvalidStateError",
        "write": "TypeError",
        "twice": True,
        "space": "NotSupportedError",
        "features": ["viewer", "local", "local-floor", "hand-tracking", "body-tracking"],
        "orientation": 1,
    }
    page.js("""() => {
      window.heard = [];
      session.onend = () => heard.push('end');
      session.onvisibilitychange = () => heard.push(session.visibilityState);
      session.requestAnimationFrame(() => heard.push('frame'));
      fakeXR.visibility('hidden');
      fakeXR.step(1);
      fakeXR.visibility('visible');
      fakeXR.step(2);
      return session.end();
    }""")
    assert page.js("heard") == ["hidden", "visible", "frame", "end"] and page.js("fakeXR.session") is None


def test_uploads_are_read_where_they_lie(modules: Opened) -> None:
    image = np.zeros((256, 256, 4), np.uint8)
    stamp(image, 4711, 1)
    jpeg = list(encode_picture(image, 80))
    modules.js(
        """async (jpeg) => {
          const gl = document.createElement('canvas').getContext('webgl2');
          const options = {premultiplyAlpha: 'none', colorSpaceConversion: 'none'};
          const bitmap = await createImageBitmap(new Blob([new Uint8Array(jpeg)]), options);
          gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
          gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, bitmap);
          gl.bindTexture(gl.TEXTURE_2D_ARRAY, gl.createTexture());
          gl.texStorage3D(gl.TEXTURE_2D_ARRAY, 1, gl.RGBA8, 300, 300, 2);
          gl.texSubImage3D(gl.TEXTURE_2D_ARRAY, 0, 9, 7, 1, 256, 256, 1, gl.RGBA, gl.UNSIGNED_BYTE, bitmap);
          bitmap.close();
          bitmap.close();
        }""",
        jpeg,
    )
    uploads = modules.js("watch.uploads")
    assert [(u["id"], u["eye"], u["width"]) for u in uploads] == [(4711, 1, 256)] * 2
    assert modules.js("[watch.opened, watch.closed]") == [1, 1]


def test_a_complaint_of_the_page_is_a_fault(modules: Opened) -> None:
    modules.js("console.error('so it goes')")
    modules.js("setTimeout(() => { throw new Error('thrown'); }, 0)")
    modules.meanwhile(lambda: len(modules.unexpected()) >= 2)
    assert len(modules.unexpected()) == 2, modules.faults
    modules.allowed += ["so it goes", "thrown"]
    assert not modules.unexpected()


def test_iwer_gives_a_headset(open_page: OpenPage, serve: Callable[..., Served]) -> None:
    served = serve(StoredPairs())
    page = open_page(f"{served.origin}/healthz", xr="iwer")
    assert page.js("navigator.xr.isSessionSupported('immersive-vr')") is True
    assert page.js("[headset.ipd, headset.position.y]") == [0.063, pytest.approx(1.6)]


def test_a_screenshot_is_the_canvas(modules: Opened) -> None:
    modules.js("""() => {
      const canvas = document.body.appendChild(document.createElement('canvas'));
      Object.assign(canvas, {id: 'canvas', width: 64, height: 32});
      const gl = canvas.getContext('webgl2', {preserveDrawingBuffer: true});
      gl.clearColor(1, 0, 0.2, 1);
      gl.clear(gl.COLOR_BUFFER_BIT);
      document.body.appendChild(document.createElement('p')).textContent = 'over it';
    }""")
    shot = modules.canvas()
    assert shot.shape == (32, 64, 3) and np.abs(shot.astype(int) - (255, 0, 51)).max() <= 1
    assert cv2.mean(shot)[1] == 0
